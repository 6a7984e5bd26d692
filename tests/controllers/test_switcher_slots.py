import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st
from support.control import S

from canopen_control.controllers.base import Controller
from canopen_control.controllers.switcher import NOT_DUE, Part, Rate, Slot
from canopen_control.hardware.interfaces import CommandInterface


def steps(rate, period_ms, cycles=100, start=1):
    """Return (ms, elapsed) of the steps that a rate takes in cycles of `period_ms`."""
    found = ((ms, rate.step(ms * S // 1000, period_ms / 1000)) for ms in range(start, cycles * period_ms, period_ms))
    return [(ms, elapsed) for ms, elapsed in found if elapsed != NOT_DUE]


def test_without_a_rate_every_cycle_is_a_step_of_its_period():
    assert steps(Rate(0), 20, cycles=3) == [(1, 0.02), (21, 0.02), (41, 0.02)]


def test_a_rate_that_divides_the_cycle_is_exact_and_its_first_step_comes_at_once():
    assert steps(Rate(10), 20, cycles=16) == [(1, 0.1), (101, 0.1), (201, 0.1), (301, 0.1)]


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
    part = Part(ends)
    assert part.enabled
    one.enabled = False
    assert not part.follows()
    one.set_aside = True
    assert part.follows()
    other.enabled = False
    assert not part.follows()
    assert Part(()).follows()


def test_a_slot_follows_while_one_of_its_parts_does_and_names_those_that_do_not():
    a, b = interfaces("a", "b")
    slot = Slot(Controller("c"), 0, [(a,), (b,)])
    a.enabled = False
    assert slot.follows
    assert slot.disabled == [a]
    b.enabled = False
    assert not slot.follows
    assert Slot(Controller("tells"), 0, []).follows


def test_what_was_enabled_in_the_last_cycle_and_its_rhythm_outlive_a_switch():
    (a,) = ends = interfaces("a")
    before = Slot(Controller("c"), 10, [ends])
    before.rate.step(S, 0.02)
    a.enabled = False  # since the last cycle
    after = Slot(before.controller, 10, [ends])
    assert not after.parts[0].enabled
    after.take_over(before, {a})
    assert after.parts[0].enabled
    assert after.rate.last == S
