from __future__ import annotations

import pytest
from support.control import Hardware, S, add, manager

from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import ReturnType

DRIVE = ("nmt_state", "statusword", "error_code", "age", "digital_inputs", "position")
GPIO = "canopen_control/GpioBroadcaster"
DIAGNOSTICS = "canopen_control/DiagnosticsBroadcaster"


def robot(type_name, *extra, **params):
    states = (*(f"{joint}/{name}" for joint in ("l", "r") for name in DRIVE), *extra)
    hardware = Hardware("l/velocity", states=states)
    control = manager(hardware)
    broadcaster = add(control, "b", type_name, **params)
    return hardware, control, broadcaster


def test_inputs_of_all_drives_are_told_by_themselves():
    hardware, control, gpio = robot(GPIO)
    control.switch(["b"], now=0)
    hardware.set("r/digital_inputs", 5.0)
    control.broadcast(S, 0.01)
    sample = gpio.sample(0)
    assert (sample.time, sample.parts) == (1.0, {"l": {"digital_inputs": None}, "r": {"digital_inputs": 5.0}})
    assert gpio.joints == ("l", "r")
    assert control.list()[0].tells == "gpio"
    assert control.list()[0].is_broadcaster


def test_a_gpio_part_is_told_whole_when_it_is_named():
    _, control, gpio = robot(GPIO, "io/out", "io/in", joints=["io"])
    control.switch(["b"], now=0)
    assert gpio.sample(0).parts == {"io": {"out": None, "in": None}}


def test_joints_and_interfaces_together_restrict_exactly():
    _, control, gpio = robot(GPIO, joints=["r"], interfaces=["position"])
    assert gpio.state_interface_names() == ["r/position"]
    control.switch(["b"], now=0)
    assert gpio.sample(0).parts == {"r": {"position": None}}


def test_nothing_to_tell_is_refused_in_words():
    _, control, _ = robot(GPIO, interfaces=["analog"])
    with pytest.raises(ControlError, match="no joint has a state of analog"):
        control.switch(["b"], now=0)


@pytest.mark.parametrize(
    ("values", "level", "message"),
    [
        ({"nmt_state": 5.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02}, 0, "operational"),
        ({"nmt_state": 5.0, "statusword": 0x40, "error_code": 0.0, "age": 0.02}, 1, "not enabled: switch on disabled"),
        ({"nmt_state": 42.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02}, 1, "not ready, NMT state 42"),
        (
            {"nmt_state": 127.0, "statusword": 0x27, "error_code": 0.0, "age": 0.02},
            1,
            "not ready, NMT state pre-operational",
        ),
        ({"nmt_state": 5.0, "statusword": 0x08, "error_code": 0.0, "age": 0.02}, 2, "the drive is in fault"),
        ({"nmt_state": 5.0, "statusword": 0x08, "error_code": 0x2310, "age": 0.02}, 2, "error code 0x2310"),
        ({"nmt_state": 5.0, "statusword": 0x27, "error_code": 0.0, "age": 0.75}, 3, "no news for 0.75 s"),
        ({}, 3, "nothing is heard of it"),
    ],
)
def test_the_diagnostics_judge_a_joint_by_what_its_drive_says(values, level, message):
    hardware, control, diagnostics = robot(DIAGNOSTICS)
    control.switch(["b"], now=0)
    for name, value in values.items():
        hardware.set(f"l/{name}", value)
    assert diagnostics.update(S, 0.02) is ReturnType.OK
    sample = diagnostics.sample(0)
    status = sample.joints[0]
    assert sample.time == 1.0
    assert (status.name, status.level, status.message) == ("l", level, message)
    assert set(status.values) == {"nmt_state", "statusword", "error_code", "age"}
    assert values or status.values["age"] is None


def test_who_only_tells_runs_when_the_commands_are_on_their_way_and_one_that_commands_does_not():
    hardware = Hardware(states=("a/position",))
    control = manager(hardware)
    states = add(control, "states", "joint_state_broadcaster/JointStateBroadcaster")
    control.switch(["states"], now=0)
    hardware.set("a/position", 1.5)
    control.update(S, 0.01)
    assert states.sample(0).joints == {"a": {"position": None}}
    control.broadcast(S, 0.01)
    assert (states.sample(0).joints, states.stamp) == ({"a": {"position": 1.5}}, S)
