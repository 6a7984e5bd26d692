"""A virtual device and a checked node on one bus, in virtual time."""

import pytest
from support.jitter_wire import Relay

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

    def make(eds="generic_cia402.eds", node_id=NODE, quirks=(), seed=None):
        path = data_path("eds", eds)
        name = f"conformance-{request.node.name}-{len(opened)}"
        reactor, bus = Reactor(ManualClock(1_000_000_000)), MemoryBus(name)
        other, relay = (bus, None) if seed is None else (MemoryBus(f"{name}-far"), None)
        device = make_device(path, NODE)
        switches_of(device).start_with(quirks)
        host = NodeHost(reactor, bus.open("device"), [device])
        reactor.run_for(8_000_000_000 if quirks else 10_000_000)  # some boot late
        if seed is not None:
            relay = Relay(reactor, bus.open("near"), other.open("far"), seed)
        session = CheckedNode(reactor, other.open("conform"), node_id, read_eds(path, NODE))
        session.device, session.host, session.bus = device, host, bus
        opened.append(tuple(filter(None, (session, host, relay, bus, other, reactor))))
        return session

    yield make
    for parts in opened:
        for part in parts:
            part.close()
