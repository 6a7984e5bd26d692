from __future__ import annotations

import pytest
from support.control import FORWARD, Hardware, add, manager

from canopen_control.controllers.switcher import make_plan
from canopen_control.errors import ControlError, InterfaceConflict


def plan(control, activate=(), deactivate=(), *, strict=True):
    return make_plan(control._controllers, control.registry, activate, deactivate, strict=strict)


def robot():
    hardware = Hardware("a/velocity", "b/velocity"), Hardware("c/velocity", name="other")
    control = manager(*hardware)
    for name, joints in (("ab", ["a", "b"]), ("b", ["b"]), ("bc", ["b", "c"])):
        add(control, name, FORWARD, joints=joints, interface_name="velocity")
    return hardware, control


def test_each_component_is_asked_for_its_own_interfaces_only():
    (first, second), control = robot()
    assert plan(control, ["bc"]).switches == ((first, ("b/velocity",), ()), (second, ("c/velocity",), ()))
    control.switch(["bc"], now=0)
    assert plan(control, ["ab"], ["bc"]).switches == (
        (first, ("a/velocity", "b/velocity"), ("b/velocity",)),
        (second, (), ("c/velocity",)),
    )


def test_a_plan_changes_nothing():
    (first, _), control = robot()
    plan(control, ["ab"])
    assert control.active == ()
    assert first.calls == []
    assert first.command_interfaces[0].owner is None


def test_names_given_twice_count_once():
    _, control = robot()
    assert len(plan(control, ["b", "b"]).activate) == 1
    with pytest.raises(InterfaceConflict, match="b/velocity is claimed by b;"):
        plan(control, ["b", "bc"])
    with pytest.raises(ControlError, match="no controller of this name"):
        plan(control, deactivate=["x"])
    assert plan(control, ["x"], ["y"], strict=False).activate == ()
