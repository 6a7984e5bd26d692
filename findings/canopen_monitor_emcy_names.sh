#!/usr/bin/env bash
# canopen-monitor 4.1.0 (PyPI) and the names of emergency codes.
#
# Input: EMCY messages of node 5 with the codes 0x0000, 0x1000, 0x2310, 0x8110, 0x8130 and 0x8210, in the byte order of
# CiA 301: least significant byte first. The package has a table with a name for all but 0x2310.
# Seen: 0x0000 is named; all others are "Error code not found". The bytes are taken in the other order, so that the name
# of 0x8210, "PDO not processed due to length error", comes with the code 0x1082.
# One would guess a name for five of the six.
# Why it matters: the text is what a user reads when a device reports an error. Only "no error" is ever right, and a
# code of a manufacturer can get the name of an error that did not happen.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen-monitor==4.1.0 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

from canopen_monitor.can import Message
from canopen_monitor.parse import CANOpenParser

parser, seen = CANOpenParser({}), {}
for code in (0x0000, 0x1000, 0x2310, 0x8110, 0x8130, 0x8210, 0x1082):
    message = Message(0x085, data=list(code.to_bytes(2, "little") + bytes([0x01]) + bytes(5)))
    seen[code] = parser.parse(message)[0]
texts = {f"0x{code:04X}": text for code, text in seen.items()}
print(f"canopen-monitor {importlib.metadata.version('canopen-monitor')}: {texts}")
unknown = all(seen[code] == "Error code not found" for code in (0x1000, 0x2310, 0x8110, 0x8130, 0x8210))
sys.exit(not (unknown and seen[0] == "Error reset or no error" and seen[0x1082].startswith("PDO not processed")))
PYTHON
