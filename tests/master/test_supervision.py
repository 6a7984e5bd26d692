"""Stale process data, floods, and two nodes with one id."""

from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia301.pdo import MappedObject
from canopen_control.master.cycle import ReceivedPdo
from canopen_control.master.plan_builder import PlannedPdo
from canopen_control.master.supervision import DuplicateWatch, EmcyGate, PdoWatch
from canopen_control.od.model import DataType

MS = 1_000_000
PERIOD = 100 * MS


def make_pdo(transmission_type):
    pdo = ReceivedPdo(0x182, [MappedObject(0x6041, 0, 16, DataType.UNSIGNED16)], transmission_type)
    pdo.expected = True
    watch = PdoWatch()
    watch.add(pdo)
    return pdo, watch


@given(st.integers(1, 8))
def test_three_that_stay_away_are_too_many_whatever_their_rate(every):
    pdo, watch = make_pdo(every)
    pdo.receive(bytes(8), 2, 0)
    watch.sync()
    for _ in range(3 * every - 1):
        assert not watch.sync()
        assert not pdo.overdue
    assert list(watch.sync()) == [pdo]
    assert pdo.overdue
    assert not watch.sync(), "reported once"
    pdo.receive(bytes(8), 2, 1)
    assert list(watch.sync()) == [pdo]
    assert not pdo.overdue


def test_what_comes_in_time_is_never_reported():
    pdo, watch = make_pdo(2)
    for number in range(100):
        if number % 2:
            pdo.receive(bytes(8), 2, number)
        assert not watch.sync()


def test_event_driven_and_not_yet_expected_ones_are_not_counted():
    pdo, watch = make_pdo(255)
    assert not any(watch.sync() for _ in range(10))
    pdo, watch = make_pdo(1)
    pdo.expected = False
    assert not any(watch.sync() for _ in range(10))
    assert pdo.silent == 0


@pytest.mark.parametrize(("event_ms", "period_ms", "syncs"), [(50, 10, 15), (50, 20, 8), (20, 100, 3)])
def test_an_event_driven_one_is_due_by_its_event_timer(event_ms, period_ms, syncs):
    pdo = ReceivedPdo(0x182, [MappedObject(0x6041, 0, 16, DataType.UNSIGNED16)], 255)
    pdo.expected, pdo.age_limit_ns = True, 3 * event_ms * MS
    pdo.supervise_timer(period_ms * MS)
    watch = PdoWatch(period_ms * MS)
    watch.add(pdo)
    pdo.receive(bytes(8), 2, 0)
    late = [bool(watch.sync(number * period_ms * MS)) for number in range(syncs + 3)]
    assert late.index(True) == syncs
    assert late.count(True) == 1
    assert pdo.overdue
    pdo.use(PlannedPdo(1, 0x182, 255, (MappedObject(0x6041, 0, 16, DataType.UNSIGNED16),), event_ms), pdo.codec.objects)
    assert pdo.allowed_silence > 1000, "a node that keeps its own settings may have no timer"


def test_a_short_one_does_not_count_as_having_come():
    pdo, watch = make_pdo(1)
    pdo.receive(bytes(8), 2, 0)
    watch.sync()
    for number in range(3):
        pdo.receive(bytes(8), 1, number)
        changed = list(watch.sync())
    assert changed == [pdo]
    assert pdo.short == 3


def test_ten_emergencies_a_second_pass_and_the_rest_is_summed_up():
    gate = EmcyGate()
    assert sum(gate.passes(number * MS) for number in range(500)) == 10
    assert gate.summary(900 * MS) == 0
    assert gate.deadline == 1000 * MS
    assert gate.summary(1000 * MS) == 490
    assert gate.summary(1000 * MS) == 0
    assert gate.deadline is None
    assert gate.passes(1500 * MS)


def test_a_flood_read_once_a_cycle_is_summed_though_it_continues_when_the_second_is_over():
    gate, reported = EmcyGate(), []
    for edge in range(0, 3001, 20):
        for _ in range(4):
            gate.passes(edge * MS)
        if summed := gate.summary(edge * MS):
            reported.append((edge, summed))
    assert reported == [(1000, 194), (2020, 194)]


def test_two_heartbeats_per_period_are_two_nodes_and_jitter_is_not():
    watch = DuplicateWatch(PERIOD)
    late = [0, 60, 10, 55, 0, 59, 30, 0, 60, 5] * 20
    assert not any(watch.heartbeat(number * PERIOD + lateness * MS) for number, lateness in enumerate(late))
    watch = DuplicateWatch(PERIOD)
    reported = [watch.heartbeat(number * PERIOD // 2) for number in range(100)]
    assert sum(reported) == 1
    assert reported.index(True) < 20
    assert not DuplicateWatch(0).heartbeat(0)


def test_two_boot_ups_at_once_are_two_nodes_and_a_restart_is_not():
    watch = DuplicateWatch(PERIOD)
    assert not watch.boot_up(0)
    assert not watch.boot_up(500 * MS)
    assert watch.boot_up(501 * MS)
    assert not watch.boot_up(502 * MS), "reported once"


@pytest.mark.parametrize("gap", [8, 20, 80])
def test_the_boot_ups_of_a_boot_loader_and_its_application_are_one_device(gap):
    watch = DuplicateWatch(PERIOD)
    for restart in range(3):
        at = restart * 20_000 * MS
        watch.reset()
        assert not watch.boot_up(at)
        assert not watch.boot_up(at + gap * MS)
        assert not any(watch.heartbeat(at + gap * MS + number * PERIOD) for number in range(20))
    assert not watch.stuck


@pytest.mark.parametrize("gap", [50, 100, 500])
def test_boot_ups_at_equal_distances_are_a_node_that_does_not_start(gap):
    watch = DuplicateWatch(100 * MS)
    watch.reset()
    assert not watch.boot_up(0)
    reported = [watch.boot_up(number * gap * MS + number % 2 * MS) for number in range(1, 6)]
    assert watch.stuck
    assert not any(reported)
    watch.heartbeat(3000 * MS)
    assert not watch.stuck


def test_boot_ups_that_answer_resets_are_not_such_thing():
    watch = DuplicateWatch(1000 * MS)
    for number in range(8):
        watch.reset()
        watch.boot_up(number * 1000 * MS)
    assert not watch.stuck


def test_what_comes_at_once_after_a_silence_was_held_up_on_the_way():
    watch = DuplicateWatch(PERIOD)
    assert not any(watch.heartbeat(number * PERIOD) for number in range(20))
    for _ in range(3):
        watch.reset()  # of a master whose frames were held up as well
    stalled = 20 * PERIOD + 2000 * MS
    assert not any(watch.heartbeat(stalled + number) for number in range(20))
    assert not any(watch.heartbeat(stalled + number * PERIOD) for number in range(1, 40))
    for _ in range(3):
        watch.reset()
    later = stalled + 50 * PERIOD
    assert not any(watch.boot_up(later + number) for number in range(3))
    assert watch.boot_up(later + 4), "one more than resets"


def test_heartbeats_from_before_a_reset_do_not_count_as_its_answer():
    watch = DuplicateWatch(PERIOD)
    for number in range(3):  # a gateway keeps frames of either direction back and delivers them at once
        watch.reset()
        watch.set_period(PERIOD)  # a new boot
        watch.heartbeat(number * PERIOD)
    assert not any(watch.boot_up(3 * PERIOD + number) for number in range(3))


def test_a_reset_that_is_never_answered_does_not_hide_a_second_device():
    watch = DuplicateWatch(PERIOD)
    watch.reset()
    assert not any(watch.heartbeat(number * PERIOD) for number in range(11_000 * MS // PERIOD))
    later = 11_000 * MS
    assert not watch.boot_up(later)
    assert watch.boot_up(later + MS)


def test_a_second_device_is_found_behind_a_hub_that_stood_still():
    watch = DuplicateWatch(PERIOD)
    reported = [watch.heartbeat(9000 * MS + number // 2 * PERIOD + number % 2 * MS) for number in range(100)]
    assert sum(reported) == 1


def test_syncs_of_a_late_process_that_lie_close_together_are_not_three_misses():
    pdo, _ = make_pdo(1)
    watch = PdoWatch(20 * MS)
    watch.add(pdo)
    watch.sync(0)
    assert not any(watch.sync(now * MS) for now in (1, 2, 21, 29))
    assert list(watch.sync(41 * MS)) == [pdo]


def test_drives_that_are_processes_have_the_time_of_a_process():
    pdo, _ = make_pdo(1)
    watch = PdoWatch(20 * MS)
    watch.add(pdo)
    watch.min_ns = 250 * MS
    reported = [now for now in range(0, 1000, 20) if watch.sync(now * MS)]
    assert reported == [240], "the first SYNC without an answer was one period before it was missed"


def test_what_waits_to_be_read_has_come():
    pdo, _ = make_pdo(1)
    watch = PdoWatch(20 * MS)
    watch.add(pdo)
    watch.reader = SimpleNamespace(catch_up=lambda: pdo.receive(bytes(8), 2, 60 * MS))
    assert not any(watch.sync(now * MS) for now in range(0, 200, 20))
    watch.reader = None
    assert any(watch.sync(now * MS) for now in range(200, 300, 20))


def test_heartbeats_and_boot_ups_that_waited_for_a_late_reader_report_nothing_of_a_rate():
    watch = DuplicateWatch(PERIOD)
    assert not any(watch.heartbeat(2000 * MS, 0) for _ in range(20))
    assert not any(watch.heartbeat(2000 * MS + number * PERIOD, 2000 * MS) for number in range(1))
    assert not watch.boot_up(4000 * MS, 2500 * MS)
    assert not watch.boot_up(4000 * MS, 2500 * MS)
    reported = [watch.heartbeat(5000 * MS + number * PERIOD // 2) for number in range(100)]
    assert sum(reported) == 1, "a true one is found afterwards"


def test_a_second_device_is_reported_again_when_it_was_away():
    watch = DuplicateWatch(PERIOD)
    assert sum(watch.heartbeat(number * PERIOD // 2) for number in range(400)) == 1
    assert not any(watch.heartbeat((200 + number) * PERIOD) for number in range(150))
    assert sum(watch.heartbeat(350 * PERIOD + number * PERIOD // 2) for number in range(400)) == 1
