from __future__ import annotations

from canopen_control.cia301.emcy import EmcyProducer
from canopen_control.frame import CanFrame
from canopen_control.virtual.node_outbox import HEARTBEAT_ERROR, EmergencyRaised, NodeClock, NodeOutbox


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
