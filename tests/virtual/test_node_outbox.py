from __future__ import annotations

import dataclasses
import random

import pytest

from canopen_control.cia301.emcy import EmcyProducer
from canopen_control.cia301.nmt import NmtState, NmtStateChanged
from canopen_control.cia402.state import State
from canopen_control.frame import CanFrame
from canopen_control.virtual import node_outbox
from canopen_control.virtual.node_outbox import (
    HEARTBEAT_ERROR,
    DriveFaulted,
    DriveStateChanged,
    EmergencyRaised,
    FaultSwitched,
    HeartbeatMissed,
    ModeChanged,
    NodeClock,
    NodeOutbox,
    SyncPll,
    in_words,
)


def outbox():
    emcy = EmcyProducer(5)
    emcy.allowed = True
    return NodeOutbox(emcy, NodeClock()), emcy


def test_an_error_is_reported_once_until_it_is_cleared():
    box, emcy = outbox()
    box.emergency(0x4310, 8)
    box.emergency(0x4310, 8)
    assert box.events() == [EmergencyRaised(0x4310)]
    assert box.changed
    assert emcy.active == (0x4310,)
    box.clear_error(0x4310)
    box.clear_error(0x4310)
    assert box.events() == [EmergencyRaised(0)]
    assert emcy.active == ()


def test_a_report_does_not_stay_and_is_not_reported_alongside_the_same_error():
    box, emcy = outbox()
    box.report(0x8110, 0x10)
    assert box.events() == [EmergencyRaised(0x8110)]
    assert (emcy.active, box.changed) == ((), False)
    box.emergency(0x8120, 0x10)
    box.events()
    box.report(0x8120, 0x10)
    assert box.events() == []


def test_a_fault_reset_leaves_the_error_of_a_lost_communication():
    box, emcy = outbox()
    for code in (0x4310, HEARTBEAT_ERROR, 0x2320):
        box.emergency(code, 1)
    box.clear_errors()
    assert emcy.active == (HEARTBEAT_ERROR,)


def test_of_unfetched_items_the_newest_are_kept():
    box, _ = outbox()
    for number in range(1500):
        box.publish(number)
        box.send(CanFrame(0x123))
    assert box.events() == list(range(500, 1500))
    assert len(box.outgoing.drain()) == 1000
    assert (box.events(), box.outgoing.drain()) == ([], [])


# -- node events


@pytest.mark.parametrize("name", [name for name, kind in vars(node_outbox).items() if dataclasses.is_dataclass(kind)])
def test_events_are_plain_frozen_data(name):
    kind = getattr(node_outbox, name)
    assert dataclasses.is_dataclass(kind)
    assert kind.__dataclass_params__.frozen


@pytest.mark.parametrize(
    ("event", "words"),
    [
        (NmtStateChanged(NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL), "NMT OPERATIONAL"),
        (DriveStateChanged(0, State.SWITCHED_ON, State.OPERATION_ENABLED), "SWITCHED_ON -> OPERATION_ENABLED"),
        (DriveFaulted(1, 0x4310), "axis 1: fault 0x4310 (drive temperature too high)"),
        (ModeChanged(0, 3), "mode PV"),
        (EmergencyRaised(0), "error reset"),
        (EmergencyRaised(0x8130, b"\0\xff"), "EMCY 0x8130 (life guard or heartbeat error), data 00 ff"),
        (HeartbeatMissed(1, missed=True), "heartbeat of node 1 lost"),
        (HeartbeatMissed(0, missed=False), "guarding is back"),
        (FaultSwitched("silent", on=True), "fault silent on"),
        (object(), None),
    ],
)
def test_each_event_has_its_words(event, words):
    assert in_words(event) == words


# The rhythm of SYNC that a drive recovers: in time, early and late, for an hour, and after a change.


MS = 1_000_000
T = 4 * MS


def heard(times):
    rhythm = SyncPll()
    for when in times:
        rhythm.receive_sync(when)
    return rhythm


def test_syncs_that_come_in_time_are_taken_as_they_are():
    rhythm = heard(range(7, 7 + 1000 * T, T))
    assert (rhythm.late_ns, rhythm.slack_ns, rhythm.period_ns) == (0.0, 0.0, T)
    assert rhythm.has_period(0.004)
    assert not rhythm.has_period(0.005)


def test_two_syncs_make_no_rhythm():
    assert not heard([T, T, T]).has_period(0.004), "two at once are none"
    assert not heard([T]).has_period(0.004)
    assert not heard([T, 2 * T]).has_period(0.004)
    assert heard([T, 2 * T, 3 * T]).has_period(0.004)


@pytest.mark.rest
@pytest.mark.parametrize("ppm", [200, -200])
def test_for_an_hour_at_200_ppm_with_two_ms_of_jitter_its_edges_keep_to_the_sender_and_none_is_lost(ppm):
    rhythm, chance = SyncPll(), random.Random(ppm)
    period, worst, uneven, before = 10 * MS * (1_000_000 + ppm) / 1_000_000, 0.0, 0.0, None
    for count in range(360_000):
        due = count * period
        when = round(due + chance.random() * 2 * MS)
        rhythm.receive_sync(when)
        edge = when - rhythm.late_ns
        if count > 1000:
            worst = max(worst, abs(edge - due - MS))
            uneven = max(uneven, abs(edge - before - period))
        before = edge
    assert worst < 0.3 * MS, "behind the mean of those that came"
    assert uneven < 0.02 * MS, "of jitter a hundredth is left from edge to edge"
    assert rhythm.period_ns == pytest.approx(period, rel=1e-4)
    assert 0.8 * MS < rhythm.slack_ns < 2 * MS


def test_a_sync_that_is_missing_costs_nothing_and_another_period_restarts():
    times = [count * T for count in range(200) if count not in (50, 51, 120)]
    rhythm = heard(times)
    assert (rhythm.late_ns, rhythm.period_ns) == (0.0, T)
    for count in range(10):
        rhythm.receive_sync(times[-1] + round((count + 1) * 2.6 * T))
    assert rhythm.has_period(2.6 * 0.004)
    assert rhythm.late_ns == pytest.approx(0.0, abs=2.0)


def test_a_sender_that_was_away_is_trusted_again():
    rhythm = heard([*range(0, 50 * T, T), 1000 * T + 77])
    assert rhythm.period_ns == 0.0
    assert not rhythm.has_period(0.004)
