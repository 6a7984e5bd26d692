#!/usr/bin/env bash
# PyCanOpenDevice 1.3 (PyPI) and a value that is written and read again.
#
# Input: a device with an object 0x2000 whose handler keeps what is written and returns it when it is read, on
# python-can's virtual bus. A client writes 500 (0x000001F4) and reads: SDO, expedited, four bytes.
# Seen: the handler gets 500. The answer to the read has the bytes 00 00 01 F4: a client reads 4093706240.
# One would guess F4 01 00 00, as in the request: CiA 301 has one byte order for both directions.
# Why it matters: writing works and reading works with one byte that is repeated, 0 or -1, so that a first test is good.
# A set-up that reads, changes and writes back a value destroys it.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" || exit 2
"$folder/venv/bin/pip" install -q PyCanOpenDevice==1.3 python-can==4.6.1 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import contextlib
import importlib.metadata
import io
import sys

import can
from PyCanOpenDevice.CanOpen_Device import Device, SDO_Structure
from PyCanOpenDevice.CanOpen_Runtime import CanOpen_Runtime

WRITE, READ = 0x23, 0x40
values = []


def handler(command: int, data: int) -> tuple[int, int]:
    if command == WRITE:
        values.append(data)
        return 0x60, 0
    return 0x43, values[-1]


def ask(request: str) -> str:
    client.send(can.Message(arbitration_id=0x605, is_extended_id=False, data=bytes.fromhex(request)))
    runtime.arbitrier.can_open_arbitrier(bus.recv(2))
    while (answer := client.recv(2)).arbitration_id != 0x585:
        pass
    return answer.data.hex()


with can.Bus("wire", interface="virtual") as bus, can.Bus("wire", interface="virtual") as client:
    with contextlib.redirect_stdout(io.StringIO()):  # the package prints each frame
        runtime = CanOpen_Runtime(bus)
        device = Device(5)
        device.add_sdo(SDO_Structure(0x2000, 0, handler))
        runtime.callbacks.add_service(device)
        written = ask("23002000f4010000")
        read = ask("4000200000000000")
value = int.from_bytes(bytes.fromhex(read)[4:], "little")
version = importlib.metadata.version("PyCanOpenDevice")
print(f"PyCanOpenDevice {version}: the handler got {values}, the answer to the read is {read}: {value}")
sys.exit((values, written[:8], read) != ([500], "60002000", "43002000000001f4"))
PYTHON
