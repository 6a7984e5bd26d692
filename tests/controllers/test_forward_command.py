from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import FORWARD, Hardware, S, add, manager, same, vectors

from canopen_control.errors import CanopenError, ControlError, RobotConfigError
from canopen_control.rpc.messages.parameters import ParameterValue

JOINTS = ["joint1", "joint2", "joint3"]
GROUPS = {
    "velocity_controllers/JointGroupVelocityController": "velocity",
    "position_controllers/JointGroupPositionController": "position",
    "effort_controllers/JointGroupEffortController": "effort",
}
CASES = {case["name"]: case for case in vectors("forward_command")}
#: what upstream does with these is unsafe or an accident; the tests below say what is done instead
DEVIATES = {
    "WrongCommandCheckTest",  # stops the controller; here the command is refused and the last one stays
    "plain ForwardCommandController deactivate leaves the last command",
}


def robot(type_name: str = FORWARD, interface: str = "velocity", **params):
    hardware = Hardware(*(f"{joint}/{interface}" for joint in JOINTS), name="arm")
    control = manager(hardware)
    given_params = {"joints": JOINTS, **params}
    if type_name == FORWARD:
        given_params["interface_name"] = interface
    return hardware, control, add(control, "forward", type_name, **given_params)


def start(control, hardware) -> None:
    control.switch(["forward"], now=0)
    for each, value in zip(hardware.command_interfaces, (1.1, 2.1, 3.1), strict=True):
        if math.isnan(each.value):
            each.value = value


@pytest.mark.parametrize("name", [name for name in CASES if name not in DEVIATES])
def test_it_behaves_as_upstream_does(name):
    case = CASES[name]
    type_name = case.get("controller", FORWARD)
    hardware, control, _ = robot(type_name, GROUPS.get(type_name, "velocity"))
    start(control, hardware)
    now = 0
    before = hardware.values()
    for (verb, *values), expect in zip(case["steps"], case["expect"], strict=True):
        now += S
        if verb == "msg":
            try:
                control.command("forward", values[0], now)
            except ControlError:
                assert expect in ("dropped", None)
        elif verb == "update":
            control.update(now, 0.01)
        elif verb == "activate":
            control.switch(["forward"], now=now)
            for each, value in zip(hardware.command_interfaces, before, strict=True):
                each.value = value  # upstream leaves what was there; here it is nan until the first command
        else:
            before = hardware.values()
            control.switch(deactivate=["forward"], now=now)
        wanted = expect[1] if isinstance(expect, list) and expect and expect[0] == "OK" else expect
        if isinstance(wanted, list):
            assert all(same(a, b) for a, b in zip(hardware.values(), wanted, strict=True))


@pytest.mark.parametrize("values", [[], [1.0], [1.0] * 4, [1.0, math.nan, 1.0], [math.inf, 1.0, 1.0], [1.0, True, 1.0]])
def test_a_bad_command_is_refused_whole_counted_and_does_not_refresh_the_timeout(values):
    hardware, control, forward = robot(command_timeout=1.0)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(S // 2, 0.01)
    with pytest.raises(ControlError, match="forward wants"):
        control.command("forward", values, S // 2)
    assert forward.rejected == 1
    control.update(S, 0.01)
    assert hardware.values() == [1.0, 2.0, 3.0]
    assert control.get("forward").state.value == "active"
    control.update(S + 1, 0.01)
    assert hardware.values() == [0.0, 0.0, 0.0]


def test_before_the_first_command_nothing_is_written_and_afterwards_targets_are_zero_on_every_deactivate():
    hardware, control, _ = robot()
    control.switch(["forward"], now=0)
    control.update(S, 0.01)
    assert all(math.isnan(value) for value in hardware.values())
    control.command("forward", [1.0, 2.0, 3.0], S)
    control.update(S, 0.01)
    control.switch(deactivate=["forward"])
    assert hardware.values() == [0.0, 0.0, 0.0]


def test_a_position_target_is_held_by_a_timeout_and_by_a_deactivation():
    hardware, control, _ = robot("position_controllers/JointGroupPositionController", "position", command_timeout=0.5)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(0, 0.01)
    control.update(S, 0.01)
    assert hardware.values() == [1.0, 2.0, 3.0]
    told = [each.text for each in control.events() if each.kind == "command_timeout"]
    assert len(told) == 1
    assert "position targets are held" in told[0]
    control.switch(deactivate=["forward"])
    assert hardware.values() == [1.0, 2.0, 3.0]


def test_a_timeout_is_told_once_and_the_next_command_takes_over():
    hardware, control, forward = robot(command_timeout=2.0)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(0, 0.01)
    for step in range(1, 300):
        control.update(step * S // 100, 0.01)
    told = [each.text for each in control.events() if each.kind == "command_timeout"]
    assert told == ["forward: no command for 2.01 s, targets are 0 until the next one"]
    assert forward.timed_out
    control.command("forward", [4.0, 5.0, 6.0], 3 * S)
    control.update(3 * S, 0.01)
    assert hardware.values() == [4.0, 5.0, 6.0]


def test_with_a_timeout_of_zero_the_last_command_is_held_forever():
    hardware, control, _ = robot(command_timeout=0.0)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(0, 0.01)
    control.update(10**6 * S, 0.01)
    assert hardware.values() == [1.0, 2.0, 3.0]


def test_a_command_while_inactive_is_refused_and_does_not_count_later():
    hardware, control, _ = robot()
    with pytest.raises(ControlError, match="is inactive; activate it"):
        control.command("forward", [1.0, 2.0, 3.0], 0)
    control.switch(["forward"], now=0)
    control.update(S, 0.01)
    assert all(math.isnan(value) for value in hardware.values())


def test_several_interfaces_of_one_joint_are_commanded_in_their_order():
    hardware = Hardware("a/position", "a/velocity", "a/effort")
    control = manager(hardware)
    multi = "forward_command_controller/MultiInterfaceForwardCommandController"
    add(control, "multi", multi, joint="a", interface_names=["velocity", "effort"])
    control.switch(["multi"], now=0)
    control.command("multi", [7.0, 8.0], 0)
    control.update(0, 0.01)
    assert hardware.values()[1:] == [7.0, 8.0]
    assert control.list()[0].joints == ("a",)
    control.switch(deactivate=["multi"])
    assert hardware.values()[1:] == [0.0, 0.0]


@pytest.mark.parametrize("params", [{"joints": []}, {"joints": ["a", "a"]}, {"joints": "a"}, {"command_timeout": -1.0}])
def test_wrong_parameters_are_refused(params):
    with pytest.raises(RobotConfigError):
        robot(**params)


def test_an_interface_that_nobody_exports_refuses_the_activation():
    hardware = Hardware("joint1/velocity")
    control = manager(hardware)
    add(control, "forward", FORWARD, joints=["joint1", "joint2"], interface_name="velocity")
    with pytest.raises(CanopenError, match="joint2/velocity"):
        control.switch(["forward"], now=0)
    assert hardware.command_interfaces[0].owner is None


@given(st.lists(st.one_of(st.floats(), st.just(math.nan), st.integers(-5, 5)), max_size=5))
def test_only_finite_commands_of_the_right_size_ever_reach_the_hardware(values):
    hardware, control, forward = robot()
    control.switch(["forward"], now=0)
    good = len(values) == 3 and all(math.isfinite(value) for value in values)
    try:
        control.command("forward", values, 0)
    except ControlError:
        assert not good
    control.update(0, 0.01)
    assert hardware.values() == [float(value) for value in values] if good else forward.rejected == 1


@pytest.mark.parametrize("kind", ["velocity", "position", "effort"])
def test_ros_1s_controllers_of_one_joint_take_one_value(kind):
    hardware = Hardware(f"l/{kind}", "r/velocity")
    control = manager(hardware)
    type_name = f"{kind}_controllers/Joint{kind.capitalize()}Controller"
    add(control, "one", type_name, joint="l", pid__p=100.0, pid__i=0.1)
    control.switch(["one"], now=0)
    control.command("one", [2.0], 0)
    control.update(0, 0.01)
    assert hardware.values()[0] == 2.0
    assert sum("'pid." in each.text and "no effect" in each.text for each in control.events()) == 2
    with pytest.raises(RobotConfigError, match="no 'joint'"):
        add(control, "none", type_name)


@pytest.mark.parametrize(
    ("type_name", "params"),
    [
        (FORWARD, {}),
        ("velocity_controllers/JointGroupVelocityController", {}),
        ("velocity_controllers/JointVelocityController", {"joint": "joint1", "pid": {"p": 1.0}}),
        (
            "forward_command_controller/MultiInterfaceForwardCommandController",
            {"joint": "joint1", "interface_names": ["velocity"]},
        ),
    ],
)
def test_its_timeout_is_set_while_it_runs_and_counts_for_the_command_that_is_there(type_name, params):
    hardware = Hardware(*(f"{joint}/velocity" for joint in JOINTS), name="arm")
    control = manager(hardware)
    given_params = params or {"joints": JOINTS}
    forward = add(
        control,
        "forward",
        type_name,
        **given_params,
        **({"interface_name": "velocity"} if type_name == FORWARD else {}),
    )
    control.switch(["forward"], now=0)
    control.command("forward", [1.0] * len(forward.commands), 0)
    control.set_parameters("forward", [ParameterValue(name="command_timeout", kind="double", value=0.5)])
    control.update(S // 2, 0.01)
    assert forward.commands[0].value == 1.0
    control.update(S // 2 + 1, 0.01)
    assert forward.commands[0].value == 0.0
    control.set_parameters("forward", [ParameterValue(name="command_timeout", kind="double", value=0.0)])
    assert "command_timeout is 0" in control.events()[-2].text
    with pytest.raises(CanopenError):
        control.set_parameters("forward", [ParameterValue(name="command_timeout", kind="double", value=-1.0)])
    assert forward.life.limit_ns == 0


def test_a_command_takes_the_place_of_the_one_before_as_a_whole():
    hardware, control, _ = robot()
    start(control, hardware)
    for now, values in enumerate(([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])):
        control.command("forward", values, now * S, source=f"client {now}")
    control.update(S, 0.01)
    assert hardware.values() == [4.0, 5.0, 6.0]
