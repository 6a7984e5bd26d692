#!/usr/bin/env bash
# durand 0.5.0 (PyPI) and the subindices of an object that has none.
# (It imports python-can without requiring it; 4.6.1 is installed beside it.)
#
# Input: SDO uploads of 0x1000 (device type, a variable) with the subindices 0, 1, 77 and 255.
# Seen: all four answer with the same value.
# One would guess the value for subindex 0 and abort 0x06090011 (subindex does not exist) for the others.
# Why it matters: a program that lists a node by reading subindices until one is refused finds 255 of each variable,
# and a backup made so holds thousands of entries that no EDS has; a wrong subindex in a configuration is not noticed.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q durand==0.5.0 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import struct
import sys

from durand import Node
from durand.network import NetworkABC


class Wire(NetworkABC):
    def __init__(self):
        self.receivers, self.sent = {}, []

    def add_subscription(self, cob_id, callback):
        self.receivers[cob_id] = callback

    def remove_subscription(self, cob_id):
        del self.receivers[cob_id]

    def send(self, cob_id, msg):
        if cob_id == 0x585:
            self.sent.append(bytes(msg))


wire = Wire()
node = Node(wire, 5)
for subindex in (0, 1, 77, 255):
    wire.receivers[0x605](0x605, struct.pack("<BHB4x", 0x40, 0x1000, subindex))
print(f"durand {importlib.metadata.version('durand')}: uploads of 0x1000:00, :01, :4D and :FF:",
      ", ".join(answer.hex(" ") for answer in wire.sent))
sys.exit([answer[0] for answer in wire.sent] != [0x43] * 4)
PYTHON
