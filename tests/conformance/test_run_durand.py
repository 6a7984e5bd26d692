"""All checks of CiA 301 at a node of the `durand` library, whose known failures they find."""

import pytest
from support.durand_node import durand_node

from canopen_control.bus.memory import MemoryBus
from canopen_control.conformance.check import CheckTouch
from canopen_control.conformance.checked_node import CheckedNode
from canopen_control.conformance.run import choose, run_checks
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock

NODE = 5
MUST = {
    "S05": "answer 43 00 10 01",  # an object without subindices is shown for every subindex
    "S19": "answer CD",  # an acknowledgement of a segment that was never sent ends the block
    "N02": "0x1017 = 500",  # a reset sets no object to its value at power-on
    "R06": "0x1017 = 258",
    "M04": "0x1001 = 0x00",  # an EMCY does not set the error register
    "P06": "frames after SYNC 3, 4, 5",  # the counter of SYNC is not begun again
    "P06h": "241 frames after 480 SYNC",
    "P12": "20 00 01 20 was accepted by 0x1A00:01",  # no rule of mapping is judged
    "P13": "00 was accepted by 0x1A00:00",
    "P14": "3 objects of 32 bits were accepted",
    "P14c": "41 was accepted by 0x1A00:00",
    "P15": "20 00 04 10 was accepted by 0x1A00:01",
    "P15u": "20 01 18 10 was accepted by 0x1A00:01",
}
SHOULD = {"S26", "O07v", "M04b", "M07", "R05s", "R05e", "R05r", "R05p", "P18", "P21", "P22"}


@pytest.fixture
def node():
    reactor, bus = Reactor(ManualClock(1_000_000_000)), MemoryBus("conformance-durand")
    durand_node(reactor, bus.open("durand"), NODE)
    yield CheckedNode(reactor, bus.open("conform"), NODE)
    bus.close()
    reactor.close()


def test_the_known_failures_of_a_third_library_are_found(node):
    report = run_checks(node, choose("301", CheckTouch))
    failed = {result.id: result.observed for result in report.results if result.verdict == "failed"}
    assert failed.keys() == MUST.keys() | SHOULD
    assert [check_id for check_id, came in MUST.items() if not failed[check_id].startswith(came)] == []
    assert report.count("passed") >= 90
    assert report.count("error") == 0
    assert node.reactor.now() < 180e9  # a whole run takes less than three minutes
