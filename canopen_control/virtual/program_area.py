"""Program area and boot-loader of a virtual device: program download of CiA 302-3 (0x1F50, 51, 52, 56, 57).

A device whose EDS has 0x1F51 can be given a new program. The law:

- 0x1F51 is written in PRE-OPERATIONAL alone: 0 stop, 1 start, 3 clear; what the state does not allow is 0x08000022.
- Data are taken after a clear, and each download needs a fresh one, or is refused with its first frame. A program ends
  in the CRC-32 of what is before it (little-endian); one whose sum is wrong, or that is not whole, never runs.
- While the program does not run, the boot-loader does: another 0x1000 and product code, no object but its own, no PDO.
  It takes over, and hands over, with a reset after the answer has left; at power-on a whole program starts by itself.
- 0x1F57 bit 0 is set while the flash is busy; then bits 1 to 7 say what went wrong. 0x1F56 is that CRC-32, 0 for none.
- 0x1F52 is the date of the program, where it has one: before the CRC "1F52", days since 1984, ms after midnight.
"""

from __future__ import annotations

import enum
import struct
import zlib
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtState
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.virtual.injection_point import InjectionPoint

if TYPE_CHECKING:
    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.od.model import Entry, ObjectDictionary, Value
    from canopen_control.virtual.node_outbox import NodeClock
    from canopen_control.virtual.object_store import VirtualStore


DATA, CONTROL, SOFTWARE_DATE, IDENTIFICATION, FLASH = 0x1F50, 0x1F51, 0x1F52, 0x1F56, 0x1F57
_LOADER_OBJECTS: Final = frozenset(
    (0x1000, 0x1001, 0x1008, 0x1017, 0x1018, DATA, CONTROL, SOFTWARE_DATE, IDENTIFICATION, FLASH)
)
_LOADER_PRODUCT: Final = 0xB007_0000
_CRC_BYTES: Final = 4
_DATE: Final = struct.Struct("<4sII")  # its mark, 0x1F52:01 and :02
_DATE_MARK: Final = b"1F52"
_RESET_NS: Final = 10_000_000  # after the answer to stop and start
_FLASH_BYTES: Final = 1 << 30
ERASE_NS, WRITE_NS = 400_000_000, 100_000_000


class ProgramState(enum.IntEnum):
    """Values of 0x1F51."""

    STOPPED = 0
    RUNNING = 1
    CLEARED = 3


class FlashError(enum.IntEnum):
    """Bits 1 to 7 of 0x1F57."""

    NONE = 0
    NO_PROGRAM = 1
    CRC = 3
    NOT_CLEARED = 4
    WRITE = 5


def whole_program(content: bytes, *, days: int = 0, milliseconds: int = 0) -> bytes:
    """Return a valid program for the device: the content, an optional date for 0x1F52, and the CRC-32."""
    program = content + _DATE.pack(_DATE_MARK, days, milliseconds) if days else content
    return program + zlib.crc32(program).to_bytes(_CRC_BYTES, "little")


FACTORY_PROGRAM: Final = whole_program(b"canopen_control factory program")


class ProgramArea:
    """Program of a node at the first subindex of 0x1F51; `image` is the content of the flash.

    `write_ns` is how long the flash is busy when it has been written. Seams: `erase_ns`, how long it takes to clear it;
    `fails_at`, bytes after which the flash fails; `damages`, whether what is written is changed on
    its way. `reset_at` is when the node has to reset itself.
    """

    def __init__(self, od: ObjectDictionary, store: VirtualStore, nmt: NmtSlave, clock: NodeClock) -> None:
        self.image, self.state, self.error = FACTORY_PROGRAM, ProgramState.RUNNING, FlashError.NONE
        self.write_ns = WRITE_NS
        self.erase_ns: InjectionPoint[int] = InjectionPoint(ERASE_NS)
        self.fails_at: InjectionPoint[int] = InjectionPoint(_FLASH_BYTES)
        self.damages: InjectionPoint[bool] = InjectionPoint(False)
        self.reset_at: int | None = None
        self._od, self._store, self._nmt, self._clock = od, store, nmt, clock
        self._busy_until = 0
        self._next: ProgramState | None = None  # what the reset is for
        self.number = od.subindices(CONTROL)[-1] if len(od.subindices(CONTROL)) < 2 else od.subindices(CONTROL)[1]
        store.guard([CONTROL], self._control)
        store.guard([DATA], self._take)
        store.gate(DATA, self._admit)
        store.on_read(CONTROL, self.number, lambda: int(self.state))
        store.on_read(IDENTIFICATION, self.number, lambda: self.identification)
        store.on_read(FLASH, self.number, lambda: 1 if self._busy else self.error << 1)
        for subindex in od.subindices(SOFTWARE_DATE)[1:3]:
            store.on_read(SOFTWARE_DATE, subindex, partial(self._part_of_date, subindex - 1))
        store.on_read(0x1000, 0, lambda: store.values[0x1000, 0] if self.runs else 0)
        store.on_read(0x1018, 2, lambda: store.values[0x1018, 2] if self.runs else _LOADER_PRODUCT)

    @property
    def runs(self) -> bool:
        """Whether the program runs instead of the boot-loader."""
        return self.state is ProgramState.RUNNING

    @property
    def is_whole(self) -> bool:
        """Whether the flash contains a program with a valid checksum."""
        content, crc = self.image[:-_CRC_BYTES], self.image[-_CRC_BYTES:]
        return len(self.image) > _CRC_BYTES and zlib.crc32(content).to_bytes(_CRC_BYTES, "little") == crc

    @property
    def identification(self) -> int:
        """CRC-32 at the end of the program, 0 without a complete one."""
        return int.from_bytes(self.image[-_CRC_BYTES:], "little") if self.is_whole else 0

    @property
    def date(self) -> tuple[int, int]:
        """Days since 1984-01-01 and milliseconds after midnight; zeros without a date."""
        end = len(self.image) - _CRC_BYTES
        if not self.is_whole or end < _DATE.size:
            return 0, 0
        mark, days, milliseconds = _DATE.unpack_from(self.image, end - _DATE.size)
        return (days, milliseconds) if mark == _DATE_MARK else (0, 0)

    def _part_of_date(self, part: int) -> int:
        return self.date[part]

    def lose(self) -> None:
        """Erase the program; the boot-loader runs from the next reset on."""
        self.image, self.error = b"", FlashError.NO_PROGRAM

    def mend(self) -> None:
        """Restore the manufacturer's program unless one is complete; it runs from the next reset on."""
        if not self.is_whole:
            self.image, self.error = FACTORY_PROGRAM, FlashError.NONE

    def next_deadline(self) -> int | None:
        """Return the time at which the node must reset itself."""
        return self.reset_at

    def reset(self) -> None:
        """Process a reset: a complete program runs, unless the reset must stop it."""
        requested, self._next, self.reset_at, self._busy_until = self._next, None, None, 0
        stopped = requested is ProgramState.STOPPED
        self.state = ProgramState.RUNNING if self.is_whole and not stopped else ProgramState.STOPPED
        if not self.is_whole and self.error is FlashError.NONE:
            self.error = FlashError.NO_PROGRAM
        self._store.rebase(self._od if self.runs else _loader_od(self._od))

    @property
    def _busy(self) -> bool:
        return self._clock.now < self._busy_until

    def _control(self, entry: Entry, value: Value) -> Value:
        if entry.subindex != self.number:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        self._require(not self._busy and self._nmt.state is NmtState.PRE_OPERATIONAL)
        action = {0: self._stop, 1: self._start, 3: self._clear}.get(int(value))
        if action is None:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        action()
        return value

    def _stop(self) -> None:
        if self.runs:
            self._reset_for(ProgramState.STOPPED)
        else:
            self.state = ProgramState.STOPPED

    def _start(self) -> None:
        self._require(self.is_whole)
        if not self.runs:
            self._reset_for(ProgramState.RUNNING)

    def _clear(self) -> None:
        self._require(self.state is ProgramState.STOPPED)
        self.image, self.state, self.error = b"", ProgramState.CLEARED, FlashError.NONE
        self._busy_until = self._clock.now + self.erase_ns.value

    def _take(self, entry: Entry, value: Value) -> Value:
        """Write the flash; a failed write leaves partial data, and 0x1F57 shows the error."""
        if entry.subindex != self.number:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        self._admit()
        data = value if isinstance(value, bytes) else b""
        if self.damages.value and data:
            data = bytes((data[0] ^ 1,)) + data[1:]
        self.state = ProgramState.STOPPED
        self.image = data[: self.fails_at.value]
        if len(self.image) < len(data):
            self.error = FlashError.WRITE
            raise SdoServerAbort(AbortCode.HARDWARE_ERROR)
        self.error = FlashError.NONE if self.is_whole else FlashError.CRC
        self._busy_until = self._clock.now + self.write_ns
        return b""  # it cannot be read, and is in the flash

    def _admit(self) -> None:
        """Refuse data before the transfer if the flash was not cleared."""
        if self.state is not ProgramState.CLEARED:
            self.error = FlashError.NOT_CLEARED
        self._require(self.state is ProgramState.CLEARED and not self._busy)

    def _reset_for(self, state: ProgramState) -> None:
        self._next, self.reset_at = state, self._clock.now + _RESET_NS

    def _require(self, allowed: bool) -> None:
        if not allowed:
            raise SdoServerAbort(AbortCode.DEVICE_STATE)


def _loader_od(od: ObjectDictionary) -> ObjectDictionary:
    """Return the boot-loader's part of a dictionary."""
    entries = {address: entry for address, entry in od.entries.items() if address[0] in _LOADER_OBJECTS}
    return replace(od, entries=entries)
