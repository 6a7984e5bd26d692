#!/usr/bin/env bash
# canviz 0.3.1 (PyPI) and a drive that stops quickly.
# (Its decoder needs canopen only; the package is installed without its web server.)
#
# Input: TPDO 1 of a CiA 402 drive, the statusword in its first two bytes, as the package's documentation has it for a
# bus without an EDS: first 0x0237 (OPERATION ENABLED), 0x0217 (QUICK STOP ACTIVE: bit 5 = 0), then 0x0238 (FAULT, with
# bit 5 still set, which CiA 402-2 leaves open in that state).
# Seen: 0x0217 is shown as "Operation Enabled", and 0x0238 as "Quick Stop Active".
# One would guess the states of CiA 402-2, table of the statusword: the package has a name for both.
# Why it matters: who presses the quick stop sees a drive that goes on, and who looks for a fault sees a stop that was
# asked for. The two states need different ways back: 0x0F or 0x00 after a quick stop, a fault reset after a fault.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen==2.4.1 2>/dev/null || exit 2
"$folder/venv/bin/pip" install -q --no-deps canviz==0.3.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

from canviz.canopen_store import canopen_store

canopen_store.set_mode("on")
seen = {}
for statusword in (0x0237, 0x0217, 0x0238):
    frame = canopen_store.process_frame(0x185, statusword.to_bytes(2, "little"), False)
    seen[f"0x{statusword:04X}"] = frame["cia402_state_default"]
print(f"canviz {importlib.metadata.version('canviz')}: {seen}")
sys.exit(list(seen.values()) != ["Operation Enabled", "Operation Enabled", "Quick Stop Active"])
PYTHON
