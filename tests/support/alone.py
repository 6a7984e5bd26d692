"""A network of its own with a way out, watched: run as `unshare --net python alone.py PROGRAM...`.

Makes the loopback interface and one end of a veth pair that leads to the outside, runs each PROGRAM (a JSON list of
words) after the other, the first in the background, and says in JSON how many packets left and what the last one said.
"""

import json
import os
import select
import socket
import subprocess
import sys
import threading

ETH_P_ALL = 3
LINKS = (
    "link set lo up",
    "link add inside type veth peer name outside",
    "addr add 10.77.0.1/24 dev inside",
    "link set inside up",
    "link set outside up",
    "route add default dev inside",
)
SECONDS = 60


class Sniffer(threading.Thread):
    """Counts what comes out of the other end of the veth pair."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL))
        self.socket.bind(("outside", 0))
        self.packets, self._end = [], os.pipe()

    def run(self):
        while self._end[0] not in (ready := select.select([self.socket, self._end[0]], [], [])[0]):
            assert ready
            frame, where = self.socket.recvfrom(65536)
            if where[2] != socket.PACKET_OUTGOING:
                self.packets.append(frame)

    def end(self):
        os.write(self._end[1], b".")
        self.join()
        self.socket.close()


def main():
    with open("/proc/sys/net/ipv6/conf/default/disable_ipv6", "w") as file:
        file.write("1")  # no packets of the kernel's own announcements
    for words in LINKS:
        subprocess.run(["ip", *words.split()], check=True)
    sniffer = Sniffer()
    sniffer.start()
    background, *others = (json.loads(argument) for argument in sys.argv[1:])
    first = subprocess.Popen(background, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        message = [subprocess.run(other, capture_output=True, text=True, timeout=SECONDS) for other in others]
    finally:
        first.terminate()
        output, _ = first.communicate(timeout=SECONDS)
    sniffer.end()
    print(
        json.dumps(
            {
                "packets": len(sniffer.packets),
                "said": [result.stdout + result.stderr for result in message],
                "first": output,
            }
        )
    )


if __name__ == "__main__":
    main()
