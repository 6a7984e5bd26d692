from __future__ import annotations

import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import BROADCASTER, FORWARD, Hardware, S, Scripted, add, manager, put, three_on_two_wheels, wheels

from canopen_control.controllers.base import Controller, ControllerState
from canopen_control.controllers.manager import ControllerManager
from canopen_control.controllers.params import Params
from canopen_control.errors import ControlError, InterfaceConflict, NotEnabled, RobotConfigError, UnknownInterface
from canopen_control.hardware.interfaces import InterfaceRegistry, LifecycleState, ReturnType
from canopen_control.rpc.messages.samples import GpioSample, OdometrySample
from canopen_control.rpc.wire import plain


@pytest.fixture
def robot():
    return three_on_two_wheels()


def states(control: ControllerManager) -> dict[str, str]:
    return {item.name: item.state for item in control.list()}


def test_a_controller_is_loaded_configured_activated_deactivated_and_unloaded(robot):
    _, control = robot
    control.load("new", FORWARD, Params.of({"joints": ["l"], "interface_name": "velocity"}))
    assert states(control)["new"] == "unconfigured"
    control.configure("new")
    assert states(control)["new"] == "inactive"
    assert control.switch(["new"], now=0).activated == ("new",)
    with pytest.raises(ControlError, match="is active; deactivate it before unloading"):
        control.unload("new")
    with pytest.raises(ControlError, match="is active; deactivate it before configuring"):
        control.configure("new")
    assert control.switch(deactivate=["new"]).deactivated == ("new",)
    control.unload("new")
    with pytest.raises(ControlError, match="no controller 'new' is loaded"):
        control.get("new")


def test_parameters_that_are_refused_leave_the_controller_unconfigured(robot):
    _, control = robot
    control.load("bad", FORWARD, Params.of({"joints": 3}))
    with pytest.raises(RobotConfigError):
        control.configure("bad")
    assert states(control)["bad"] == "unconfigured"
    with pytest.raises(ControlError, match="cannot activate bad: it is unconfigured"):
        control.switch(["bad"])
    with pytest.raises(ControlError, match="already loaded"):
        control.load("bad", FORWARD)


def test_a_claimed_interface_refuses_the_whole_request_in_both_strictnesses(robot):
    hardware, control = robot
    control.switch(["left"], now=0)
    for strict in (True, False):
        with pytest.raises(InterfaceConflict, match="l/velocity is claimed by left"):
            control.switch(["right", "both"], strict=strict)
        with pytest.raises(InterfaceConflict):
            control.switch(["both", "right"], ["left"], strict=strict)
    assert control.active == ("left",)
    assert [interface.owner for interface in hardware.command_interfaces] == ["left", None]


def test_strict_refuses_what_is_impossible_and_best_effort_drops_it(robot):
    _, control = robot
    control.switch(["left"], now=0)
    for activate, deactivate, text in (
        (["right", "nobody"], [], "cannot activate 'nobody'"),
        (["right", "left"], [], "cannot activate left: it is active"),
        (["right"], ["states"], "cannot deactivate states: it is inactive"),
    ):
        with pytest.raises(ControlError, match=text):
            control.switch(activate, deactivate)
        assert control.active == ("left",)
        assert control.switch(activate, deactivate, strict=False).activated == ("right",)
        control.switch(deactivate=["right"])


def test_an_unknown_name_is_answered_with_the_nearest(robot):
    _, control = robot
    with pytest.raises(ControlError, match="did you mean 'right'"):
        control.switch(["rigth"])
    with pytest.raises(ControlError, match=r"unknown type '[\w/]+Controler' \(did you"):
        control.load("x", "forward_command_controller/ForwardCommandControler")


def test_hardware_that_is_not_active_can_not_be_claimed(robot):
    hardware, control = robot
    hardware.state = LifecycleState.INACTIVE
    with pytest.raises(ControlError, match="hardware 'base', which is inactive"):
        control.switch(["left"])
    assert control.switch(["states"], now=0).activated == ("states",)


@pytest.mark.parametrize("result", [ReturnType.ERROR, ValueError("boom")])
def test_a_controller_whose_update_fails_is_stopped_and_the_others_run_on(result):
    hardware = wheels()
    control = manager(hardware)
    bad, good = put(control, Scripted("bad", "l")), put(control, Scripted("good", "r"))
    control.switch(["bad", "good"], now=0)
    control.update(S, 0.01)
    bad.result = result
    control.events()
    control.update(2 * S, 0.01)
    assert control.active == ("good",)
    assert hardware.values() == [0.0, 5.0]
    assert hardware.calls[-1] == ("perform", (), ("l/velocity",))
    assert [(event.kind, event.controller) for event in control.events()] == [("error", "bad")]
    control.update(3 * S, 0.01)
    assert len(good.runs) == 3


def test_a_hardware_error_deactivates_its_controllers_and_names_the_cause():
    left, right = Hardware("l/velocity", name="a"), Hardware("r/velocity", states=("r/position",), name="b")
    control = manager(left, right)
    for name in "lr":
        add(control, name, FORWARD, joints=[name], interface_name="velocity")
    add(control, "states", BROADCASTER)
    control.switch(["l", "r", "states"], now=0)
    control.command("l", [4.0], 0)
    control.update(0, 0.01)
    control.events()
    assert control.deactivate_using(left, "node 3 is gone") == ["l"]
    assert control.active == ("r", "states")
    assert left.values() == [0.0]
    assert [event.text for event in control.events()] == ["l was deactivated: node 3 is gone"]
    assert control.deactivate_using(left, "again") == []


@pytest.mark.parametrize(("rate", "runs"), [(0, 100), (100, 100), (50, 50), (33, 33), (10, 10), (1, 1), (1000, 100)])
def test_a_controller_runs_at_its_own_rate(rate, runs):
    control = manager(wheels())
    each = put(control, Scripted("slow"), rate)
    control.switch(["slow"], now=0)
    for step in range(100):
        control.update(step * S // 100, 0.01)
    assert abs(len(each.runs) - runs) <= 1
    if 0 < rate < 100:
        assert math.isclose(sum(period for _, period in each.runs), 1.0, abs_tol=1.5 / rate)


def test_a_rate_above_the_managers_is_reported():
    control = manager(wheels())
    put(control, Scripted("fast"), 1000)
    assert [event.kind for event in control.events()] == ["update_rate"]


def test_the_list_reports_what_a_client_shows(robot):
    _, control = robot
    control.switch(["both"], now=0)
    info = plain(control.list()[0])
    assert info == {
        "name": "both",
        "type": FORWARD,
        "state": "active",
        "joints": ["l", "r"],
        "interface": "velocity",
        "claimed_interfaces": ["l/velocity", "r/velocity"],
        "required_command_interfaces": ["l/velocity", "r/velocity"],
        "required_state_interfaces": [],
        "reference_interfaces": [],
        "exported_state_interfaces": [],
        "topic": "commands",
        "twist_axes": [],
        "publishes": [],
        "frame_id": "",
        "tells": None,
        "offers": [],
        "is_broadcaster": False,
        "rejected": 0,
        "update_rate": 100,
        "publish_rate": 0.0,
        "node_options": [],
    }
    assert control.list()[-1].topic is None


def test_unknown_parameters_come_out_as_events(robot):
    _, control = robot
    add(control, "odd", FORWARD, joints=["l"], interface_name="velocity", comand_timeout=1.0)
    assert "did you mean 'command_timeout'?" in control.events()[-1].text


def test_an_update_rate_of_nothing_is_refused():
    with pytest.raises(ControlError, match="update_rate is 0"):
        ControllerManager(InterfaceRegistry(), 0)


def test_the_cycle_allocates_nothing_that_stays(robot):
    _, control = robot
    control.switch(["both", "states"], now=0)
    control.command("both", [1.0, 2.0], 0)
    for step in range(200):
        control.update(step * S // 100, 0.01)
    before = sys.getallocatedblocks()
    for step in range(200, 2200):
        control.update(step * S // 100, 0.01)
    assert sys.getallocatedblocks() - before < 20


NAMES = st.lists(st.sampled_from(["both", "left", "right", "states", "nobody"]), max_size=4)


@given(st.lists(st.tuples(NAMES, NAMES, st.booleans()), max_size=12))
def test_whatever_is_switched_every_interface_has_one_active_owner_or_none(requests):
    hardware = wheels()
    control = manager(hardware)
    for name, joints in (("both", ["l", "r"]), ("left", ["l"]), ("right", ["r"])):
        add(control, name, FORWARD, joints=joints, interface_name="velocity")
    add(control, "states", BROADCASTER)
    for number, (activate, deactivate, strict) in enumerate(requests):
        before = control.active, [interface.owner for interface in hardware.command_interfaces]
        try:
            control.switch(activate, deactivate, strict=strict, now=number * S)
        except (ControlError, UnknownInterface):
            after = control.active, [interface.owner for interface in hardware.command_interfaces]
            assert after == before
        control.update(number * S, 0.01)
        for interface in hardware.command_interfaces:
            owners = [name for name in control.active if interface.name in control.get(name).command_interface_names()]
            assert owners == ([interface.owner] if interface.owner else [])
        for info in control.list():
            assert (info.state == ControllerState.ACTIVE.value) == (info.name in control.active)


def fallen_back(**how):
    """Return manager, the controller that fails and its fallback, after the failure."""
    control = manager(wheels())
    bad, safe = Scripted("bad", **how), Scripted("safe")
    put(control, bad)
    put(control, safe)
    control._fallbacks["bad"] = ("safe",)
    control.switch(["bad"], now=0)
    bad.result = ReturnType.ERROR
    control.events()
    control.update(S, 0.01)
    return control, bad, safe


def test_a_fallback_takes_over_from_a_controller_that_fails():
    control, bad, _ = fallen_back()
    assert control.active == ("safe",)
    assert bad.state is ControllerState.INACTIVE
    assert "safe took over from bad" in [event.text for event in control.events() if event.kind == "fallback"]
    control.update(2 * S, 0.01)
    assert control.registry.command("l/velocity").value == 5.0


def test_a_fallback_that_cannot_take_over_is_reported_and_the_cycle_continues():
    control = manager(wheels())
    put(control, Scripted("bad"))
    control._fallbacks["bad"] = ("nobody",)
    control.switch(["bad"], now=0)
    control.get("bad").result = ReturnType.ERROR
    control.update(S, 0.01)
    assert control.active == ()
    assert "its fallbacks cannot take over: cannot activate 'nobody'" in control.events()[-1].text


def test_a_limiter_runs_in_every_cycle_and_its_result_is_reported():
    class Limits:
        def enforce(self, period):
            return f"l is limited after {period} s"

    control = manager(wheels())
    control.limiter = Limits()
    control.update(S, 0.01)
    assert control.events()[-1].text == "enforce_command_limits: l is limited after 0.01 s"


class Telling(Controller):
    tells = GpioSample

    def sample(self, wall_offset_ns):
        if isinstance(self.collected, Exception):
            raise self.collected
        return self.collected


def test_a_controller_without_a_sample_has_none_and_one_that_raises_has_failed():
    control = manager(wheels())
    put(control, Scripted("plain"))
    for name in ("silent", "broken", "wrong"):
        put(control, Telling(name))
    names = ("silent", "broken", "wrong")
    silent, broken, wrong = (control.get(name) for name in names)
    silent.collected, broken.collected = None, ZeroDivisionError("no")
    wrong.collected = OdometrySample(time=0.0, x=0.0, y=0.0, heading=0.0)
    control.switch(["plain", *names], now=0)
    control.events()
    for _ in range(2):
        assert control.running.samples(0) == {}
    silent.collected = GpioSample(time=1.0, parts={})
    assert control.running.samples(0) == {"silent": silent.collected}
    control.update(S, 0.01)
    assert control.active == ("plain", "silent")
    one, other = (event.text for event in control.events())
    assert "broken was deactivated: sample raised ZeroDivisionError: no" in one
    assert "wrong was deactivated: sample returned OdometrySample, not the class's `sample_type`" in other


def test_a_command_is_refused_while_its_drive_is_off_and_counts_for_nothing_afterwards():
    hardware = wheels()
    control = manager(hardware)
    add(control, "left", FORWARD, joints=["l"], interface_name="velocity")
    control.switch(["left"], now=0)
    left = hardware.command_interfaces[0]
    left.enabled = False
    with pytest.raises(NotEnabled):
        control.command("left", [3.0], 0)
    left.enabled = True
    control.update(S // 100, 0.01)
    assert not left.value > 0.0


def test_a_joint_that_does_not_follow_an_accepted_command_is_named_once_with_the_reason(robot):
    hardware, control = robot
    control.switch(["both"], now=0)
    control.events()
    left = hardware.command_interfaces[0]
    left.enabled, left.excluded = False, True  # a user has disabled only this axis
    for now in range(3):
        assert control.command("both", [1.0, 2.0], now) == {"l": "not enabled; enable it"}
    (event,) = control.events()
    assert (event.kind, event.text) == (
        "not_followed",
        "both: l does not follow: not enabled; enable it (reported once)",
    )
    assert control.command("both", [0.0, 2.0], 4) == {}  # standstill needs no drive
    control.command("both", [1.0, 2.0], 5)
    assert not control.events()
    left.enabled, left.excluded = True, False
    assert control.command("both", [1.0, 2.0], 6) == {}
    left.enabled, left.excluded = False, True
    control.command("both", [1.0, 2.0], 7)
    assert [event.kind for event in control.events()] == ["not_followed"]


@pytest.mark.parametrize(("target", "idle"), [(0.5, []), (0.6, ["l"])])
def test_a_disabled_joint_that_is_at_its_commanded_position_is_not_named(target, idle):
    hardware = Hardware("l/position", "r/position", states=("l/position", "r/position"))
    control = manager(hardware)
    add(control, "both", FORWARD, joints=["l", "r"], interface_name="position")
    control.switch(["both"], now=0)
    hardware.set("l/position", 0.5)
    left = hardware.command_interfaces[0]
    left.enabled, left.excluded = False, True
    assert list(control.command("both", [target, 1.0], 0)) == idle


def test_a_command_that_the_range_of_its_interface_keeps_at_zero_moves_nothing(robot):
    hardware, control = robot
    control.switch(["both"], now=0)
    for command in hardware.command_interfaces:
        command.minimum = command.maximum = 0.0
    reason = "min and max of the command interface l/velocity are 0 in the description"
    assert control.command("both", [0.0, 0.0], 1) == {}
    assert control.immobile == {}
    assert control.command("both", [1.0, 0.0], 2) == {"l": reason, "r": reason}
    assert control.immobile == {"both": reason}
    hardware.command_interfaces[1].maximum = 2.0
    assert control.command("both", [1.0, 2.0], 3) == {}
    assert control.immobile == {"both": ""}
