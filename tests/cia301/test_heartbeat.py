from __future__ import annotations

import pytest
from support.services import MS, frame, vectors

from canopen_control.cia301.heartbeat import (
    HeartbeatConsumer,
    HeartbeatEvent,
    HeartbeatEventKind,
    HeartbeatProducer,
    consumer_entry,
    next_on_grid,
    parse_consumer_entry,
)
from canopen_control.cia301.nmt import NmtState
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import CanFrame

KIND = HeartbeatEventKind
STATES = {"pre-operational": NmtState.PRE_OPERATIONAL, "operational": NmtState.OPERATIONAL, "stopped": NmtState.STOPPED}


def kinds(consumer: HeartbeatConsumer) -> list[HeartbeatEventKind]:
    return [event.kind for event in consumer.events()]


def watching(timeout_ns: int = 100 * MS) -> HeartbeatConsumer:
    consumer = HeartbeatConsumer()
    consumer.watch(3, timeout_ns)
    return consumer


@pytest.mark.parametrize("vector", [v for v in vectors()["heartbeat"] if "state" in v], ids=lambda v: v["frame"])
def test_states_are_the_vectors_with_the_toggle_bit_masked(vector):
    consumer = HeartbeatConsumer()
    consumer.receive(frame(vector["frame"]), 0)
    assert consumer.state_of(vector["node"]) is STATES[vector["state"]]


@pytest.mark.parametrize("vector", [v for v in vectors()["heartbeat"] if "0x1016_entry" in v])
def test_consumer_entries_are_the_vectors(vector):
    value = int(vector["0x1016_entry"], 16)
    assert consumer_entry(vector["node"], vector["ms"]) == value
    assert parse_consumer_entry(value) == (vector["node"], vector["ms"])


def test_an_impossible_consumer_entry_is_refused():
    for node_id, ms in ((128, 1), (1, 65536), (-1, 1)):
        with pytest.raises(LocalProtocolError):
            consumer_entry(node_id, ms)


def test_the_producer_keeps_its_grid_to_the_nanosecond():
    producer = HeartbeatProducer(3, 100)
    producer.boot_up(1000)
    assert producer.frames() == [frame("703#00")]
    assert producer.next_deadline() == 1100
    producer.tick(1099)
    assert producer.frames() == []
    producer.tick(1100)
    producer.tick(1207)
    assert producer.frames() == [frame("703#7F")] * 2
    assert producer.next_deadline() == 1300


def test_the_producer_shows_its_state_and_is_silent_while_initialising_or_off():
    producer = HeartbeatProducer(3, 100)
    producer.tick(0)
    assert (producer.frames(), producer.next_deadline()) == ([], None)
    producer.state = NmtState.OPERATIONAL
    assert producer.next_deadline() == 0
    producer.tick(50)
    assert producer.frames() == [frame("703#05")]
    producer.period_ns = 0
    producer.tick(500)
    assert (producer.frames(), producer.next_deadline()) == ([], None)


def test_a_new_period_starts_with_a_heartbeat():
    producer = HeartbeatProducer(3, 100)
    producer.boot_up(0)
    producer.frames()
    producer.period_ns = 30
    producer.tick(10)
    assert producer.frames() == [frame("703#7F")]
    assert producer.next_deadline() == 40


def test_the_grid():
    assert [next_on_grid(10, 5, now) for now in (0, 10, 14, 15, 99)] == [10, 15, 15, 20, 100]


def test_monitoring_starts_with_the_first_heartbeat_and_not_with_the_boot_up():
    consumer = watching()
    assert consumer.next_deadline() is None
    consumer.receive(frame("703#00"), 0)
    assert consumer.events() == [HeartbeatEvent(KIND.BOOT_UP, 3, NmtState.INITIALISING, 0, monitored=False)]
    consumer.tick(10**12)
    assert (consumer.events(), consumer.next_deadline()) == ([], None)
    consumer.receive(frame("703#7F"), 10**12)
    assert consumer.events() == [HeartbeatEvent(KIND.STARTED, 3, NmtState.PRE_OPERATIONAL, 10**12)]
    assert consumer.next_deadline() == 10**12 + 100 * MS


def test_a_changed_state_is_reported_once():
    consumer = watching()
    for text in ("703#7F", "703#05", "703#05"):
        consumer.receive(frame(text), 0)
    assert kinds(consumer) == [KIND.STARTED, KIND.CHANGED]
    assert consumer.state_of(3) is NmtState.OPERATIONAL


def test_silence_is_reported_once_at_the_nanosecond_and_resolved_by_the_next_heartbeat():
    consumer = watching(100)
    consumer.receive(frame("703#05"), 1000)
    consumer.tick(1099)
    assert kinds(consumer) == [KIND.STARTED]
    consumer.tick(1100)
    consumer.tick(1200)
    assert consumer.events() == [HeartbeatEvent(KIND.MISSED, 3, NmtState.OPERATIONAL, 100)]
    assert (consumer.is_missed(3), consumer.age_ns(3, 1250), consumer.next_deadline()) == (True, 250, None)
    consumer.receive(frame("703#7F"), 1300)
    assert consumer.events() == [
        HeartbeatEvent(KIND.RESOLVED, 3, NmtState.PRE_OPERATIONAL, 300),
        HeartbeatEvent(KIND.CHANGED, 3, NmtState.PRE_OPERATIONAL, 300),
    ]
    assert (consumer.is_missed(3), consumer.next_deadline()) == (False, 1400)


def test_a_boot_up_during_monitoring_is_a_remote_reset_and_ends_it():
    consumer = watching(100)
    consumer.receive(frame("703#05"), 0)
    consumer.receive(frame("703#00"), 50)
    assert consumer.events()[-1] == HeartbeatEvent(KIND.BOOT_UP, 3, NmtState.INITIALISING, 50, monitored=True)
    consumer.tick(1000)
    assert consumer.events() == []
    consumer.receive(frame("703#7F"), 1000)
    assert kinds(consumer) == [KIND.STARTED]


def test_a_boot_up_after_a_miss_ends_it():
    consumer = watching(100)
    consumer.receive(frame("703#05"), 0)
    consumer.tick(100)
    consumer.receive(frame("703#00"), 200)
    assert kinds(consumer) == [KIND.STARTED, KIND.MISSED, KIND.BOOT_UP]
    assert not consumer.is_missed(3)


def test_wrong_lengths_are_ignored_and_counted():
    consumer = watching()
    consumer.receive(frame("703#"), 0)
    consumer.receive(frame("703#0505"), 0)
    assert (consumer.malformed, consumer.events(), consumer.state_of(3)) == (2, [], None)


def test_an_unknown_state_is_a_sign_of_life_of_unknown_state():
    consumer = watching(100)
    consumer.receive(frame("703#05"), 0)
    consumer.receive(frame("703#11"), 50)
    assert consumer.events()[-1] == HeartbeatEvent(KIND.CHANGED, 3, None, 50)
    assert (consumer.unknown, consumer.next_deadline()) == (1, 150)


def test_a_toggled_zero_is_neither_boot_up_nor_heartbeat():
    consumer = watching()
    consumer.receive(frame("703#80"), 0)
    assert (consumer.events(), consumer.unknown, consumer.age_ns(3, 5)) == ([], 1, None)


def test_remote_and_foreign_frames_are_not_received():
    consumer = watching()
    for text in ("703#R1", "700#05", "780#05", "083#05"):
        consumer.receive(frame(text), 0)
    assert (consumer.events(), consumer.malformed) == ([], 0)


def test_unwatched_nodes_are_known_and_their_boot_up_is_reported():
    consumer = HeartbeatConsumer()
    consumer.receive(frame("70A#05"), 0)
    consumer.receive(frame("70A#00"), 10)
    assert consumer.events() == [HeartbeatEvent(KIND.BOOT_UP, 10, NmtState.INITIALISING, 10, monitored=False)]
    assert (consumer.state_of(10), consumer.watched()) == (NmtState.INITIALISING, {})


def test_unwatching_ends_the_supervision_and_is_a_no_op_twice():
    consumer = watching(100)
    consumer.receive(frame("703#05"), 0)
    assert consumer.watched() == {3: 100}
    consumer.unwatch(3)
    consumer.unwatch(3)
    consumer.unwatch(99)
    consumer.tick(1000)
    assert kinds(consumer) == [KIND.STARTED]


def test_watching_what_is_not_a_node_is_refused_and_changes_nothing():
    consumer = watching()
    for node_id, timeout in ((0, 1), (128, 1), (3, -1)):
        with pytest.raises(LocalProtocolError):
            consumer.watch(node_id, timeout)
    assert consumer.watched() == {3: 100 * MS}


def test_a_heartbeat_that_waited_for_a_late_reader_is_none_that_came_late():
    consumer = watching()
    consumer.receive(frame("703#05"), 0)
    consumer.receive(frame("703#05"), 500 * MS, since=90 * MS)
    assert kinds(consumer) == [KIND.STARTED]
    consumer.receive(frame("703#05"), 700 * MS, since=690 * MS)
    assert kinds(consumer) == [KIND.MISSED, KIND.RESOLVED], "nobody was late here"


@pytest.mark.parametrize("states", [(0x05, 0x05, 0x05), (0x00, 0x05, 0x05), (0x7F, 0x05, 0x05, 0x7F, 0x05)])
@pytest.mark.parametrize("times", [(0, 50, 120, 190, 260), (0, 50, 150, 200, 260), (0, 50, 151, 400, 401)])
@pytest.mark.parametrize("waited", [0, 60])
def test_a_heartbeat_that_only_continues_changes_what_taking_it_in_full_would(states, times, waited):
    quick, full = watching(), watching()
    for state, time in zip(states, times, strict=False):
        now, since = time * MS, None if not waited else max(0, time - waited) * MS
        beat = CanFrame(0x703, bytes([state]))
        full.receive(beat, now, since)
        if state != 0x05 or not quick.record_unchanged(3, NmtState.OPERATIONAL, now, since):
            quick.receive(beat, now, since)
        assert quick.events() == full.events()
        assert (quick.state_of(3), quick.age_ns(3, now + 5), quick.next_deadline()) == (
            full.state_of(3),
            full.age_ns(3, now + 5),
            full.next_deadline(),
        )
        for consumer in (quick, full):
            consumer.tick(now + 30 * MS)


def test_only_a_watched_node_in_time_and_in_its_state_continues():
    consumer = watching()
    assert not consumer.record_unchanged(3, NmtState.OPERATIONAL, 0)
    consumer.receive(CanFrame(0x703, b"\x05"), 0)
    assert consumer.record_unchanged(3, NmtState.OPERATIONAL, 99 * MS)
    assert not consumer.record_unchanged(3, NmtState.OPERATIONAL, 199 * MS)
    assert not consumer.record_unchanged(3, NmtState.STOPPED, 150 * MS)
    assert not consumer.record_unchanged(4, NmtState.OPERATIONAL, 150 * MS)
