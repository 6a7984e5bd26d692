#!/usr/bin/env bash
# canopen-monitor 4.1.0 (PyPI) and a PDO with objects of one bit.
#
# Input: an EDS whose TPDO 1 maps three objects: two limit switches, BOOLEAN with 1 bit each, and 6 spare bits. The
# PDOs 0 to 3, of one byte. CiA 301 fills a PDO from bit 0 of its first byte, in the order of the mapping.
# Seen: both switches are False in all four, and the spare bits are 0, 1, 2 and 3: the objects are counted from the end
# of the PDO, and all but the last one of a byte are cut off.
# One would guess the first switch True for 1 and 3, the second for 2 and 3, and no spare bits.
# Why it matters: a drive at its limit switch looks as if it were not. Objects of whole bytes are right, so that nothing
# makes one doubt the bits.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen-monitor==4.1.0 2>/dev/null || exit 2

cat >"$folder/decode.py" <<'PYTHON'
import importlib.metadata
import sys

from canopen_monitor.can import Message
from canopen_monitor.parse import CANOpenParser, load_eds_file

BOOLEAN, UNSIGNED8, UNSIGNED32 = 1, 5, 7


def variable(section: str, name: str, data_type: int, default: str) -> str:
    return (
        f"[{section}]\nParameterName={name}\nObjectType=0x7\nDataType=0x{data_type:04X}\nAccessType=ro\n"
        f"DefaultValue={default}\nPDOMapping=1\n\n"
    )


with open("switches.eds", "w", encoding="ascii") as file:
    file.write("[1A00]\nParameterName=TPDO mapping parameter\nObjectType=0x9\nSubNumber=4\n\n")
    file.write(variable("1A00sub0", "Number of mapped objects", UNSIGNED8, "3"))
    for subindex, mapped in enumerate(("0x20010001", "0x20020001", "0x20030006"), 1):
        file.write(variable(f"1A00sub{subindex}", f"Object {subindex}", UNSIGNED32, mapped))
    file.write(variable("2001", "lower limit", BOOLEAN, "0"))
    file.write(variable("2002", "upper limit", BOOLEAN, "0"))
    file.write(variable("2003", "spare", UNSIGNED8, "0"))

parser = CANOpenParser({5: load_eds_file("switches.eds")})
seen = [parser.parse(Message(0x185, data=[value]))[0] for value in range(4)]
print(f"canopen-monitor {importlib.metadata.version('canopen-monitor')}: PDO 0 to 3: {seen}")
sys.exit(seen != [f"lower limit - False upper limit - False spare - {value}" for value in range(4)])
PYTHON
cd "$folder" && venv/bin/python decode.py
