import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import S, servo

from canopen_control.bus.memory import MemoryBus
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.virtual.node_id_check import NodeIdTaken
from canopen_control.virtual.served_bus import WINDOW_NS, BusNodes, FoldedLog, ServedBus


@pytest.fixture
def log_reactor():
    made = Reactor(ManualClock(0))
    yield made
    made.close()


def test_the_first_lines_of_a_kind_then_their_number(log_reactor):
    written = []
    log = FoldedLog(log_reactor, written.append)
    for number in range(5):
        log.tell("a", f"a {number}", 2)
    log.tell("b", "b", 2)
    assert written == ["a 0", "a 1", "b"]
    log_reactor.run_for(WINDOW_NS + 1)
    assert written == ["a 0", "a 1", "b", "a 4 (3 more times in 10 s)"]
    log.tell("a", "a 5", 2)
    assert written[-1] == "a 5"


@given(st.lists(st.tuples(st.sampled_from("abc"), st.integers(0, 4 * WINDOW_NS)), max_size=200))
def test_no_line_is_lost_from_the_sum(told):
    log_reactor, written = Reactor(ManualClock(0)), []
    log = FoldedLog(log_reactor, written.append)
    for kind, at in told:
        log_reactor.call_at(at, lambda kind=kind: log.tell(kind, kind, 3))
    log_reactor.run_for(6 * WINDOW_NS)
    log_reactor.close()
    for kind in "abc":
        lines = [line for line in written if line[0] == kind]
        sums = sum(int(line.split("(")[1].split()[0]) for line in lines if "(" in line)
        assert sums + sum("(" not in line for line in lines) == sum(each == kind for each, _ in told)


def test_a_node_that_somebody_serves_is_told_and_what_is_given_up_is_known(log_reactor):
    bus, lost = MemoryBus("served"), []
    ports = [bus.open("a"), bus.open("b")]
    served = [ServedBus(log_reactor, BusNodes(port, [servo(5)]), str, lambda: lost.append(1)) for port in ports]
    try:
        served[0].open()
        assert served[0].ready_line == "drive 5 (servo) ready on memory:served"
        assert not served[0].moving
        with pytest.raises(NodeIdTaken, match="5"):
            served[1].open()
        bus.close()
        log_reactor.run_for(S)
        assert lost
        assert served[0].error is not None
    finally:
        for each in served:
            each.close()
