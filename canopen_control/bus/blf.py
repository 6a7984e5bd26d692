"""Bounded reader of Vector's BLF recordings, based on python-can's reader.

python-can trusts every length in the file: a header may claim gigabytes, an object may claim to be shorter than its
header (which would be read again for ever), and a container may unpack to a thousand times its size. This reader bounds
what is read and unpacked, and reports errors of the file.
"""

from __future__ import annotations

import os
import struct
import zlib
from typing import TYPE_CHECKING, BinaryIO, Final

import can
from can.io import blf

if TYPE_CHECKING:
    from collections.abc import Iterator


LARGEST_CONTAINER: Final = 64 << 20  # bytes; common writers use 128 KiB
_SIZE_AT: Final = 8  # offset of the object length in its header
_SIZE: Final = struct.Struct("<L")
_SIGNATURE: Final = b"LOBJ"
_PADDING: Final = 8  # maximum padding in bytes before the next object


class BlfReader(can.BLFReader):
    """Reader of the messages in an open BLF file; EOFError if truncated, ValueError if it is not a BLF file."""

    def __init__(self, file: BinaryIO) -> None:
        self._size = os.fstat(file.fileno()).st_size
        super().__init__(_Within(file, self._size))  # type: ignore[arg-type] # as much of a file as is needed

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override] # a generator too
        header = blf.OBJ_HEADER_BASE_STRUCT
        while head := self.file.read(header.size):
            signature, _, _, length, kind = header.unpack(head)
            if signature != _SIGNATURE or length < header.size:
                raise ValueError("an object has no valid signature or length")
            if length - header.size > self._size - self.file.tell():
                self.file.read(self._size)  # all is read: the caller detects the truncation
                raise EOFError
            data = self.file.read(length - header.size)
            self.file.read(length % 4)  # padding
            if kind == blf.LOG_CONTAINER and (content := _unpacked(data)) is not None:
                yield from self._parse_container(content)
        self.stop()

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        _refuse_standstill(self._tail + data)
        yield from super()._parse_container(data)


class _Within:
    """Wrapper of an open file whose `read` never allocates more than the file contains."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.tell, self.close = file.tell, file.close

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes, or b"" for a negative count."""
        return self._file.read(max(0, min(count, self._size - self._file.tell())))


def _unpacked(data: bytes) -> bytes | None:
    """Return the content of a container; None for an unknown compression, ValueError if too large."""
    method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(data)
    packed = data[blf.LOG_CONTAINER_STRUCT.size :]
    if method == blf.NO_COMPRESSION:
        return packed
    if method != blf.ZLIB_DEFLATE:
        return None
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(packed, LARGEST_CONTAINER)
    if unpacker.unconsumed_tail:
        raise ValueError(f"a container unpacks to more than {LARGEST_CONTAINER >> 20} MiB")
    return content


def _refuse_standstill(data: bytes) -> None:
    """Raise ValueError for an object shorter than its header, at which a reader would loop forever."""
    at = 0
    while (at := data.find(_SIGNATURE, at, at + _PADDING)) >= 0 and at + _SIZE_AT + _SIZE.size <= len(data):
        (length,) = _SIZE.unpack_from(data, at + _SIZE_AT)
        if length < blf.OBJ_HEADER_BASE_STRUCT.size:
            raise ValueError("an object is shorter than its header")
        at += length
