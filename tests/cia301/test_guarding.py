from __future__ import annotations

import pytest
from support.services import frame, vectors

from canopen_control.cia301.guarding import GuardingEvent, GuardingEventKind, GuardingMaster, GuardingSlave
from canopen_control.cia301.nmt import NmtState
from canopen_control.errors import LocalProtocolError

KIND = GuardingEventKind
REQUEST = next(v["request_rtr"] for v in vectors()["heartbeat"] if "request_rtr" in v)


def kinds(core: GuardingMaster | GuardingSlave) -> list[GuardingEventKind]:
    return [event.kind for event in core.events()]


def guarding(guard_ns: int = 100, factor: int = 3) -> GuardingMaster:
    master = GuardingMaster()
    master.watch(3, guard_ns, factor, 0)
    return master


def operational_slave(**settings: int) -> GuardingSlave:
    slave = GuardingSlave(3, **settings)
    slave.state = NmtState.OPERATIONAL
    return slave


def test_the_master_asks_on_its_grid_to_the_nanosecond():
    master = guarding()
    master.tick(0)
    assert master.frames() == [frame(REQUEST)]
    master.tick(99)
    assert (master.frames(), master.next_deadline()) == ([], 100)
    master.tick(110)
    assert (master.frames(), master.next_deadline()) == ([frame(REQUEST)], 200)


def test_answers_alternate_their_toggle_bit_from_zero():
    slave = operational_slave()
    for _ in range(3):
        slave.receive(frame(REQUEST), 0)
    assert slave.frames() == [frame("703#05"), frame("703#85"), frame("703#05")]
    slave.reset()
    slave.receive(frame(REQUEST), 0)
    assert slave.frames() == [frame("703#05")]


def test_master_and_slave_are_compatible():
    master, slave = guarding(), operational_slave()
    for now in range(0, 1000, 100):
        master.tick(now)
        for request in master.frames():
            slave.receive(request, now)
        for answer in slave.frames():
            master.receive(answer, now + 1)
        if now == 500:
            slave.state = NmtState.STOPPED
    assert kinds(master) == [KIND.STARTED, KIND.CHANGED]
    assert master.state_of(3) is NmtState.STOPPED


def test_a_silent_node_is_lost_after_its_life_time_and_returns():
    master = guarding()
    master.receive(frame("703#05"), 50)
    master.tick(349)
    assert kinds(master) == [KIND.STARTED]
    master.tick(350)
    master.tick(900)
    assert master.events() == [GuardingEvent(KIND.MISSED, 3, NmtState.OPERATIONAL)]
    master.receive(frame("703#FF"), 950)
    assert kinds(master) == [KIND.RESOLVED, KIND.CHANGED]


def test_a_wrong_toggle_bit_is_reported_and_is_not_a_sign_of_life():
    master = guarding()
    master.receive(frame("703#05"), 0)
    master.receive(frame("703#05"), 100)
    assert kinds(master) == [KIND.STARTED, KIND.TOGGLE_ERROR]
    master.tick(300)
    assert kinds(master) == [KIND.MISSED]


def test_a_boot_up_starts_the_toggle_bit_again():
    master = guarding()
    master.receive(frame("703#05"), 0)
    master.receive(frame("703#00"), 10)
    master.receive(frame("703#7F"), 20)
    assert kinds(master) == [KIND.STARTED, KIND.BOOT_UP, KIND.CHANGED]


def test_wrong_lengths_and_foreign_nodes_are_ignored():
    master = guarding()
    for text in ("703#", "703#0505", "704#05", REQUEST):
        master.receive(frame(text), 0)
    assert (master.events(), master.malformed) == ([], 2)


def test_unwatching_ends_the_asking():
    master = guarding()
    master.unwatch(3)
    master.unwatch(3)
    master.tick(100)
    assert (master.frames(), master.next_deadline(), master.state_of(3)) == ([], None, None)


@pytest.mark.parametrize(("node_id", "time", "factor"), [(0, 1, 1), (128, 1, 1), (3, 0, 1), (3, 1, 0)])
def test_impossible_guarding_is_refused(node_id, time, factor):
    with pytest.raises(LocalProtocolError):
        GuardingMaster().watch(node_id, time, factor, 0)


def test_the_slave_guards_its_master_from_the_first_question_on():
    slave = operational_slave(guard_time_ns=100, life_time_factor=3)
    assert slave.next_deadline() is None
    slave.receive(frame(REQUEST), 0)
    slave.tick(299)
    assert slave.events() == []
    slave.tick(300)
    slave.tick(900)
    assert kinds(slave) == [KIND.MISSED]
    slave.receive(frame(REQUEST), 1000)
    assert kinds(slave) == [KIND.RESOLVED]
    assert slave.next_deadline() == 1300


def test_without_a_life_time_the_slave_answers_and_does_not_guard():
    slave = operational_slave()
    slave.receive(frame(REQUEST), 0)
    slave.tick(10**12)
    assert (len(slave.frames()), slave.events(), slave.next_deadline()) == (1, [], None)


def test_a_slave_with_heartbeat_or_initialising_is_silent():
    slave = operational_slave()
    slave.enabled = False
    slave.receive(frame(REQUEST), 0)
    initialising = GuardingSlave(3)
    initialising.receive(frame(REQUEST), 0)
    slave.receive(frame("703#05"), 0)
    assert slave.frames() == initialising.frames() == []


def test_a_node_that_was_running_before_it_was_guarded_begins_with_either_toggle_bit():
    master = guarding()
    master.receive(frame("703#85"), 0)
    master.receive(frame("703#05"), 100)
    master.receive(frame("703#85"), 200)
    assert kinds(master) == [KIND.STARTED]


def test_no_node_is_lost_without_a_request_or_for_a_queued_answer():
    master = guarding()
    master.receive(frame("703#05"), 0)
    master.postpone(1000)
    master.tick(1299)
    master.receive(frame("703#85"), 5000, since=1299)
    assert kinds(master) == [KIND.STARTED]
    master.tick(5300)
    assert kinds(master) == [KIND.MISSED]
