"""A foreign device that floods a bus, as a process: `python -m campaigner.flood KIND CHANNEL SECONDS`.

No frame of it looks like one of the robot's own process data: those are what the observer judges.
"""

from __future__ import annotations

import os
import random
import sys
import time
from typing import TYPE_CHECKING, Final

from canopen_control.bus.channel import open_port
from canopen_control.frame import EXTENDED_FLAG, CanFrame, pack_records, remote_frame

if TYPE_CHECKING:
    from collections.abc import Callable


_TAKEN: Final = (0, 1, 2, 3)  # node-IDs of the robot, and the broadcast services
_PERIOD_S: Final = 0.01
_draw = random.Random(2)


def _junk() -> CanFrame:
    if _draw.random() < 0.2:
        return CanFrame(EXTENDED_FLAG | _draw.randrange(1 << 29), _draw.randbytes(8))
    while (identifier := _draw.randrange(1, 0x780)) & 0x7F in _TAKEN:
        pass
    return CanFrame(identifier, _draw.randbytes(_draw.randrange(9)))


#: frames to send, and the number of frames every 10 ms
KINDS: Final[dict[str, tuple[Callable[[], CanFrame], int]]] = {
    "junk": (_junk, 30),
    "remote": (lambda: remote_frame(_draw.choice((0x182, 0x183, 0x282, 0x283, 0x702, 0x703)), 8), 5),
    "sync": (lambda: CanFrame(0x080), 1),
    "emergency": (lambda: CanFrame(0x080 + _draw.choice((2, 3)), _draw.randbytes(8)), 10),
    "master_heartbeat": (lambda: CanFrame(0x701, b"\x05"), 2),
}


def main(arguments: list[str]) -> None:
    """Flood the bus as the command line says."""
    kind, channel, seconds = arguments
    os.nice(5)
    make, count = KINDS[kind]
    port = open_port(channel, label="foreigner")
    end = time.monotonic() + float(seconds)
    while time.monotonic() < end:
        port.send(pack_records(make() for _ in range(count)))
        port.receive()
        time.sleep(_PERIOD_S)
    port.close()


if __name__ == "__main__":
    main(sys.argv[1:])
