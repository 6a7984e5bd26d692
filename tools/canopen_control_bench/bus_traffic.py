"""Traffic on several buses at once: one process sends and one listens, so that their CPU times are separate.

    python -m canopen_control_bench.bus_traffic send RATE SECONDS CHANNEL ...     -> {"sent": frames}
    python -m canopen_control_bench.bus_traffic hear CHANNEL ...                  -> {"heard": frames}

The sender hands over each millisecond what a wire carries in one, on each bus, when a line comes; what it is late with
it makes up for. The listener counts until a line comes.
"""

from __future__ import annotations

import contextlib
import sys
import time
from typing import TYPE_CHECKING

from canopen_control.bus.channel import open_port
from canopen_control.frame import RECORD, RECORD_SIZE
from canopen_control.host.reactor import Reactor
from canopen_control_bench.turns import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.bus.port import Port


_TPDO = 0x180
_TICK_S = 0.001
_DRIVES = 64
_FRAMES = b"".join(RECORD.pack(_TPDO + number % _DRIVES, 8, bytes(8)) for number in range(1024))


def send_all(ports: Sequence[Port], rate: float, seconds: float) -> int:
    """Send `rate` frames per second on each port; return the total number of frames sent."""
    begin = time.monotonic()
    sent, whole = 0, round(rate * seconds)
    while sent < whole:
        due = min(whole, round(rate * (time.monotonic() - begin)), sent + len(_FRAMES) // RECORD_SIZE)
        if due > sent:
            for port in ports:
                port.send(_FRAMES[: (due - sent) * RECORD_SIZE])
            sent = due
        time.sleep(_TICK_S)
        for port in ports:
            port.flush()
    return sent * len(ports)


class Ears:
    """Counts the frames received on several ports."""

    def __init__(self, reactor: Reactor, ports: Sequence[Port]) -> None:
        self.heard = 0
        for port in ports:
            reactor.add_reader(port, lambda port=port: self._hear(port))  # type: ignore[misc] # the port of this iteration

    def _hear(self, port: Port) -> None:
        self.heard += len(port.receive()) // RECORD_SIZE


def main() -> None:
    """Send or listen as the arguments say."""
    role, *words = sys.argv[1:]
    channels = words[2:] if role == "send" else words
    with contextlib.ExitStack() as undo:
        ports = [undo.enter_context(contextlib.closing(open_port(channel, label=role))) for channel in channels]
        say({"ready": True})
        if role == "send":
            sys.stdin.readline()
            say({"sent": send_all(ports, float(words[0]), float(words[1]))})
            sys.stdin.readline()
            return
        with Reactor() as reactor:
            ears = Ears(reactor, ports)
            reactor.add_reader(0, reactor.stop)
            reactor.run()
            say({"heard": ears.heard})


if __name__ == "__main__":
    main()
