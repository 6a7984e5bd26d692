#!/usr/bin/env bash
# canopen 2.4.1 (PyPI) and the state 'DISABLE VOLTAGE' of a CiA 402 drive.
#
# Input: BaseNode402 with a drive that follows the controlword as CiA 402-2 has it. A program sets `node.state =
# 'DISABLE VOLTAGE'`, which the documentation of `state` lists: "only as a command when writing".
# Seen: in SWITCH ON DISABLED the controlwords 6, 7 and 15 are sent, in READY TO SWITCH ON 7 and 15, in SWITCHED ON 15:
# the motor gets current. In OPERATION ENABLED nothing is sent. In each case a ValueError follows, "Illegal state
# transition from OPERATION ENABLED to None", and the drive stays in OPERATION ENABLED.
# One would guess one controlword with bit 1 = 0 (disable voltage), in every state: CiA 402-2, table of the commands.
# Why it matters: the command that takes the current from the motor is the one for emergencies; it does the reverse.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen==2.4.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys

import canopen
from canopen.profiles.p402 import BaseNode402

WORDS = {"SWITCH ON DISABLED": 0x40, "READY TO SWITCH ON": 0x21, "SWITCHED ON": 0x23, "OPERATION ENABLED": 0x27}
AFTER = {6: 0x21, 7: 0x23, 15: 0x27}  # controlword -> statusword; all others of this program take the voltage away


class Drive(BaseNode402):
    """A drive without a bus: the controlwords are kept, and the statusword follows them."""

    def __init__(self, state: str) -> None:
        super().__init__(5, canopen.ObjectDictionary())
        self.word, self.sent = WORDS[state], []

    @property
    def statusword(self) -> int:
        return self.word

    @property
    def controlword(self) -> int:
        return self.sent[-1]

    @controlword.setter
    def controlword(self, value: int) -> None:
        self.sent.append(value)
        self.word = AFTER.get(value, 0x40)

    def check_statusword(self) -> int:
        return self.word


seen = {}
for state in WORDS:
    drive = Drive(state)
    try:
        drive.state = "DISABLE VOLTAGE"
        end = "done"
    except ValueError:
        end = "ValueError"
    seen[state] = drive.sent, drive.state, end
print(f"canopen {importlib.metadata.version('canopen')}: DISABLE VOLTAGE from each state (sent, then in): {seen}")
expected = ([6, 7, 15], [7, 15], [15], [])
sys.exit(list(seen.values()) != [(sent, "OPERATION ENABLED", "ValueError") for sent in expected])
PYTHON
