from __future__ import annotations

import pytest
from support.services import MS, frame, vectors

from canopen_control.cia301.pdo import PdoParameters, TpdoProducer
from canopen_control.frame import EXTENDED_FLAG, CanFrame

SYNC = vectors()["sync"]


class Device:
    """A TPDO of one byte, whose value the test sets."""

    def __init__(self, transmission_type: int, **settings: object) -> None:
        self.value = 0
        self.samples = 0
        settings.setdefault("cob_id", 0x183)
        self.tpdo = TpdoProducer(PdoParameters(transmission_type=transmission_type, **settings), self.sample)
        self.tpdo.start(0)
        self.start = self.data()

    def sample(self) -> bytes:
        self.samples += 1
        return bytes((self.value,))

    def data(self) -> list[int]:
        return [f.data[0] for f in self.tpdo.frames()]

    def change(self, value: int, now: int) -> list[int]:
        self.value = value
        self.tpdo.changed(now)
        return self.data()


def sending_syncs(device: Device, counters: list[int | None]) -> list[int]:
    sent = []
    for number, counter in enumerate(counters, 1):
        device.tpdo.sync(number, counter)
        if device.data():
            sent.append(number)
    return sent


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_pdo_is_sent_at_start_and_on_every_change(transmission_type):
    device = Device(transmission_type)
    assert device.start == [0]
    assert [device.change(1, 10), device.change(2, 11)] == [[1], [2]]
    assert device.tpdo.next_deadline() is None


def test_the_inhibit_time_sends_the_newest_value_once_when_it_is_over():
    device = Device(255, inhibit_time_100us=10)
    device.tpdo.tick(MS)
    assert device.change(1, MS) == [1]
    assert device.change(2, MS + 1) == []
    assert device.change(3, 2 * MS - 1) == []
    assert device.tpdo.next_deadline() == 2 * MS
    device.tpdo.tick(2 * MS - 1)
    assert device.data() == []
    device.tpdo.tick(2 * MS)
    assert device.data() == [3]
    assert device.tpdo.next_deadline() is None


def test_the_event_timer_runs_from_the_last_transmission():
    device = Device(255, event_timer_ms=10)
    assert device.tpdo.next_deadline() == 10 * MS
    assert device.change(1, 4 * MS) == [1]
    device.tpdo.tick(14 * MS - 1)
    assert device.data() == []
    device.tpdo.tick(14 * MS)
    assert device.data() == [1]
    assert device.tpdo.next_deadline() == 24 * MS


def test_the_event_timer_waits_for_the_inhibit_time():
    device = Device(255, event_timer_ms=1, inhibit_time_100us=30)
    assert device.tpdo.next_deadline() == 3 * MS
    device.tpdo.tick(2 * MS)
    assert device.data() == []
    device.tpdo.tick(3 * MS)
    assert device.data() == [0]


def test_acyclic_synchronous_is_sent_at_the_sync_after_a_change_only():
    device = Device(0)
    assert device.start == []
    device.tpdo.sync(1)
    assert device.data() == []
    assert device.change(5, 2) == []
    device.value = 6
    device.tpdo.sync(3)
    device.tpdo.sync(4)
    assert device.data() == [6]


@pytest.mark.parametrize("every", [1, 2, 3, 4, 240])
def test_cyclic_synchronous_is_sent_every_nth_sync(every):
    device = Device(every)
    assert sending_syncs(device, [None] * 480) == list(range(every, 481, every))
    assert device.change(1, 0) == []


def test_the_phase_without_a_counter_is_the_vectors():
    assert sending_syncs(Device(4), [None] * 12) == SYNC["tt4_no_counter"]["lely_sends_on_sync_number"]


@pytest.mark.parametrize(("every", "group"), [(1, "tt1_overflow4_start3"), (2, "tt2_overflow4_start3")])
def test_the_start_value_is_the_vectors(every, group):
    device = Device(every, sync_start=3)
    counters: list[int | None] = [1, 2, 3, 4, 1, 2, 3, 4, 1, 2]
    sent = [counters[number - 1] for number in sending_syncs(device, counters)]
    wanted = SYNC[group]["lely_sends_on_counter"]
    assert sent[: len(wanted)] == wanted


def test_a_start_value_without_a_counter_is_ignored():
    assert sending_syncs(Device(1, sync_start=3), [None] * 3) == [1, 2, 3]


def test_rtr_synchronous_answers_with_the_sample_of_the_last_sync():
    device = Device(252)
    device.tpdo.receive(frame("183#R1"), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 1)
    device.value = 7
    device.tpdo.sync(1)
    device.value = 8
    device.tpdo.receive(frame("183#R1"), 2)
    device.tpdo.receive(frame("183#R1"), 3)
    assert device.data() == [7, 7]


def test_rtr_event_answers_with_the_present_value():
    device = Device(253)
    device.value = 9
    device.tpdo.receive(frame("183#R1"), 0)
    device.tpdo.sync(1)
    assert device.change(1, 2) == [9]


@pytest.mark.parametrize("settings", [{"transmission_type": 255}, {"transmission_type": 253, "rtr_allowed": False}])
def test_other_types_do_not_answer_remote_frames(settings):
    device = Device(**settings)
    device.tpdo.receive(frame("183#R1"), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 1)


def test_foreign_frames_are_ignored():
    device = Device(253)
    for text in ("183#00", "184#R1", "080#"):
        device.tpdo.receive(frame(text), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 0)


def test_a_stopped_or_invalid_pdo_is_silent():
    device = Device(255, event_timer_ms=1, inhibit_time_100us=100)
    device.tpdo.changed(1)
    device.tpdo.stop()
    device.tpdo.stop()
    device.tpdo.tick(10**12)
    device.tpdo.sync(1)
    device.tpdo.changed(1)
    assert (device.data(), device.tpdo.next_deadline()) == ([], None)
    assert Device(255, enabled=False).start == []
    assert Device(243).change(1, 1) == []


def test_starting_again_forgets_the_past():
    device = Device(2)
    device.tpdo.sync(1)
    device.tpdo.stop()
    device.tpdo.start(2)
    assert sending_syncs(device, [None, None]) == [2]


def test_new_parameters_count_at_once():
    device = Device(255)
    device.tpdo.configure(PdoParameters(0x283, transmission_type=1), 5)
    assert device.change(1, 6) == []
    device.tpdo.sync(7)
    assert device.tpdo.frames() == [CanFrame(0x283, b"\1")]
    assert device.tpdo.parameters.cob_id == 0x283
    device.tpdo.stop()
    device.tpdo.configure(PdoParameters(0x12345, transmission_type=255, extended=True), 8)
    assert device.tpdo.frames() == []
    device.tpdo.start(9)
    assert device.tpdo.frames() == [CanFrame(0x12345 | EXTENDED_FLAG, b"\1")]
    assert device.tpdo.sent == 3
