#!/usr/bin/env bash
# canopen 2.4.1 (PyPI) and an object that does not begin at a byte of its PDO.
#
# Input: an EDS whose TPDO 1 maps a BOOLEAN with 1 bit, then an UNSIGNED16 with 16 bits, as CiA 301 allows (7.5.2.36:
# the length of a mapped object is in bits). A TPDO arrives with speed 0x7FFF, and one with 0x8000.
# Seen: 0x7FFF is read as 0x7FFF, 0x8000 as 0. The bits beyond the second byte are not read, without an error.
# One would guess 0x8000.
# Why it matters: most values are right, since small numbers need no high bits. A counter jumps back by 32768, and with
# three bits in front already by 8192.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen==2.4.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

import canopen
from canopen.objectdictionary import BOOLEAN, UNSIGNED8, UNSIGNED16, UNSIGNED32, ODRecord, ODVariable

od = canopen.ObjectDictionary()
for index, name, values in (
    (0x1800, "communication", ((UNSIGNED8, 2), (UNSIGNED32, 0x185), (UNSIGNED8, 1))),
    (0x1A00, "mapping", ((UNSIGNED8, 2), (UNSIGNED32, 0x20010001), (UNSIGNED32, 0x20020010))),
):
    record = ODRecord(name, index)
    for subindex, (data_type, value) in enumerate(values):
        variable = ODVariable(f"{name} {subindex}", index, subindex)
        variable.data_type, variable.default, variable.access_type = data_type, value, "rw"
        record.add_member(variable)
    od.add_object(record)
for index, name, data_type in ((0x2001, "ready", BOOLEAN), (0x2002, "speed", UNSIGNED16)):
    variable = ODVariable(name, index)
    variable.data_type, variable.pdo_mappable = data_type, True
    od.add_object(variable)

node = canopen.Network().add_node(5, od)
node.tpdo.read(from_od=True)
tpdo, seen = node.tpdo[1], []
for speed in (0x7FFF, 0x8000):
    tpdo.on_message(0x185, bytearray((speed << 1 | 1).to_bytes(3, "little")), 0.0)
    seen.append((tpdo["ready"].raw, tpdo["speed"].raw))
print(f"canopen {importlib.metadata.version('canopen')}: (ready, speed) for speed 0x7FFF: {seen[0]}, for 0x8000: {seen[1]}")
sys.exit(seen != [(True, 0x7FFF), (True, 0)])
PYTHON
