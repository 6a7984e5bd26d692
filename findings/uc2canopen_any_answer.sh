#!/usr/bin/env bash
# uc2canopen 0.2.3 (PyPI) and an SDO answer that belongs to another request.
#
# Input: python-can's virtual bus. The client writes 0x2000:01 of node 10, which is switched off; at that moment node 11
# confirms a write of 0x6060:00 that another client sent. Two clients on one bus are usual: a master and a laptop.
# Seen: write() returns True.
# One would guess a time-out: CiA 301 has the answer carry the COB-ID of the server and the multiplexer of the request.
# Why it matters: a write that reached nobody counts as done. With read() the value of another object of another node
# is returned.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q uc2canopen==0.2.3 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import importlib.metadata
import sys
import threading

import can
from uc2canopen.sdo import SdoClient, SdoError

with can.Bus("wire", interface="virtual") as bus, can.Bus("wire", interface="virtual") as others:
    client = SdoClient(bus, timeout_s=2.0)
    notifier = can.Notifier(bus, [client], timeout=0.1)

    def node_11() -> None:
        others.recv(5)  # the request to node 10 is on the wire
        others.send(can.Message(arbitration_id=0x58B, is_extended_id=False, data=bytes.fromhex("6060600000000000")))

    thread = threading.Thread(target=node_11)
    thread.start()
    try:
        result = str(client.write(10, 0x2000, 1, bytes(4)))
    except SdoError as error:
        result = str(error)
    thread.join()
    notifier.stop()
print(f"uc2canopen {importlib.metadata.version('uc2canopen')}: write to node 10, confirmed by node 11: {result}")
sys.exit(result != "True")
PYTHON
