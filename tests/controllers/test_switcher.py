from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from support.control import FORWARD, Hardware, Scripted, add, manager, put, three_on_two_wheels, wheels

from canopen_control.controllers.switcher import plan_switch
from canopen_control.errors import ControlError, UnsupportedMode


def plan(control, activate=(), deactivate=(), *, strict=True):
    return plan_switch(control._controllers, control.registry, activate, deactivate, strict=strict)


def robot_of_claims():
    hardware = Hardware("a/velocity", "b/velocity"), Hardware("c/velocity", name="other")
    control = manager(*hardware)
    for name, joints in (("ab", ["a", "b"]), ("b", ["b"]), ("bc", ["b", "c"])):
        add(control, name, FORWARD, joints=joints, interface_name="velocity")
    return hardware, control


def test_a_plan_changes_nothing():
    (first, _), control = robot_of_claims()
    plan(control, ["ab"])
    assert control.active == ()
    assert first.calls == []
    assert first.command_interfaces[0].owner is None


@pytest.fixture
def robot():
    return three_on_two_wheels()


def test_a_controller_that_fails_to_start_takes_its_whole_request_back(robot):
    hardware, control = robot
    bad = put(control, Scripted("bad", "r"))
    bad.start_error = RuntimeError("no")
    with pytest.raises(ControlError, match="bad could not be activated: no"):
        control.switch(["left", "bad"], now=0)
    assert control.active == ()
    assert [interface.owner for interface in hardware.command_interfaces] == [None, None]
    assert hardware.calls[-1][0] == "perform"
    assert set(hardware.calls[-1][2]) == {"l/velocity", "r/velocity"}


def test_a_failing_deactivation_hook_still_leaves_zero_targets():
    hardware = wheels()
    control = manager(hardware)
    bad = put(control, Scripted("bad"))
    bad.on_deactivate = lambda now: 1 / 0
    control.switch(["bad"], now=0)
    control.update(0, 0.01)
    control.switch(deactivate=["bad"])
    assert hardware.values()[0] == 0.0
    assert hardware.command_interfaces[0].owner is None
    assert "on_deactivate raised ZeroDivisionError" in control.events()[-1].text


def test_a_swap_is_one_request(robot):
    hardware, control = robot
    control.switch(["left", "right"], now=0)
    hardware.calls.clear()
    done = control.switch(["both"], ["left", "right"])
    assert (done.activated, done.deactivated) == (("both",), ("left", "right"))
    names = ("l/velocity", "r/velocity")
    assert hardware.calls == [("prepare", names, names), ("perform", names, names)]
    assert [interface.owner for interface in hardware.command_interfaces] == ["both", "both"]


def test_what_hardware_refuses_changes_nothing(robot):
    hardware, control = robot
    control.switch(["left"], now=0)
    hardware.calls.clear()
    hardware.refuse = UnsupportedMode("velocity", ("position",))
    with pytest.raises(UnsupportedMode):
        control.switch(["right"], ["left"])
    assert [verb for verb, _, _ in hardware.calls] == ["prepare"]
    assert control.active == ("left",)
    assert control.states["left"] == "active"
    assert [interface.owner for interface in hardware.command_interfaces] == ["left", None]


def test_a_restart_of_an_active_controller_is_one_request(robot):
    _, control = robot
    control.switch(["left"], now=0)
    control.command("left", [3.0], 0)
    assert control.switch(["left"], ["left"]).activated == ("left",)
    assert math.isnan(control.get("left").commands[0].value)


def test_others_are_notified_of_every_switch_and_of_every_failure(robot):
    _, control = robot
    observed = []
    control.observe(SimpleNamespace(controllers_switched=lambda: observed.append(control.active)))
    control.switch(["left"], now=0)
    control.switch(["right"], ["left"])
    control.deactivate_using(robot[0], "gone")
    assert observed == [("left",), ("right",), ()]
