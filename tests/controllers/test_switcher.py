from __future__ import annotations

import math
from itertools import pairwise
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import BROADCASTER, FORWARD, Hardware, S, Scripted, add, manager, put, three_on_two_wheels, wheels

from canopen_control.controllers.base import Controller
from canopen_control.controllers.switcher import (
    NOT_DUE,
    ActiveController,
    InterfaceGroup,
    Rate,
    in_order,
    joints_of,
    plan_switch,
    users_of,
)
from canopen_control.errors import ControlError, UnsupportedMode
from canopen_control.hardware.interfaces import CommandInterface, ReturnType, StateInterface


def steps(rate, period_ms, cycles=100, start=1):
    """Return (ms, elapsed) of the steps that a rate takes in cycles of `period_ms`."""
    result = ((ms, rate.step(ms * S // 1000, period_ms / 1000)) for ms in range(start, cycles * period_ms, period_ms))
    return [(ms, elapsed) for ms, elapsed in result if elapsed != NOT_DUE]


def test_without_a_rate_every_cycle_is_a_step_of_its_period():
    assert steps(Rate(0), 20, cycles=3) == [(1, 0.02), (21, 0.02), (41, 0.02)]


def test_a_rate_that_does_not_divide_it_takes_the_nearest_cycle():
    assert [ms for ms, _ in steps(Rate(30), 10, cycles=10)] == [1, 31, 61, 91]  # 33.3 Hz, as ros2_control has it
    assert [ms for ms, _ in steps(Rate(60), 10, cycles=6)] == [1, 21, 41]
    assert [ms for ms, _ in steps(Rate(90), 10, cycles=4)] == [1, 11, 21, 31]


@given(st.integers(1, 1000), st.integers(1, 50), st.lists(st.integers(-1_000_000, 1_000_000), min_size=60, max_size=60))
def test_steps_come_at_the_rate_whatever_the_jitter(hz, period_ms, jitter):
    rate, taken = Rate(hz), []
    for cycle, late in enumerate(jitter, 1):
        now = (cycle * period_ms + 5) * S // 1000 + late * period_ms // 3
        elapsed = rate.step(now, period_ms / 1000)
        if elapsed != NOT_DUE:
            taken.append((now, elapsed))
    assert math.isclose(taken[0][1], 1 / hz, rel_tol=1e-6)
    for (before, _), (now, elapsed) in pairwise(taken):
        assert elapsed == (now - before) / S
        # no more than a cycle from its period, or every cycle where that is longer
        assert elapsed >= min(1 / hz, period_ms / 1000) * 0.3
        assert elapsed <= max(1 / hz, period_ms / 1000) + 1.7 * period_ms / 1000


def interfaces(*names):
    return tuple(CommandInterface(name, "velocity") for name in names)


def test_a_part_follows_as_a_whole_but_for_what_is_set_aside():
    one, other = ends = interfaces("a", "b")
    part = InterfaceGroup(ends)
    assert part.enabled
    one.enabled = False
    assert not part.follows()
    one.excluded = True
    assert part.follows()
    other.enabled = False
    assert not part.follows()
    assert InterfaceGroup(()).follows()


def test_a_slot_follows_while_one_of_its_parts_does_and_names_those_that_do_not():
    a, b = interfaces("a", "b")
    slot = ActiveController(Controller("c"), 0, [(a,), (b,)])
    a.enabled = False
    assert slot.follows
    assert slot.disabled == [a]
    b.enabled = False
    assert not slot.follows
    assert ActiveController(Controller("tells"), 0, []).follows


def test_what_was_enabled_in_the_last_cycle_and_its_rhythm_outlive_a_switch():
    (a,) = ends = interfaces("a")
    before = ActiveController(Controller("c"), 10, [ends])
    before.rate.step(S, 0.02)
    a.enabled = False  # since the last cycle
    after = ActiveController(before.controller, 10, [ends])
    assert not after.groups[0].enabled
    after.take_over(before, {a})
    assert after.groups[0].enabled
    assert after.rate.last == S


class Counting(Controller):
    """Records when it was run, and with which period."""

    def __init__(self, name="counting", rate=0):
        super().__init__(name)
        self.update_rate, self.runs = rate, []

    def update(self, now, period):
        self.runs.append((now * 1000 // S, round(period * 1000, 6)))
        return ReturnType.OK


class Telling(Counting):
    is_broadcaster = True


def run(control, cycles, cycle_ms):
    for cycle in range(1, cycles + 1):
        now = cycle * cycle_ms * S // 1000
        control.update(now, cycle_ms / 1000)
        control.broadcast(now, cycle_ms / 1000)


def put_of_running(control, *controllers):
    control.running.arrange(controllers, controllers)


def test_no_controller_runs_more_often_than_the_managers_update_rate():
    control = manager(Hardware(), rate=10, cycle=0.02)
    commands, tells, slow = Counting(), Telling("tells"), Counting("slow", 5)
    put_of_running(control, commands, tells, slow)
    run(control, 16, 20)
    assert commands.runs == tells.runs == [(20, 100.0), (120, 100.0), (220, 100.0), (320, 100.0)]
    assert slow.runs == [(20, 200.0), (220, 200.0)]


def test_limits_are_enforced_when_the_manager_runs_and_for_its_period():
    class Limiter:
        def __init__(self):
            self.periods = []

        def enforce(self, period):
            self.periods.append(period)

    control = manager(Hardware(), rate=10, cycle=0.02)
    control.limiter = Limiter()
    run(control, 11, 20)
    assert control.limiter.periods == [0.1, 0.1, 0.1]


def test_a_command_is_discarded_in_the_cycle_in_which_its_drive_is_disabled_even_if_no_controller_is_due():
    hardware = Hardware("l/velocity")
    control = manager(hardware, rate=10, cycle=0.02)
    add(control, "left", FORWARD, joints=["l"], interface_name="velocity")
    control.switch(["left"], now=0)
    control.command("left", [3.0], 0)
    run(control, 1, 20)
    assert hardware.values() == [3.0]
    hardware.command_interfaces[0].enabled = False
    control.update(40 * S // 1000, 0.02)
    assert hardware.values() == [0.0]


def test_a_joint_state_is_of_its_update_and_not_of_the_cycle():
    hardware = Hardware(states=("a/position",))
    control = manager(hardware, rate=10, cycle=0.02)
    add(control, "states", BROADCASTER)
    control.switch(["states"], now=0)
    observed = []
    for cycle in range(1, 12):
        hardware.set("a/position", float(cycle))
        control.broadcast(cycle * 20 * S // 1000, 0.02)
        sample = control.running.samples(0)["states"]
        observed.append((round(sample.time * 1000), sample.joints["a"]["position"]))
    assert list(dict.fromkeys(observed)) == [(20, 1.0), (120, 6.0), (220, 11.0)]


def test_the_end_of_a_client_ends_what_it_commands_and_no_more():
    hardware = Hardware("l/velocity", "r/velocity")
    control = manager(hardware, rate=50, cycle=0.02)
    for name, joint in (("left", "l"), ("right", "r")):
        add(control, name, FORWARD, joints=[joint], interface_name="velocity")
    control.switch(["left", "right"], now=0)
    first, second = object(), object()
    control.command("left", [1.0], 0, source="first", holder=first)
    control.command("left", [2.0], 0, source="second", holder=second)
    control.command("right", [3.0], 0, source="nobody's end ends it")
    control.running.client_disconnected(first)
    control.update(S // 50, 0.02)
    assert hardware.values() == [2.0, 3.0]
    control.running.client_disconnected(second)
    control.update(2 * S // 50, 0.02)
    assert hardware.values() == [0.0, 3.0]


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


class Link(Controller):
    def __init__(self, name: str, *commands: str) -> None:
        super().__init__(name)
        self.wanted, self.own = [f"{command}/velocity" for command in commands], [CommandInterface(name, "velocity")]

    def command_interface_names(self) -> list[str]:
        return self.wanted

    def reference_interfaces(self) -> list[CommandInterface]:
        return self.own


def names(controllers) -> list[str]:
    return [controller.name for controller in controllers]


def test_a_controller_runs_before_the_controllers_it_commands():
    bottom, middle, top, alone = Link("bottom"), Link("middle", "bottom"), Link("top", "middle"), Link("alone")
    assert names(in_order([bottom, alone, middle, top])) == ["top", "middle", "bottom", "alone"]


def test_a_reader_of_exported_states_is_chained_but_does_not_command_the_joints():
    class Exporter(Link):
        def exported_states(self) -> list[StateInterface]:
            return [StateInterface(self.name, "position")]

    class Reader(Link):
        def state_interface_names(self) -> list[str]:
            return ["base/position"]

    base, reader, alone = Exporter("base", "wheel"), Reader("reader", "lamp"), Link("alone")
    everybody = [base, reader, alone]
    assert names(in_order(everybody)) == ["reader", "base", "alone"]
    assert names(users_of([base], everybody)) == ["reader", "base"]
    assert joints_of(reader, everybody) == ["lamp"]


def test_the_joints_of_a_controller_are_found_through_those_it_commands():
    left, right, base, top = (
        Link("left", "wheel_1"),
        Link("right", "wheel_2"),
        Link("base", "left", "right"),
        Link("top", "base"),
    )
    everybody = [left, right, base, top]
    assert [joints_of(item, everybody) for item in (left, base, top)] == [
        ["wheel_1"],
        ["wheel_1", "wheel_2"],
        ["wheel_1", "wheel_2"],
    ]


@given(st.dictionaries(st.integers(0, 6), st.sets(st.integers(0, 6), max_size=2), max_size=7))
def test_any_wiring_even_a_ring_gives_each_controller_once(wiring):
    links = [Link(str(name), *(str(item) for item in sorted(below))) for name, below in wiring.items()]
    order = names(in_order(links))
    assert sorted(order) == sorted(names(links))
    downhill = all(item < name for name, below in wiring.items() for item in below)
    if downhill:
        for name, below in wiring.items():
            assert all(order.index(str(name)) < order.index(str(item)) for item in below if item in wiring)


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
