#!/usr/bin/env bash
# can-waveshare 0.1.0 (PyPI, a python-can interface of a CAN gateway on Ethernet) and recv() with a time-out of 0.
#
# Input: a gateway on the loopback interface sends a heartbeat and a TPDO in the 13 bytes of its format. When both have
# arrived, the program polls: recv(0), ten times, and then recv(0.5).
# Seen: recv(0) returns None ten times. recv(0.5) returns the heartbeat, and the next one the TPDO.
# One would guess both frames from the first two recv(0): 0 means "do not wait", and there is nothing to wait for.
# Why it matters: a cycle that empties its bus without waiting, and a python-can Notifier with an asyncio loop, both
# use recv(0). On this gateway they receive nothing, without an error: every node seems to be lost.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" || exit 2
"$folder/venv/bin/pip" install -q can-waveshare==0.1.0 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import select
import socket
import sys

from can_waveshare import WaveShareBus

frames = ((0x705, bytes([5])), (0x185, bytes([0x37, 0x02])))
with socket.create_server(("127.0.0.1", 0)) as server:
    bus = WaveShareBus(host="127.0.0.1", port=server.getsockname()[1])
    gateway, _address = server.accept()
    for can_id, data in frames:
        gateway.sendall(bytes([len(data)]) + can_id.to_bytes(4, "big") + data.ljust(8, b"\0"))
    arrived = select.select([bus.fileno()], [], [], 5.0)[0] != []
    polled = [bus.recv(0) for _ in range(10)]
    waited = [(message.arbitration_id, bytes(message.data)) for message in (bus.recv(0.5), bus.recv(0.5)) if message]
    bus.shutdown()
    gateway.close()
print(
    f"can-waveshare {importlib.metadata.version('can-waveshare')}: arrived: {arrived},"
    f" recv(0): {sum(message is not None for message in polled)} of 2 frames, recv(0.5): {len(waited)} of 2"
)
sys.exit(not arrived or any(polled) or waited != list(frames))
PYTHON
