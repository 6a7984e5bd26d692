#!/usr/bin/env bash
# python-can-damiao 0.1.0 (PyPI, a python-can interface of a USB adapter) and frames that come together.
#
# Input: a pseudo terminal in place of the adapter sends five received frames in the 16 bytes that the package
# documents: after a SYNC the TPDOs of five nodes, 0x181 to 0x185, in one write. Then the program calls recv(0.5) until
# nothing comes.
# Seen: one frame, 0x181. All five are taken from the buffer, and the first is returned; the other four are gone.
# One would guess five frames from five calls.
# Why it matters: the nodes of a CANopen bus answer a SYNC together, and USB hands them over together. Which of them
# gets through depends on the timing, so that the nodes seem to fail by turns.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" || exit 2
"$folder/venv/bin/pip" install -q python-can-damiao==0.1.0 python-can==4.6.1 pyserial==3.5 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import os
import sys
import tty

import can

adapter, terminal = os.openpty()
tty.setraw(terminal)
bus = can.Bus(os.ttyname(terminal), interface="damiao", bitrate=500000)
os.read(adapter, 100)  # the bit rate that is set
data = bytes.fromhex("3702").ljust(8, b"\0")
frames = [bytes([0xAA, 0x11, 2]) + (0x180 + node).to_bytes(4, "big") + data + b"\x55" for node in range(1, 6)]
os.write(adapter, b"".join(frames))
received = []
while (message := bus.recv(0.5)) is not None:
    received.append(f"{message.arbitration_id:X}")
bus.shutdown()
os.close(adapter)
os.close(terminal)
print(f"python-can-damiao {importlib.metadata.version('python-can-damiao')}: 5 frames sent together, received: {received}")
sys.exit(received != ["181"])
PYTHON
