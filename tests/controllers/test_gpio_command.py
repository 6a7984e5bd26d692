from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import FORWARD, Hardware, S, add, manager, wheels

from canopen_control.controllers.gpio_command import CanopenProxyController, Cia402DeviceController, read_params
from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError, RobotConfigError, UnknownInterface
from canopen_control.runtime.enable_status import DriveEnableStatus

GPIO = "gpio_controllers/GpioCommandController"
OUTPUTS = ("io/lamp", "io/horn", "valve/open")
STATES = ("io/pressed", "io/lamp", "valve/open", "valve/pressure", "wheel/position")
BOTH = {"io": {"interfaces": ["lamp", "horn"]}, "valve": {"interfaces": ["open"]}}
NAN = math.nan


def robot(**params):
    """Return three outputs, and an active controller of them."""
    hardware = Hardware(*OUTPUTS, states=STATES)
    control = manager(hardware)
    add(control, "outputs", GPIO, **{"gpios": ["io", "valve"], "command_interfaces": BOTH, **params})
    control.switch(["outputs"], now=0)
    return hardware, control


def same(found, wanted):
    return [repr(item) for item in found] == [repr(item) for item in wanted]


def test_a_command_by_name_changes_what_it_names_and_the_others_stay():
    hardware, control = robot()
    control.command("outputs", {"io/lamp": 1.0}, 0)
    control.update(S, 0.01)
    assert same(hardware.values(), [1.0, NAN, NAN])
    control.command("outputs", {"valve/open": 0.25, "io/horn": 1.0}, S)
    control.update(2 * S, 0.01)
    assert hardware.values() == [1.0, 1.0, 0.25]


def test_the_last_command_is_written_again_in_every_update():
    hardware, control = robot()
    control.command("outputs", {"io/lamp": 1.0}, 0)
    for now in range(1, 1000):
        hardware.command_interfaces[0].value = 7.0
        control.update(now * S, 1.0)
        assert hardware.command_interfaces[0].value == 1.0


def test_a_command_of_all_is_in_the_order_of_the_parameters():
    hardware, control = robot()
    control.command("outputs", [1.0, 0.0, 0.5], 0)
    control.update(S, 0.01)
    assert hardware.values() == [1.0, 0.0, 0.5]


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"io/lamp": 1.0, "io/lam": 1.0}, "has no output 'io/lam' (did you mean 'io/lamp'?)"),
        ({"io/lamp": 1.0, "io/horn": NAN}, "expects finite numbers, got nan for io/horn; nothing was applied"),
        ({"io/lamp": math.inf}, "expects finite numbers, got inf for io/lamp"),
        ([1.0, 1.0], "expects 3 values (io/lamp, io/horn, valve/open), got 2"),
        ([1.0, 1.0, NAN], "expects finite numbers, got nan for valve/open"),
    ],
)
def test_a_command_that_does_not_fit_is_refused_whole(values, words):
    hardware, control = robot()
    control.command("outputs", [0.5, 0.5, 0.5], 0)
    with pytest.raises(ControlError) as caught:
        control.command("outputs", values, 1)
    control.update(S, 0.01)
    assert hardware.values() == [0.5, 0.5, 0.5]
    assert words in str(caught.value)
    assert (control.list()[0].rejected, control.list()[0].state) == (1, "active")


def test_a_value_that_the_object_behind_cannot_hold_is_refused_and_the_others_stay():
    hardware, control = robot()
    control.command("outputs", [0.5, 0.5, 0.5], 0)
    hardware.command_interfaces[2].lowest, hardware.command_interfaces[2].highest = 0.0, 1.0
    with pytest.raises(ControlError, match="cannot set 2: the range of valve/open is 0 to 1; nothing was applied"):
        control.command("outputs", {"io/lamp": 1.0, "valve/open": 2.0}, 1)
    control.update(S, 0.01)
    assert hardware.values() == [0.5, 0.5, 0.5]


ENDS = {
    "deactivation": lambda control, sender: control.switch((), ["outputs"], now=S),
    "stop": lambda control, sender: control.running.forget(S, "stop was commanded"),
    "sender": lambda control, sender: control.running.client_disconnected(sender),
    "time-out": lambda control, sender: control.update(60 * S, 0.01),
}


@pytest.mark.parametrize("end", ENDS.values(), ids=list(ENDS))
def test_when_commands_end_outputs_go_to_their_safe_values_and_kept_ones_stay(end):
    hardware, control = robot(safe_values={"io": {"horn": 0.75}}, kept_outputs=["valve/open"], command_timeout=50.0)
    sender = object()
    control.command("outputs", [1.0, 1.0, 1.0], 0, source="a panel", holder=sender)
    control.update(S, 0.01)
    end(control, sender)
    assert hardware.values() == [0.0, 0.75, 1.0]
    control.update(61 * S, 0.01)
    assert hardware.values() == [0.0, 0.75, 1.0]


def test_a_lost_device_is_reported_with_the_state_of_its_outputs():
    _, control = robot(kept_outputs=["valve/open"])
    control.events()
    control.command("outputs", {"io/lamp": 1.0}, 0, source="a panel", holder=control)
    control.update(S, 0.01)
    control.running.client_disconnected(control)
    (event,) = control.events()
    assert event.text == (
        "outputs: a panel is gone, so its command has ended; its outputs are at their safe values, "
        "kept_outputs are unchanged"
    )


def test_the_safe_value_of_the_hardware_is_the_default_and_it_is_reported_with_where_an_output_is_released():
    hardware = Hardware(*OUTPUTS, states=STATES)
    for each, safe in zip(hardware.command_interfaces, (1.0, math.nan, None), strict=True):
        each.safe = safe
    control = manager(hardware)
    add(control, "outputs", GPIO, gpios=["io", "valve"], command_interfaces=BOTH)
    control.switch(["outputs"], now=0)
    control.command("outputs", [0.5, 0.5, 0.5], 0)
    control.update(S, 0.01)
    control.running.forget(S, "stop was commanded")
    assert hardware.values() == [1.0, 0.5, 0.0]
    assert [interface.release_value for interface in hardware.command_interfaces] == [None] * 3
    control.switch((), ["outputs"], now=S)
    assert same([interface.release_value for interface in hardware.command_interfaces], [1.0, math.nan, 0.0])


def test_outputs_of_a_node_that_is_lost_end_alone():
    hardware = Hardware(*OUTPUTS, states=STATES)
    control = manager(hardware, enable_status=DriveEnableStatus({}))
    add(control, "outputs", GPIO, gpios=["io", "valve"], command_interfaces=BOTH)
    control.switch(["outputs"], now=0)
    control.command("outputs", [1.0, 1.0, 1.0], 0)
    control.update(S, 0.01)
    hardware.command_interfaces[2].enabled = False
    control.update(2 * S, 0.01)
    assert hardware.values() == [1.0, 1.0, 0.0]
    with pytest.raises(ControlError, match="cannot set valve/open, because its node is not present"):
        control.command("outputs", {"io/lamp": 0.0, "valve/open": 1.0}, 2 * S)
    control.command("outputs", {"io/lamp": 0.5}, 2 * S)
    hardware.command_interfaces[2].enabled = True
    control.update(3 * S, 0.01)
    assert hardware.values() == [0.5, 1.0, 0.0]


def test_a_safe_command_outlives_its_client():
    _, control = robot(kept_outputs=["valve/open"])
    control.command("outputs", {"io/lamp": 0.0, "valve/open": 1.0}, 0, holder=control)
    assert control.running.clients_with_commands == set()
    control.command("outputs", {"io/horn": 1.0}, 0, holder=control)
    assert control.running.clients_with_commands == {control}


def test_a_time_out_is_reported_once_and_the_next_command_takes_over():
    hardware, control = robot(command_timeout=0.5)
    control.events()
    control.command("outputs", {"io/lamp": 1.0}, 0)
    for step in range(4):
        control.update((1 + step) * S, 0.01)
    (event,) = control.events()
    assert event.text == "outputs: no command for 1.00 s, its outputs are at their safe values"
    control.command("outputs", {"io/lamp": 1.0}, 5 * S)
    control.update(5 * S, 0.01)
    assert hardware.values()[0] == 1.0


def test_inputs_and_outputs_are_reported_by_part_and_name():
    hardware, control = robot(state_interfaces={"io": {"interfaces": ["pressed"]}})
    hardware.set("io/pressed", 1.0)
    assert control.list()[0].required_state_interfaces == ("*",)
    control.update(S, 0.01)
    sample = control.get("outputs").sample(0)
    assert (sample.time, control.list()[0].tells) == (1.0, "gpio")
    assert sample.parts == {"io": {"pressed": 1.0}, "valve": {"open": None, "pressure": None}}


def test_named_inputs_are_all_that_it_reads():
    names = {"io": {"interfaces": ["pressed"]}, "valve": {"interfaces": ["pressure"]}}
    _, control = robot(state_interfaces=names)
    assert control.list()[0].required_state_interfaces == ("io/pressed", "valve/pressure")
    assert control.get("outputs").sample(0).parts == {"io": {"pressed": None}, "valve": {"pressure": None}}


def test_without_command_interfaces_it_only_reports():
    hardware, control = robot(command_interfaces={})
    control.update(S, 0.01)
    assert control.get("outputs").sample(0).parts["io"] == {"pressed": None, "lamp": None}
    with pytest.raises(ControlError, match="has no command_interfaces; it only publishes states"):
        control.command("outputs", {"io/lamp": 1.0}, 0)
    control.switch((), ["outputs"], now=S)
    assert same(hardware.values(), [NAN, NAN, NAN])


@pytest.mark.parametrize(
    ("params", "error", "words"),
    [
        ({"command_interfaces": {"io": {"interfaces": ["bell"]}}}, UnknownInterface, "io/bell"),
        ({"state_interfaces": {"io": {"interfaces": ["presed"]}}}, ControlError, "io/presed"),
        ({"gpios": ["io", "valve", "pump"]}, ControlError, "<gpio> 'pump' has no interfaces"),
    ],
)
def test_an_interface_that_is_not_there_is_refused_when_it_is_activated(params, error, words):
    with pytest.raises(error, match=words):
        robot(**params)


def test_an_inactive_controller_takes_no_command():
    _, control = robot()
    control.switch((), ["outputs"], now=0)
    with pytest.raises(ControlError, match="is inactive; activate it before commanding it"):
        control.command("outputs", {"io/lamp": 1.0}, 0)


def test_other_controllers_take_nothing_by_name():
    control = manager(Hardware("l/velocity"))
    add(control, "forward", "forward_command_controller/ForwardCommandController", joints=["l"],
        interface_name="velocity")  # fmt: skip
    control.switch(["forward"], now=0)
    with pytest.raises(ControlError, match="accepts no values by interface name"):
        control.command("forward", {"l/velocity": 1.0}, 0)


@given(
    st.lists(
        st.one_of(
            st.dictionaries(st.sampled_from(OUTPUTS), st.floats(-2, 2), min_size=1),
            st.sampled_from(["stop", "bad", "update"]),
        ),
        max_size=20,
    )
)
def test_outputs_are_what_was_commanded_last_since_the_last_stop_else_safe(steps):
    hardware, control = robot()
    expected = dict.fromkeys(OUTPUTS, NAN)
    for at, step in enumerate(steps, 1):
        if isinstance(step, dict):
            control.command("outputs", step, at)
            expected.update(step)
        elif step == "stop":
            control.running.forget(at, "stop")
            expected = {name: value if math.isnan(value) else 0.0 for name, value in expected.items()}
        elif step == "bad":
            with pytest.raises(ControlError):
                control.command("outputs", {"io/lamp": 1.5, "io/horn": NAN}, at)
        control.update(at, 0.01)
        assert same(hardware.values(), expected.values())


# -- canopen device


TYPES = {
    "canopen_ros2_controllers/CanopenProxyController": CanopenProxyController,
    "canopen_ros2_controllers/Cia402DeviceController": Cia402DeviceController,
}


@pytest.mark.parametrize("type_name", TYPES)
def test_it_stands_alongside_the_controller_that_moves_its_joint_and_claims_nothing(type_name):
    control = manager(wheels())
    add(control, "wheels", FORWARD, joints=["l", "r"], interface_name="velocity")
    device = add(control, "device", type_name, joint="l")
    assert type(device) is TYPES[type_name]
    control.switch(["wheels", "device"], now=0)
    control.update(S, 0.01)
    reading = control.list()[1]
    assert (reading.state, reading.joints, reading.claims, reading.topic, reading.tells) == (
        "active",
        ("l",),
        (),
        None,
        None,
    )
    assert not device.moves_joints


@pytest.mark.parametrize("type_name", TYPES)
def test_without_a_joint_it_reports_where_to_give_one(type_name):
    with pytest.raises(RobotConfigError, match="device: no 'joint'; give it under device: ros__parameters: joint:"):
        add(manager(wheels()), "device", type_name)


# -- gpio params


IO = {"gpios": ["io", "valve"], "command_interfaces": {"io": {"interfaces": ["lamp", "horn"]}}}


def read(joints=(), **more):
    return read_params(Params.of({**IO, **more}), "outputs", joints)


def test_outputs_and_inputs_are_in_the_order_of_the_parameters():
    both = {"valve": {"interfaces": ["open"]}, "io": {"interfaces": ["horn", "lamp"]}}
    arguments = read(command_interfaces=both, state_interfaces={"io": {"interfaces": ["pressed"]}})
    assert arguments.outputs == ["io/horn", "io/lamp", "valve/open"]
    assert arguments.inputs == ["io/pressed"]
    assert arguments.unnamed_gpios == ["valve"]


def test_an_output_is_safe_at_zero_unless_another_value_is_written_or_it_is_kept():
    inputs = read(safe_values={"io": {"horn": 0.5}}, kept_outputs=["io/lamp"])
    assert inputs.safe_value("io/horn", 1.0) == 0.5
    assert math.isnan(inputs.safe_value("io/lamp", 1.0))
    assert read().safe_value("io/lamp", None) == 0.0
    assert read().safe_value("io/lamp", 1.0) == 1.0
    assert math.isnan(read().safe_value("io/lamp", math.nan))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"gpios": []}, "no 'gpios'; give it"),
        ({"gpios": ["io", "io"]}, "gpios contains a name twice"),
        (
            {"command_interfaces": {"i": {"interfaces": ["lamp"]}}},
            "command_interfaces.i.interfaces is not NAME.interfaces",
        ),
        ({"state_interfaces": {"io": {"lamp": ["lamp"]}}}, "state_interfaces.io.lamp is not NAME.interfaces"),
        ({"command_interfaces": {"io": {"interfaces": ["lamp", "lamp"]}}}, "contains a name twice: lamp; list"),
        ({"safe_values": {"io": {"lmp": 1.0}}}, "safe_values.io.lmp is not in command_interfaces"),
        ({"safe_values": {"io": {"lamp": math.inf}}}, "safe_values.io.lamp is inf; give a finite number"),
        ({"kept_outputs": ["lamp"]}, "kept_outputs: 'lamp' is not in command_interfaces"),
    ],
)
def test_what_cannot_be_is_reported_with_its_name(more, words):
    with pytest.raises(RobotConfigError, match=r"^outputs: ") as caught:
        read(**more)
    assert words in str(caught.value)


@pytest.mark.parametrize("interface", ["position", "velocity", "effort", "acceleration"])
def test_what_moves_a_joint_is_not_an_output(interface):
    both = {"gpios": ["wheel"], "command_interfaces": {"wheel": {"interfaces": [interface]}}}
    with pytest.raises(RobotConfigError, match="moves a joint and is not an output"):
        read(joints=("wheel",), **both)
    assert read(joints=("arm",), **both).outputs == [f"wheel/{interface}"]
