"""Reading Vector's BLF recordings within bounds: python-can's reader, which believes every length that a file claims.

A header may claim gigabytes, an object may claim to be shorter than its own header (and would be
read again for ever), and a container may unpack to a thousand times its size. What is read is what is there, and what
is unpacked is bounded; anything else is said as what is wrong with the file.
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


LARGEST_CONTAINER: Final = 64 << 20  # bytes; who writes makes them of 128 KiB
_SIZE_AT: Final = 8  # of an object's length in its header
_SIZE: Final = struct.Struct("<L")
_SIGNATURE: Final = b"LOBJ"
_PADDING: Final = 8  # bytes in which the next object must begin


class BlfReader(can.BLFReader):
    """Yields the messages of an open BLF file; EOFError where it ends too early, ValueError where it is none."""

    def __init__(self, file: BinaryIO) -> None:
        self._size = os.fstat(file.fileno()).st_size
        super().__init__(_Within(file, self._size))  # type: ignore[arg-type] # as much of a file as is needed

    def __iter__(self) -> Iterator[can.Message]:  # type: ignore[override] # a generator too
        header = blf.OBJ_HEADER_BASE_STRUCT
        while head := self.file.read(header.size):
            signature, _, _, length, kind = header.unpack(head)
            if signature != _SIGNATURE or length < header.size:
                raise ValueError("an object without its signature or its length is in it")
            if length - header.size > self._size - self.file.tell():
                self.file.read(self._size)  # nothing is left: who asks sees that it was cut
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
    """An open file whose `read` never makes room for more than there is."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file, self._size = file, size
        self.tell, self.close = file.tell, file.close

    def read(self, count: int) -> bytes:
        """Return up to `count` bytes; none of a negative count."""
        return self._file.read(max(0, min(count, self._size - self._file.tell())))


def _unpacked(data: bytes) -> bytes | None:
    """Return what is in a container; None for a compression that nobody knows."""
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
    """Raise ValueError for an object that ends before its header does: a reader would stay there for ever."""
    at = 0
    while (at := data.find(_SIGNATURE, at, at + _PADDING)) >= 0 and at + _SIZE_AT + _SIZE.size <= len(data):
        (length,) = _SIZE.unpack_from(data, at + _SIZE_AT)
        if length < blf.OBJ_HEADER_BASE_STRUCT.size:
            raise ValueError("an object that is shorter than its header is in it")
        at += length
