#!/usr/bin/env bash
# durand 0.5.0 (PyPI) and NMT reset node.
# (It imports python-can without requiring it; 4.6.1 is installed beside it.)
#
# Input: a client writes 0x1017 (producer heartbeat time) = 500 ms, an object of the manufacturer and the COB-ID of
# TPDO 1, stores nothing, and sends NMT reset node.
# Seen: the boot-up message comes, and all three objects hold what was written.
# One would guess the values of the last power-on: CiA 301 has reset node set the parameters of the profiles and of
# the manufacturer, and reset communication those of 0x1000 to 0x1FFF.
# Why it matters: a reset is how a master gets a node without the settings of another program; what an earlier program
# wrote, such as a PDO with a COB-ID of its own, goes on after it.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q durand==0.5.0 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import struct
import sys

from durand import DatatypeEnum, Node, Variable
from durand.network import NetworkABC


class Wire(NetworkABC):
    def __init__(self):
        self.receivers, self.sent = {}, []

    def add_subscription(self, cob_id, callback):
        self.receivers[cob_id] = callback

    def remove_subscription(self, cob_id):
        del self.receivers[cob_id]

    def send(self, cob_id, msg):
        self.sent.append((cob_id, bytes(msg)))

    def put(self, cob_id, data):
        self.sent.clear()
        self.receivers[cob_id](cob_id, data)
        return list(self.sent)


wire = Wire()
node = Node(wire, 5)
node.object_dictionary[0x2001] = Variable(DatatypeEnum.UNSIGNED32, "rw", 7)
OBJECTS = {(0x1017, 0): (0x2B, 500), (0x2001, 0): (0x23, 8), (0x1800, 1): (0x23, 0x80000385)}


def values():
    answers = [wire.put(0x605, struct.pack("<BHB4x", 0x40, *address))[0][1] for address in OBJECTS]
    return [int.from_bytes(answer[4:], "little") for answer in answers]


before = values()
for (index, subindex), (command, value) in OBJECTS.items():
    answer = wire.put(0x605, struct.pack("<BHBI", command, index, subindex, value))[-1][1]
    assert answer[0] == 0x60, answer.hex()
written = values()
booted = (0x705, b"\0") in wire.put(0x000, bytes((0x81, 5)))
after = values()
print(f"durand {importlib.metadata.version('durand')}: 0x1017, 0x2001, 0x1800:01 at first {before}, written {written},",
      f"boot-up {booted}, after reset node {after}")
sys.exit(not (booted and after == written != before))
PYTHON
