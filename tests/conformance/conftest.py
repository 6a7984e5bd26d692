"""A virtual device and a checked node on one bus, in virtual time."""

import pytest

from canopen_control.bus.memory import MemoryBus
from canopen_control.conformance.checked_node import CheckedNode
from canopen_control.data_files import data_path
from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_host import NodeHost
from canopen_control.virtual.quirks import switches_of

NODE = 5


@pytest.fixture
def bench(request):
    """Return a function that makes the session with a virtual device on a bus of its own."""
    opened = []

    def make(eds="generic_cia402.eds", node_id=NODE, quirks=()):
        path = data_path("eds", eds)
        reactor, bus = Reactor(ManualClock(1_000_000_000)), MemoryBus(f"conformance-{request.node.name}-{len(opened)}")
        device = make_device(path, NODE)
        switches_of(device).start_with(quirks)
        host = NodeHost(reactor, bus.open("device"), [device])
        reactor.run_for(8_000_000_000 if quirks else 10_000_000)  # some boot late
        session = CheckedNode(reactor, bus.open("conform"), node_id, read_eds(path, NODE))
        session.device = device
        opened.append((session, host, bus, reactor))
        return session

    yield make
    for session, host, bus, reactor in opened:
        session.close()
        host.close()
        bus.close()
        reactor.close()
