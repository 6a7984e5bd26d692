"""Checks at a device of another library, the `canopen` package's LocalNode, whose known failures they find."""

import canopen
import pytest

from canopen_control.bus.channel import open_port
from canopen_control.conformance.checked_node import CheckedNode
from canopen_control.conformance.run import CHECKS, run_checks
from canopen_control.data_files import data_path
from canopen_control.host.reactor import Reactor

NODE = 5
EDS = str(data_path("eds", "generic_cia402.eds"))
KNOWN = {
    "S05": "answer 43 00 10 01",  # an object without subindices is shown for every subindex
    "S06w": "answer 60 04 10 00",  # its server looks at the object when all segments are there
    "S03s": "answer 60 00 10 00",
    "S25": "answer 0",  # what is left of the transfer before
    "S26": "43 00 10 00",
}


@pytest.fixture
def local_node():
    network = canopen.Network()
    network.connect(interface="virtual", channel="conformance")
    network.add_node(canopen.LocalNode(NODE, EDS))
    port = open_port("virtual:conformance")
    with Reactor() as reactor:
        yield CheckedNode(reactor, port, NODE)
        port.close()
    network.disconnect()


def test_the_known_failures_of_another_library_are_found(local_node):
    checks = [check for check in CHECKS if check.id in ("S01", "S03", "S06", "S07", "S14", "S15", *KNOWN)]
    report = run_checks(local_node, checks)
    failed = {result.id: result.came for result in report.results if result.verdict == "failed"}
    assert failed.keys() == KNOWN.keys()
    assert [check_id for check_id, came in KNOWN.items() if not failed[check_id].startswith(came)] == []
    assert report.failed
