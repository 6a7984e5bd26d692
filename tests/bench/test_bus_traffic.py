"""Traffic on several buses: the rate is kept, and every frame is counted."""

import time

from canopen_control_bench.bus_traffic import Ears, send_all

from canopen_control.bus.memory import MemoryBus
from canopen_control.host.reactor import Reactor


def test_what_is_sent_on_two_ports_is_counted_on_two_others():
    buses = MemoryBus("one"), MemoryBus("two")
    ours, theirs = [bus.open() for bus in buses], [bus.open() for bus in buses]
    begin = time.monotonic()
    with Reactor() as reactor:
        ears = Ears(reactor, theirs)
        assert send_all(ours, 3000.0, 0.1) == 600
        reactor.run_until(lambda: ears.heard >= 600, 5_000_000_000)
    assert ears.heard == 600
    assert time.monotonic() - begin >= 0.1
