"""Fills a bus with TPDOs of existing drives, one frame at a time, at wire speed.

python -m canopen_control_bench.talker CHANNEL FIRST_NODE COUNT RATE SECONDS        -> {"sent": frames}
"""

from __future__ import annotations

import json
import sys
import time

from canopen_control.bus.channel import open_port
from canopen_control.frame import RECORD

_TPDO2 = 0x280
_RANGE = 50  # counts: noise of the encoder of a drive at standstill


def talk(channel: str, nodes: range, rate: float, seconds: float) -> int:
    """Send for the given time; return the number of frames sent."""
    port = open_port(channel, label="talker")
    now, sleep = time.monotonic_ns, time.sleep
    gap, count = 1e9 / rate, round(rate * seconds)
    begin = now()
    for number in range(count):
        if (rest := begin + number * gap - now()) > 0:
            sleep(rest / 1e9)
        node = nodes[number % len(nodes)]
        position = (number // len(nodes)) % _RANGE
        port.send(RECORD.pack(_TPDO2 + node, 8, position.to_bytes(4, "little") + bytes(4)))
    while port.wants_write:
        port.flush()
    port.close()
    return count


def main() -> None:
    """Send as the arguments say, when a line arrives."""
    channel, first, count, rate, seconds = sys.argv[1:6]
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    sys.stdin.readline()
    sent = talk(channel, range(int(first), int(first) + int(count)), float(rate), float(seconds))
    sys.stdout.write(json.dumps({"sent": sent}) + "\n")


if __name__ == "__main__":
    main()
