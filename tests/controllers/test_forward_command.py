from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.busalone import AloneBench, write_drives
from support.control import FORWARD, Hardware, S, add, manager, same, vectors

from canopen_control.controllers.forward_command import TargetController
from canopen_control.controllers.params import Params
from canopen_control.errors import CanopenError, ControlError, RobotConfigError
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.interfaces import TARGET, CommandInterface
from canopen_control.rpc.messages.parameters import ParameterValue


@pytest.fixture
def drives(tmp_path, request):
    bench = AloneBench(f"target{abs(hash(request.node.nodeid)) % 10**8}", config=write_drives(tmp_path), drives=(2, 3))
    bench.start()
    yield bench
    bench.close()


@pytest.mark.rest
def test_nothing_moves_before_an_enable_and_a_target_after_it(drives):
    assert "axis enable" in drives.target(1.0)
    drives.enable("drive_one")
    drives.run(500)
    assert drives.at("position") == 0.0
    assert not drives.powered(3)  # the other one was not asked for
    assert drives.target(1.0) is None
    drives.run(3000)
    assert drives.at("position") == pytest.approx(1.0, abs=0.001)


@pytest.mark.rest
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_a_number_is_refused_with_the_name_and_what_was_there_continues(drives, value):
    drives.enable("drive_one")
    assert drives.target(0.5) is None
    assert "drive_one/target" in drives.target(value)
    drives.run(3000)
    assert drives.at("position") == pytest.approx(0.5, abs=0.001)


@pytest.mark.parametrize(
    ("mode", "interface", "value", "reached"),
    [("PP", "position", 0.1, 0.1), ("CSP", "position", 0.1, 0.1), ("PV", "velocity", 2.0, 2.0),
     ("VL", "velocity", 2.0, 2.0), ("CSV", "velocity", 2.0, 2.0), ("TQ", "effort", 100.0, 0.1),
     ("CST", "effort", 100.0, 0.1)],
)  # fmt: skip
def test_the_target_is_what_the_mode_takes(drives, mode, interface, value, reached):
    """An effort is in per mille of the rated torque, as 0x6071 has it; what is measured has its scale."""
    drives.enable("drive_one")
    drives.mode(mode)
    assert drives.target(value) is None
    drives.run(1500)
    assert drives.at(interface) == pytest.approx(reached, rel=0.06)
    assert drives.robot.manager.get("drive_one").interface == interface


@pytest.mark.parametrize("mode", ["PV", "CSV"])
def test_a_velocity_that_is_not_renewed_ends_after_two_seconds_and_reports_this(drives, mode):
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(2.0)
    drives.run(1900)
    assert drives.at("velocity") == pytest.approx(2.0, rel=0.02)
    drives.run(2000)
    assert drives.at("velocity") == pytest.approx(0.0, abs=0.01)
    assert "targets are 0" in drives.texts("command_timeout")[0]


@pytest.mark.parametrize("ms", [0, 20])
@pytest.mark.parametrize(("before", "after"), [("PV", "PP"), ("PP", "PV"), ("CSV", "CSP"), ("TQ", "PP")])
def test_a_target_is_discarded_with_its_mode_however_late_it_came(drives, before, after, ms):
    drives.enable("drive_one")
    drives.mode(before)
    drives.target(2.0)
    drives.run(ms)
    drives.mode(after)
    value = drives.joint(2).commands["target"].value
    assert math.isnan(value) or (value == 0.0 and after == "PV")
    drives.run(1000)
    here = drives.at("position")
    drives.run(1000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)


@pytest.mark.parametrize(("mode", "value"), [("PP", 50.0), ("CSP", 50.0), ("PV", 2.0), ("CSV", 2.0)])
def test_a_target_ends_with_its_client(drives, mode, value):
    """Of a position too, whether the drive or the master makes the way: it stops on the way."""
    bridge = object()
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(value, holder=bridge)
    drives.run(1500)
    assert abs(drives.speed(2)) > 1
    drives.robot.client_disconnected(bridge)
    drives.run(1500)
    here = drives.at("position")
    drives.run(2000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)
    assert abs(drives.speed(2)) < 1
    assert "is gone" in drives.texts("commander_gone")[0]
    assert drives.joint(2).enabled  # and takes the next one
    assert drives.target(0.0) is None


@pytest.mark.parametrize("mode", ["PP", "PV"])
def test_disabling_and_enabling_does_not_revive_an_old_target(drives, mode):
    drives.enable("drive_one")
    drives.mode(mode)
    drives.target(2.0)
    drives.run(500)
    assert drives.axis(Action.DISABLE, "drive_one") is None
    drives.enable("drive_one")
    here = drives.at("position")
    drives.run(2000)
    assert drives.at("position") == pytest.approx(here, abs=0.01)


@pytest.mark.rest
@pytest.mark.parametrize("mode", ["CSP", "IP"])
def test_a_place_to_go_to_is_reached_along_the_profile_of_the_drive_where_the_mode_has_none(drives, mode):
    """0x6081 and 0x6083 as the drive has them; a step would ask for what no motor can do."""
    drives.enable("drive_one")
    drives.mode(mode)
    assert drives.target(10.0) is None
    speeds = []
    for _ in range(300):
        drives.run(10)
        speeds.append(drives.at("velocity"))
    assert drives.at("position") == pytest.approx(10.0, abs=0.001)
    assert 6.0 < max(speeds) < 6.5  # 65536 counts/s
    changes = [after - before for before, after in itertools.pairwise(speeds)]
    assert max(map(abs, changes)) < 0.6  # 262144 counts/s^2, in a cycle of 10 ms
    assert drives.target(9.0) is None
    drives.run(100)
    assert drives.target(12.0) is None  # while it turns in the other direction
    drives.run(3000)
    assert drives.at("position") == pytest.approx(12.0, abs=0.001)
    assert drives.found("fault") == []


def test_a_target_that_its_object_cannot_hold_is_refused(drives):
    drives.enable("drive_one")
    drives.mode("TQ")
    assert "the range of" in drives.target(1e9)


def test_without_a_mode_there_is_not_a_target():
    controller = TargetController("arm")
    controller.on_configure(Params.of({"joint": "arm"}))
    controller.on_activate([CommandInterface("arm", TARGET)], [], 0)
    with pytest.raises(ControlError, match="not in a mode"):
        controller.set_command([1.0], 0)


def test_it_needs_a_joint():
    with pytest.raises(RobotConfigError, match="no 'joint'"):
        TargetController("arm").on_configure(Params.of({}))


JOINTS = ["joint1", "joint2", "joint3"]
GROUPS = {
    "velocity_controllers/JointGroupVelocityController": "velocity",
    "position_controllers/JointGroupPositionController": "position",
    "effort_controllers/JointGroupEffortController": "effort",
}
CASES = {case["name"]: case for case in vectors("forward_command")}
#: upstream's behaviour in these cases is unsafe or unintended; the tests below specify this package's behaviour
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
        expected = expect[1] if isinstance(expect, list) and expect and expect[0] == "OK" else expect
        if isinstance(expected, list):
            assert all(same(a, b) for a, b in zip(hardware.values(), expected, strict=True))


@pytest.mark.parametrize("values", [[], [1.0], [1.0] * 4, [1.0, math.nan, 1.0], [math.inf, 1.0, 1.0], [1.0, True, 1.0]])
def test_a_bad_command_is_refused_whole_counted_and_does_not_refresh_the_timeout(values):
    hardware, control, forward = robot(command_timeout=1.0)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(S // 2, 0.01)
    with pytest.raises(ControlError, match="forward expects"):
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
    texts = [event.text for event in control.events() if event.kind == "command_timeout"]
    assert len(texts) == 1
    assert "position targets are held" in texts[0]
    control.switch(deactivate=["forward"])
    assert hardware.values() == [1.0, 2.0, 3.0]


def test_a_timeout_is_reported_once_and_the_next_command_takes_over():
    hardware, control, _ = robot(command_timeout=2.0)
    control.switch(["forward"], now=0)
    control.command("forward", [1.0, 2.0, 3.0], 0)
    control.update(0, 0.01)
    for step in range(1, 300):
        control.update(step * S // 100, 0.01)
    texts = [event.text for event in control.events() if event.kind == "command_timeout"]
    assert texts == ["forward: no command for 2.01 s, targets are 0 until the next command"]
    assert hardware.values() == [0.0, 0.0, 0.0]
    control.command("forward", [4.0, 5.0, 6.0], 3 * S)
    control.update(3 * S, 0.01)
    assert hardware.values() == [4.0, 5.0, 6.0]


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
    assert sum("'pid." in event.text and "no effect" in event.text for event in control.events()) == 2
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
    assert forward.command_timeout.limit_ns == 0


def test_a_command_takes_the_place_of_the_one_before_as_a_whole():
    hardware, control, _ = robot()
    start(control, hardware)
    for now, values in enumerate(([1.0, 2.0, 3.0], [4.0, 5.0, 6.0])):
        control.command("forward", values, now * S, source=f"client {now}")
    control.update(S, 0.01)
    assert hardware.values() == [4.0, 5.0, 6.0]
