from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples

from canopen_control.cia402.setpoint import (
    FollowingError,
    SetPointDeferred,
    SetPointFailed,
    SetPointHandshake,
    SetPointPhase,
    SetPointReached,
    SetPointTaken,
)
from canopen_control.errors import LocalProtocolError

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "cia402.json").read_text())["cia402_mode_bits"]
ENABLED, ACK, REACHED, FOLLOWING = 0x0237, 1 << 12, 1 << 10, 1 << 13


class PositionDrive:
    """The drive's end of the handshake: takes a target on the edge of bit 4, moves `speed` per cycle.

    `busy_ack`: bit 12 stays until the target is reached, as with drives that have no buffer; `single`: an edge on the
    way to a target is lost.
    """

    def __init__(self, speed: int = 10, busy_ack: bool = False, single: bool = False) -> None:
        self.speed, self.busy_ack, self.single = speed, busy_ack, single
        self.position = self.target = 0
        self.queue: list[int] = []
        self.ack = False
        self.last = 0
        self.taken: list[int] = []

    def cycle(self, bits: int, target: int | None) -> None:
        step = max(-self.speed, min(self.speed, self.target - self.position))
        self.position += step
        if self.position == self.target and self.queue:
            self.target = self.queue.pop(0)
        lost = self.single and self.position != self.target
        if bits & 0x10 and not self.last & 0x10 and not self.ack and not lost:
            goal = target + (self.target if bits & 0x40 else 0)
            self.taken.append(goal)
            self.ack = True
            if bits & 0x20 or self.position == self.target:
                self.target, self.queue = goal, []
            else:
                self.queue.append(goal)
        elif not bits & 0x10 and not (self.busy_ack and self.position != self.target):
            self.ack = bool(self.queue)
        self.last = bits

    @property
    def statusword(self) -> int:
        return ENABLED | ACK * self.ack | REACHED * (self.position == self.target)


def run(machine: SetPointHandshake, drive: PositionDrive, cycles: int, delay: int = 0, cycle_ns: int = 1) -> list:
    events = []
    words, controls = [drive.statusword] * delay, [(0, machine.target)] * delay
    for now in range(0, cycles * cycle_ns, cycle_ns):
        words.append(drive.statusword)
        bits = machine.update(words.pop(0), True, now, position=drive.position)
        controls.append((bits, machine.target))
        drive.cycle(*controls.pop(0))
        events += machine.events()
    return events


class ShowingDrive(PositionDrive):
    """A drive that shows bit 12 from its enabling until bit 4 falls; it takes the target of that pulse if `takes`."""

    def __init__(self, takes: bool) -> None:
        super().__init__()
        self.takes, self.shown = takes, True

    def cycle(self, bits: int, target: int | None) -> None:
        falls = self.last & ~bits & 0x10
        if not self.shown or self.takes:
            super().cycle(bits, target)
        else:
            self.last = bits
        self.shown = self.shown and not falls

    @property
    def statusword(self) -> int:
        return super().statusword | ACK * self.shown


CYCLE_NS = 10_000_000


@pytest.mark.parametrize("relative", [False, True])
@pytest.mark.parametrize("takes", [False, True])
def test_bit_12_since_the_enabling_is_cleared_by_a_pulse_that_moves_nothing(takes, relative):
    """canopen, issue 678."""
    machine, drive = SetPointHandshake(), ShowingDrive(takes)
    drive.position = drive.target = 40
    machine.move(1000, relative=relative)
    events = run(machine, drive, 300, cycle_ns=CYCLE_NS)
    assert [type(event) for event in events] == [SetPointTaken, SetPointReached]
    reached = 1040 if relative else 1000
    assert drive.taken == ([40, reached] if takes else [reached])
    assert drive.position == reached


def test_a_bit_12_that_a_pulse_does_not_clear_is_a_timeout():
    machine = SetPointHandshake()
    machine.move(1000)
    edges = [
        machine.target
        for now in range(0, 600 * CYCLE_NS, CYCLE_NS)
        if machine.update(ENABLED | ACK, True, now, position=40) & 0x10
    ]
    (event,) = machine.events()
    assert event.phase is SetPointPhase.LOW
    assert edges == [40, 40, 40]


def test_a_stop_during_the_pulse_replaces_the_set_point():
    machine, drive = SetPointHandshake(), ShowingDrive(takes=True)
    machine.move(1000)
    now = 0
    while machine.phase is not SetPointPhase.CLEAR:
        machine.update(ENABLED | ACK, True, now, position=0)
        now += CYCLE_NS
    machine.stop_at(7)
    assert [event.target for event in run(machine, drive, 300, cycle_ns=CYCLE_NS)] == [7, 7]
    assert drive.taken == [0, 7]


def test_the_handshake_of_the_vectors():
    machine = SetPointHandshake()
    machine.move(1000)
    observed = [(0x0F, 0)]
    for now, ack in enumerate([0, 0, 1, 1, 0, 0]):
        observed.append((0x0F | machine.update(ENABLED | ACK * ack, True, now), ack))
    words = [word for word, _ in observed]
    assert machine.target == 1000
    assert words == [0x0F, 0x0F, 0x1F, 0x0F, 0x0F, 0x0F, 0x0F]
    assert [step["cw"] for step in VECTORS["pp_handshake"]] == [f"0x{w:04X}" for w in (15, 31, 31, 15, 15, 15)]
    assert machine.phase is SetPointPhase.MOVING


@pytest.mark.parametrize(
    ("flags", "name"),
    [
        ({}, "absolute, wait for end"),
        ({"immediately": True}, "absolute, immediately"),
        ({"relative": True}, "relative, wait"),
        ({"relative": True, "immediately": True}, "relative, immediately"),
        ({"change_on_set_point": True}, "blend (change on set-point)"),
    ],
)
def test_the_controlword_of_each_kind_of_set_point(flags, name):
    machine = SetPointHandshake()
    machine.move(5, **flags)
    assert machine.update(ENABLED, True, 0) == 0
    assert 0x0F | machine.update(ENABLED, True, 1) == int(VECTORS["pp_controlwords"][name], 16)


def test_the_target_is_out_before_the_edge():
    machine = SetPointHandshake()
    machine.move(42)
    assert machine.target is None
    assert machine.update(ENABLED, True, 0) == 0
    assert machine.target == 42
    assert machine.update(ENABLED, True, 1) == 0x10


@pytest.mark.parametrize("delay", [0, 1, 2])
@pytest.mark.parametrize("busy_ack", [False, True])
def test_a_move_is_taken_once_and_reached_where_it_should(delay, busy_ack):
    machine, drive = SetPointHandshake(), PositionDrive(busy_ack=busy_ack)
    machine.move(200)
    events = run(machine, drive, 60, delay)
    assert [type(event) for event in events] == [SetPointTaken, SetPointReached]
    assert drive.taken == [200]
    assert drive.position == 200
    assert events[1].time >= 20
    assert not machine.busy
    assert events[0].text == "set-point 200 acknowledged"
    assert events[1].text == "set-point 200 reached"


def test_a_second_set_point_waits_for_its_turn_and_only_the_last_is_reported_as_reached():
    machine, drive = SetPointHandshake(), PositionDrive()
    machine.move(100)
    machine.update(drive.statusword, True, 0)
    machine.move(50)
    assert not machine.can_take
    with pytest.raises(LocalProtocolError, match="another one is waiting"):
        machine.move(60)
    events = run(machine, drive, 60)
    assert [(type(event), event.target) for event in events] == [
        (SetPointTaken, 100),
        (SetPointTaken, 50),
        (SetPointReached, 50),
    ]
    assert drive.position == 50


def test_an_immediate_set_point_replaces_the_one_that_waits_and_interrupts_the_motion():
    machine, drive = SetPointHandshake(), PositionDrive()
    machine.move(1000)
    run(machine, drive, 10)
    machine.move(2000)
    machine.move(0, immediately=True)
    events = run(machine, drive, 40)
    assert drive.taken == [1000, 0]
    assert drive.position == 0
    assert isinstance(events[-1], SetPointReached)


@pytest.mark.parametrize(("updates", "taken"), [(0, [40]), (1, [40]), (2, [100, 40])])
def test_a_stop_takes_the_place_of_a_set_point_whose_edge_was_not_sent(updates, taken):
    machine, drive = SetPointHandshake(), PositionDrive()
    machine.move(100, immediately=True)  # as a command that ended before its edge, in a public robot with PP
    for now in range(updates):
        drive.cycle(machine.update(drive.statusword, True, now), machine.target)
    machine.stop_at(40)
    events = run(machine, drive, 40)
    assert (drive.taken, drive.position) == (taken, 40)
    assert [event.target for event in events if isinstance(event, SetPointTaken)] == taken


def test_a_set_point_that_is_lost_on_the_way_to_another_one_is_given_again_at_its_end():
    machine, drive = SetPointHandshake(acknowledge_timeout_ns=10), PositionDrive(single=True)
    machine.move(500, immediately=True)
    run(machine, drive, 10)
    machine.move(-300, immediately=True)
    events = run(machine, drive, 200)
    assert drive.taken == [500, -300]
    assert drive.position == -300
    assert [type(event) for event in events] == [SetPointDeferred, SetPointTaken, SetPointReached]
    assert not machine.busy


def test_a_newer_set_point_takes_the_place_of_one_that_waits_for_the_end_of_a_motion():
    machine, drive = SetPointHandshake(acknowledge_timeout_ns=10), PositionDrive(single=True)
    machine.move(500, immediately=True)
    run(machine, drive, 10)
    machine.move(-300, immediately=True)
    run(machine, drive, 20)
    assert machine.phase is SetPointPhase.DEFERRED
    machine.move(100, immediately=True)
    run(machine, drive, 200)
    assert drive.taken == [500, 100]


def test_an_acknowledge_bit_that_is_already_1_is_not_an_acknowledgement():
    machine = SetPointHandshake(low_timeout_ns=100)
    machine.move(7)
    assert {machine.update(ENABLED | ACK, True, now) for now in range(0, 110, 10)} == {0}
    (event,) = machine.events()
    assert (event.phase, event.time) == (SetPointPhase.LOW, 100)
    assert event.text == f"set-point 7 abandoned: {SetPointPhase.LOW.value}"
    assert not machine.busy


def test_an_acknowledgement_that_never_comes_ends_with_bit_4_low():
    machine = SetPointHandshake(acknowledge_timeout_ns=100)
    machine.move(7)
    words = [machine.update(ENABLED, True, now) for now in range(0, 200, 10)]
    assert machine.next_deadline() is None
    assert words.count(0x10) == 10
    assert words[-1] == 0
    (event,) = machine.events()
    assert event.phase is SetPointPhase.ACKNOWLEDGE


def test_an_acknowledgement_that_never_goes_is_reported():
    machine = SetPointHandshake(release_timeout_ns=50)
    machine.move(7)
    words = [ENABLED, ENABLED, *[ENABLED | ACK] * 20]
    assert [machine.update(word, True, 10 * i) for i, word in enumerate(words)][2:] == [0] * 20
    taken, failed = machine.events()
    assert isinstance(taken, SetPointTaken)
    assert failed.phase is SetPointPhase.RELEASE


def test_an_acknowledgement_that_stays_at_the_target_is_not_waited_for():
    """The release time covers whole motions of drives that keep bit 12; at the target, three seconds are enough."""
    machine = SetPointHandshake()
    machine.move(100)
    words = [ENABLED] * 3 + [ENABLED | ACK] * 50 + [ENABLED | ACK | REACHED] * 40
    events = []
    for number, word in enumerate(words):
        machine.update(word, True, number * 100_000_000)
        events += [(number, event) for event in machine.events()]
    ((_, taken), (number, failed)) = events
    assert isinstance(taken, SetPointTaken)
    assert isinstance(failed, SetPointFailed)
    assert failed.phase is SetPointPhase.RELEASE
    assert number == 3 + 50 + 30
    assert not machine.busy


def test_a_motion_has_its_time_only_where_one_is_given():
    for timeout, count in ((None, 0), (1000, 1)):
        machine = SetPointHandshake(motion_timeout_ns=timeout)
        machine.move(7)
        for i, word in enumerate([ENABLED, ENABLED, ENABLED | ACK, *[ENABLED] * 300]):
            machine.update(word, True, 10 * i)
        assert sum(isinstance(event, SetPointFailed) for event in machine.events()) == count


def test_a_drive_that_is_no_longer_enabled_gives_up_all_of_them():
    machine = SetPointHandshake()
    machine.move(1)
    machine.update(ENABLED, True, 0)
    machine.update(ENABLED, True, 1)
    machine.move(2)
    assert machine.update(0x0240, False, 2) == 0
    assert [(event.target, event.phase) for event in machine.events()] == [
        (1, SetPointPhase.ACKNOWLEDGE),
        (2, SetPointPhase.IDLE),
    ]
    machine.move(3)
    assert machine.update(None, True, 3) == 0
    assert len(machine.events()) == 1
    assert not machine.busy


def test_an_abort_returns_bit_4_to_0_and_none_is_left_over():
    machine = SetPointHandshake()
    machine.abort()
    machine.move(1)
    assert [machine.update(ENABLED, True, now) for now in range(2)] == [0, 0x10]
    machine.abort("stopped by the user")
    assert machine.update(ENABLED | ACK, True, 2) == 0
    (event,) = machine.events()
    assert event.reason == "stopped by the user"
    assert machine.update(ENABLED, True, 3) == 0


def test_a_stale_bit_10_is_not_the_end():
    machine = SetPointHandshake(settle_updates=3)
    machine.move(1)
    words = [ENABLED | REACHED, ENABLED | REACHED, ENABLED | REACHED | ACK, ENABLED | REACHED]
    for now, word in enumerate(words):
        machine.update(word, True, now)
    assert machine.busy
    machine.update(ENABLED, True, 5)
    assert machine.busy
    machine.update(ENABLED | REACHED | ACK, True, 6)
    assert machine.busy
    machine.update(ENABLED | REACHED, True, 7)
    assert not machine.busy


def test_while_halted_bit_10_means_standstill_and_nothing_is_judged():
    machine = SetPointHandshake(motion_timeout_ns=100)
    machine.move(1)
    for now, word in enumerate([ENABLED, ENABLED, ENABLED | ACK, ENABLED]):
        machine.update(word, True, now)
    for now in range(10, 1000, 10):
        machine.update(ENABLED | REACHED, True, now, halted=True)
    assert machine.busy
    machine.update(ENABLED, True, 1000)
    machine.update(ENABLED | REACHED, True, 1001)
    assert not machine.busy


def test_a_following_error_is_reported_once_per_set_point():
    machine = SetPointHandshake()
    machine.move(1)
    for now, word in enumerate([ENABLED, ENABLED, ENABLED | ACK, ENABLED | FOLLOWING, ENABLED | FOLLOWING]):
        machine.update(word, True, now)
    (event,) = (event for event in machine.events() if isinstance(event, FollowingError))
    assert event.text == "following error on the way to 1 (statusword 0x2237)"


@settings(max_examples=examples(100))
@given(st.lists(st.tuples(st.integers(-300, 300), st.booleans(), st.integers(0, 30)), max_size=8), st.integers(0, 3))
def test_whatever_is_asked_for_the_drive_takes_each_once_and_ends_at_the_last(moves, delay):
    machine, drive = SetPointHandshake(), PositionDrive()
    given_targets = []
    events = []
    for target, immediately, cycles in moves:
        if not machine.can_take:
            events += run(machine, drive, 200, delay)
        machine.move(target, immediately=immediately)
        given_targets.append(target)
        events += run(machine, drive, cycles, delay) if not delay else run(machine, drive, 200, delay)
    events += run(machine, drive, 400, delay)
    taken = [event.target for event in events if isinstance(event, SetPointTaken)]
    assert taken == drive.taken
    assert not [event for event in events if isinstance(event, SetPointFailed)]
    if moves:
        assert drive.position == given_targets[-1]
        assert isinstance(events[-1], SetPointReached)


@given(
    st.lists(
        st.tuples(
            st.integers(0, 0xFFFF) | st.none(), st.booleans(), st.booleans(), st.integers(0, 10**9), st.integers(0, 4)
        )
    )
)
def test_bit_4_is_up_only_while_an_acknowledgement_is_awaited(steps):
    machine = SetPointHandshake()
    now = 0
    for word, ready, halted, passed, verb in steps:
        if verb == 0 and machine.can_take:
            machine.move(passed)
        elif verb == 1:
            machine.abort()
        now += passed
        bits = machine.update(word, ready, now, halted)
        assert bool(bits & 0x10) == (machine.phase is SetPointPhase.ACKNOWLEDGE)
        assert bits & ~0x270 == 0
        assert ready or bits == 0
