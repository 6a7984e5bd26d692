#!/usr/bin/env bash
# can-cannelloni 0.1.0 (PyPI, a python-can interface for a cannelloni server) and a node guarding request.
#
# Input: what a cannelloni server sends on TCP: per frame 4 bytes with the identifier and SocketCAN's flags, the DLC, and
# the data; a remote frame has its DLC and no data. On the bus: the guarding request to node 5 (a remote frame with
# DLC 1), its answer, an EMCY of node 6, and a TPDO of node 5.
# Seen: the request comes with DLC 0. Instead of the three other frames come three that nobody sent: a PDO 0x501 with
# five bytes, and 0x100 (TIME) and 0x000 (NMT) without data. A byte of the answer was taken for data of the request.
# One would guess the four frames.
# Why it matters: one remote frame is enough, and a master that guards sends one per node and period. The EMCY is lost,
# and what is counted, recorded or forwarded in its place was never on the bus.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" || exit 2
"$folder/venv/bin/pip" install -q can-cannelloni==0.1.0 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import socket
import sys
import threading

from can_cannelloni import CannelloniBus

BANNER = b"CANNELLONIv1"
REMOTE = 0x40000000
sent = (
    (0x705 | REMOTE, 1, b""),
    (0x705, 1, b"\x85"),
    (0x086, 8, bytes.fromhex("1081110000000000")),
    (0x185, 2, bytes.fromhex("3702")),
)


def serve(server: socket.socket, done: threading.Event) -> None:
    connection, _address = server.accept()
    with connection:
        connection.sendall(BANNER)
        connection.recv(len(BANNER), socket.MSG_WAITALL)
        for can_id, dlc, data in sent:
            connection.sendall(can_id.to_bytes(4, "big") + bytes([dlc]) + data)
        done.wait(10)


done = threading.Event()
with socket.create_server(("127.0.0.1", 0)) as server:
    thread = threading.Thread(target=serve, args=(server, done))
    thread.start()
    bus = CannelloniBus(f"127.0.0.1:{server.getsockname()[1]}", reconnect=False)
    received = []
    while (message := bus.recv(1.0)) is not None:
        received.append((f"{message.arbitration_id:03X}", message.dlc, bytes(message.data).hex()))
    done.set()
    bus.shutdown()
    thread.join()
print(f"can-cannelloni {importlib.metadata.version('can-cannelloni')}: 4 frames sent, received: {received}")
sys.exit(received != [("705", 0, ""), ("501", 5, "0000008608"), ("100", 0, ""), ("000", 0, "")])
PYTHON
