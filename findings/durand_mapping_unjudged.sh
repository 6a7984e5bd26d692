#!/usr/bin/env bash
# durand 0.5.0 (PyPI) and PDO mappings that do not fit.
# (It imports python-can without requiring it; 4.6.1 is installed beside it.)
#
# Input: a node with three objects of 32 bits. A client switches TPDO 1 off, writes a mapping to 0x1A00, and switches
# the TPDO on again, in the order of CiA 301. The first mapping has all three objects, 96 bits; the second has 16 bits
# of one of them. All requests are well-formed SDO downloads.
# Seen: every download is confirmed. After SYNC the first TPDO has 12 data bytes, which no CAN 2.0 frame holds; the
# second has 4 bytes, although its mapping says 2.
# One would guess an abort: 0x06040042 for the length of the PDO, 0x06040041 for an object that cannot be mapped so.
# Why it matters: a master that relies on the abort to notice its mistake sees none, and a receiver of the second PDO
# drops it for its length, or decodes what follows from the wrong place.
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
for number in (1, 2, 3):
    node.object_dictionary[0x2000 + number] = Variable(DatatypeEnum.UNSIGNED32, "rw", number)
wire.put(0x000, bytes((1, 5)))


def download(index, subindex, value, size):
    command = {1: 0x2F, 4: 0x23}[size]
    return wire.put(0x605, struct.pack("<BHBI", command, index, subindex, value))[0][1][0] == 0x60


def lengths(*mapping):
    steps = [(0x1800, 1, 0x80000185, 4), (0x1800, 2, 1, 1), (0x1A00, 0, 0, 1)]
    steps += [(0x1A00, slot, entry, 4) for slot, entry in enumerate(mapping, 1)]
    steps += [(0x1A00, 0, len(mapping), 1), (0x1800, 1, 0x185, 4)]
    confirmed = all([download(*step) for step in steps])
    return confirmed, [len(data) for cob_id, data in wire.put(0x080, b"") if cob_id == 0x185]


whole, half = lengths(0x20010020, 0x20020020, 0x20030020), lengths(0x20010010)
print(f"durand {importlib.metadata.version('durand')}: 96 bits mapped: confirmed {whole[0]}, TPDO of {whole[1]} bytes;",
      f"16 bits mapped: confirmed {half[0]}, TPDO of {half[1]} bytes")
sys.exit((whole, half) != ((True, [12]), (True, [4])))
PYTHON
