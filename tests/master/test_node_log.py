"""Events of a node: EMCY messages, missing process data, a second node with the same node-ID."""

from types import SimpleNamespace

import pytest

from canopen_control.cia301.emcy import EmcyMessage
from canopen_control.cia301.pdo import MappedObject
from canopen_control.master.cycle import ReceivedPdo
from canopen_control.master.event_log import Level
from canopen_control.master.keys import SupervisionKeys
from canopen_control.master.node_log import NodeLog
from canopen_control.od.model import DataType
from canopen_control.rpc.messages.fault import FaultEvent


class WithEvents:
    """A log and the events that it reported."""

    def __init__(self, log, events):
        self.log, self.collected = log, events

    def __getattr__(self, name):
        return getattr(self.log, name)


@pytest.fixture
def log():
    events = []
    log = NodeLog(SimpleNamespace(node_id=3, name="left", supervision=SupervisionKeys()), events.append, 100_000_000)
    return WithEvents(log, events)


def hear(log, message, now):
    log.errors.receive(message.encode(), now)
    return log.emcy(FaultEvent.of_emcy(message), now)


def test_an_emergency_is_its_code_its_words_and_its_bytes(log):
    assert hear(log, EmcyMessage(3, 0x4310, 9), 5) == "EMCY 0x4310 (drive temperature too high)"
    (event,) = log.collected
    assert (event.time, event.kind, event.node, event.level) == (5, "emcy", "left", Level.WARNING)
    assert event.text.startswith("node 3 (left): EMCY 0x4310 (drive temperature too high), register 0x09")


def test_what_an_emergency_holds_is_there_for_programs_too(log):
    hear(log, EmcyMessage(3, 0x4310, 9, b"\1\2"), 5)
    hear(log, EmcyMessage(3, 0, 0), 5)
    assert [event.details for event in log.collected] == [
        FaultEvent(error_code=0x4310, error_register=9, data="0102"),
        FaultEvent(error_code=0, error_register=0, data="0000000000"),
    ]


@pytest.mark.parametrize(("code", "hint"), [(0x8240, "0x1019"), (0x8120, "nmt reset-comm"), (0x8130, "axis enable")])
def test_what_helps_is_reported_with_it(log, code, hint):
    hear(log, EmcyMessage(3, code, 0x11), 0)
    assert hint in log.collected[0].text


def test_the_end_of_an_error_names_those_that_are_left(log):
    hear(log, EmcyMessage(3, 0x4310, 0x09), 0)
    hear(log, EmcyMessage(3, 0x3220, 0x0D), 0)
    assert hear(log, EmcyMessage(3, 0, 0x09), 0) is None
    assert "still active: 0x4310" in log.collected[-1].text
    assert hear(log, EmcyMessage(3, 0, 0), 0) is None
    assert "still" not in log.collected[-1].text


def test_a_flood_is_kept_but_reported_in_sum(log):
    for number in range(100):
        assert hear(log, EmcyMessage(3, 0xFF00, 1, bytes([number])), number) is not None
    assert len(log.collected) == 10
    log.tick(log.deadline)
    assert log.collected[-1].kind == "emcy_flood"
    assert "90 more EMCY" in log.collected[-1].text


def test_process_data_are_reported_when_they_go_and_come_and_never_were(log):
    pdo = ReceivedPdo(0x183, [MappedObject(0x6041, 0, 16, DataType.UNSIGNED16)], 1)
    pdo.overdue, pdo.silent = True, 3
    log.pdo(pdo, 0)
    pdo.receive(bytes(8), 2, 1)
    log.pdo(pdo, 1)
    pdo.overdue = False
    log.pdo(pdo, 2)
    assert [event.kind for event in log.collected] == ["pdo_missing", "pdo_stale", "pdo_back"]
    for length in (1, 1, 3, 3, 1):
        log.malformed(pdo, length, 3)
    assert [event.kind for event in log.collected[3:]] == ["pdo_short", "pdo_long"], "each once"


def test_a_restart_clears_the_errors_and_two_at_once_are_two_nodes(log):
    hear(log, EmcyMessage(3, 0x4310, 9), 0)
    log.boot_up(10)
    assert log.errors.active == ()
    log.boot_up(11)
    assert log.collected[-1].kind == "duplicate_node"
    for number in range(40):
        log.heartbeat(number)
    assert sum(event.kind == "duplicate_node" for event in log.collected) == 1
