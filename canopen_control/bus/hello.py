"""How an opener and the hub of a ``local:`` bus greet each other: 64 bytes each way, then only records.

The opener says who it is; the hub answers with its own process and the label it gave, made unique. A version that
differs is refused with a sentence instead of garbage later.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

__all__ = ["HELLO_SIZE", "LABEL_SIZE", "MAGIC", "VERSION", "Hello", "pack_hello", "parse_hello"]

MAGIC = b"CANlocal"
VERSION = 1
LABEL_SIZE = 48
_HELLO = struct.Struct("<8sHHI48s")  # magic, version, reserved, pid, label
HELLO_SIZE = _HELLO.size


class Hello(NamedTuple):
    """Who is at the other end."""

    version: int
    pid: int
    label: str


def pack_hello(pid: int, label: str, version: int = VERSION) -> bytes:
    """Make a greeting; a label longer than 48 bytes of UTF-8 is cut."""
    return _HELLO.pack(MAGIC, version, 0, pid, _cut(label))


def _cut(label: str) -> bytes:
    return label.encode()[:LABEL_SIZE].decode(errors="ignore").encode()


def parse_hello(data: bytes) -> Hello | None:
    """Take a greeting of `HELLO_SIZE` bytes apart; None if it is none."""
    if len(data) != HELLO_SIZE:
        return None
    magic, version, _reserved, pid, label = _HELLO.unpack(data)
    if magic != MAGIC:
        return None
    return Hello(version, pid, label.rstrip(b"\0").decode(errors="replace"))
