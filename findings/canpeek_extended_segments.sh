#!/usr/bin/env bash
# canpeek 0.7.0 (PyPI) and an SDO download of more than four bytes.
# (Its SDO client needs canopen and python-can only; the package is installed without its windows, which need PySide6.)
#
# Input: SdoClient writes four bytes to 0x2000 of node 5, and then eight. The device confirms each request.
# Seen: the four bytes, and the initiation of the eight, go out as 0x605 with 11 bits. The two segments go out as
# 0x00000605 with 29 bits, in the extended format.
# One would guess one identifier for all: the one that CiA 301 gives the SDO server, with 11 bits.
# Why it matters: a device never sees the segments, waits, and aborts with a time-out. Short writes work, so that the
# device is suspected; an identifier of 29 bits looks the same in most lists of frames.
# Exit code 0 while that is so, 1 when it has changed, 2 when the package cannot be installed.
set -u
folder=$(mktemp -d) || exit 2
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv" && "$folder/venv/bin/pip" install -q canopen==2.4.1 python-can==4.6.1 2>/dev/null || exit 2
"$folder/venv/bin/pip" install -q --no-deps canpeek==0.7.0 2>/dev/null || exit 2

"$folder/venv/bin/python" - <<'PYTHON'
import asyncio
import importlib.metadata
import sys
import uuid

import can
from canpeek.co.sdo_client import SdoClient


async def main() -> list[tuple[str, int]]:
    frames: list[tuple[str, int]] = []
    answers: set[asyncio.Task[None]] = set()

    def send(message: can.Message, _connection: uuid.UUID) -> None:
        frames.append((message.data.hex(), 29 if message.is_extended_id else 11))
        if message.data[0] >> 5 == 1:  # initiation
            data = b"\x60" + bytes(message.data[1:4]) + bytes(4)
        else:  # segment: the toggle bit comes back
            data = bytes([0x20 | message.data[0] & 0x10]) + bytes(7)
        answer = can.Message(arbitration_id=0x585, is_extended_id=False, data=data)
        answers.add(asyncio.ensure_future(client.on_frame_rx(answer)))

    client = SdoClient(5, uuid.UUID(int=0), send)
    await client.write(0x2000, 0, bytes(4))
    await client.write(0x2000, 0, bytes(8))
    return frames


frames = asyncio.run(main())
print(f"canpeek {importlib.metadata.version('canpeek')}: requests and bits of their identifiers: {frames}")
sys.exit([bits for _data, bits in frames] != [11, 11, 29, 29])
PYTHON
