from __future__ import annotations

import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from support.control import BROADCASTER, FORWARD, Hardware, S, add, manager

from canopen_control.controllers.base import Controller
from canopen_control.controllers.update_loop import NOT_DUE, ActiveController, InterfaceGroup, Rate
from canopen_control.hardware.interfaces import CommandInterface, ReturnType


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
