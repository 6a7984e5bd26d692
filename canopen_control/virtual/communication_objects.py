"""Communication objects 0x1000 to 0x1FFF of a node, except PDOs, and the CiA 301 services that they configure.

Guards refuse values with the abort codes of the standard; `apply` configures all services from the store, after a reset
and after a write.
"""

from __future__ import annotations

import enum
import struct
import zlib
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.bus.port import BusEventKind
from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import ErrorRegister
from canopen_control.cia301.guarding import GuardingEvent, GuardingEventKind
from canopen_control.cia301.heartbeat import HeartbeatEvent, HeartbeatEventKind, parse_consumer_entry
from canopen_control.cia301.nmt import NmtState, check_reaction, reaction
from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia301.sync import check_cob_id_sync, check_overflow, parse_cob_id_sync
from canopen_control.frame import EXTENDED_BIT, MAX_NODE_ID, is_restricted
from canopen_control.od.indices import FLASH_STATUS, PROGRAM_CONTROL, PROGRAM_DATA, PROGRAM_ID, SOFTWARE_DATE
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.node_outbox import HEARTBEAT_ERROR, HeartbeatMissed
from canopen_control.virtual.object_store import refuse

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from canopen_control.cia301.emcy import EmcyProducer
    from canopen_control.cia301.guarding import GuardingSlave
    from canopen_control.cia301.heartbeat import HeartbeatConsumer, HeartbeatProducer
    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.cia301.sync import SyncConsumer
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore


# Program area and boot-loader of a virtual device: program download of CiA 302-3 (0x1F50, 51, 52, 56, 57).
# A device whose EDS has 0x1F51 can be given a new program:
#
# - 0x1F51 is writable in PRE-OPERATIONAL only: 0 stop, 1 start, 3 clear; a command that the state does not allow is
#   aborted with 0x08000022.
# - A download requires a fresh clear, otherwise its first frame is refused. A program ends with the CRC-32 of the
#   preceding bytes (little-endian); an incomplete program, or one with a wrong sum, never runs.
# - While no program runs, the boot-loader runs: with another 0x1000 and product code, few objects, and no PDO. Every
#   change between program and boot-loader is a reset after the answer was sent; at power-on a complete program starts
#   by itself.
# - 0x1F57 bit 0 is set while the flash is busy; then bits 1 to 7 are the result. 0x1F56 is that CRC-32, 0 for none.
# - 0x1F52 is the date of a program that has "1F52", days since 1984 and ms after midnight before its CRC.


_LOADER_OBJECTS: Final = frozenset(
    (
        0x1000,
        0x1001,
        0x1008,
        0x1017,
        0x1018,
        PROGRAM_DATA,
        PROGRAM_CONTROL,
        SOFTWARE_DATE,
        PROGRAM_ID,
        FLASH_STATUS,
    )
)
_LOADER_PRODUCT: Final = 0xB007_0000
_CRC_BYTES: Final = 4
_DATE: Final = struct.Struct("<4sII")  # its mark, 0x1F52:01 and :02
_DATE_MARK: Final = b"1F52"
_RESET_NS: Final = 10_000_000  # after the answer to stop and start
_FLASH_BYTES: Final = 1 << 30
ERASE_NS, WRITE_NS = 400_000_000, 100_000_000


class ProgramState(enum.IntEnum):
    """State of the program, as read from 0x1F51."""

    STOPPED = 0
    RUNNING = 1
    CLEARED = 3


class FlashError(enum.IntEnum):
    """Error in the flash status, bits 1 to 7 of 0x1F57."""

    NONE = 0
    NO_PROGRAM = 1
    CRC = 3
    NOT_CLEARED = 4
    WRITE = 5


def whole_program(content: bytes, *, days: int = 0, milliseconds: int = 0) -> bytes:
    """Return a valid program: the content, an optional date for 0x1F52, and the CRC-32."""
    program = content + _DATE.pack(_DATE_MARK, days, milliseconds) if days else content
    return program + zlib.crc32(program).to_bytes(_CRC_BYTES, "little")


FACTORY_PROGRAM: Final = whole_program(b"canopen_control factory program")


class ProgramArea:
    """Program of a node at the first subindex of 0x1F51; `image` is the content of the flash.

    The flash is busy for `write_ns` after a write. Injection points: `erase_ns` (time to clear the flash), `fails_at`
    (bytes after which a write fails) and `damages` (written data is corrupted). `reset_at` is the time in ns at which
    the node must reset itself, None if it need not.
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
        self._next: ProgramState | None = None  # state after the pending reset
        self.number = (
            od.subindices(PROGRAM_CONTROL)[-1]
            if len(od.subindices(PROGRAM_CONTROL)) < 2
            else od.subindices(PROGRAM_CONTROL)[1]
        )
        store.guard([PROGRAM_CONTROL], self._control)
        store.guard([PROGRAM_DATA], self._take)
        store.gate(PROGRAM_DATA, self._admit)
        store.on_read(PROGRAM_CONTROL, self.number, lambda: int(self.state))
        store.on_read(PROGRAM_ID, self.number, lambda: self.identification)
        store.on_read(FLASH_STATUS, self.number, lambda: 1 if self._busy else self.error << 1)
        for subindex in od.subindices(SOFTWARE_DATE)[1:3]:
            store.on_read(SOFTWARE_DATE, subindex, partial(self._part_of_date, subindex - 1))
        store.on_read(0x1000, 0, lambda: store.values[0x1000, 0] if self.runs else 0)
        store.on_read(0x1018, 2, lambda: store.values[0x1018, 2] if self.runs else _LOADER_PRODUCT)

    @property
    def runs(self) -> bool:
        """Whether the application program is running, not the boot-loader."""
        return self.state is ProgramState.RUNNING

    @property
    def is_whole(self) -> bool:
        """Whether the flash contains a program with a valid checksum."""
        content, crc = self.image[:-_CRC_BYTES], self.image[-_CRC_BYTES:]
        return len(self.image) > _CRC_BYTES and zlib.crc32(content).to_bytes(_CRC_BYTES, "little") == crc

    @property
    def identification(self) -> int:
        """CRC-32 at the end of the program, or 0 without a complete program.

        The program from the factory is identified by the value of the dictionary, if it has one.
        """
        if self.image is FACTORY_PROGRAM and (known := self._store.number(PROGRAM_ID, self.number)):
            return known
        return int.from_bytes(self.image[-_CRC_BYTES:], "little") if self.is_whole else 0

    @property
    def date(self) -> tuple[int, int]:
        """Date of the program: days since 1984-01-01 and milliseconds after midnight; zeros without a date."""
        end = len(self.image) - _CRC_BYTES
        if not self.is_whole or end < _DATE.size:
            return 0, 0
        mark, days, milliseconds = _DATE.unpack_from(self.image, end - _DATE.size)
        return (days, milliseconds) if mark == _DATE_MARK else (0, 0)

    def _part_of_date(self, part: int) -> int:
        return self.date[part]

    def erase(self) -> None:
        """Erase the program; the boot-loader runs from the next reset on."""
        self.image, self.error = b"", FlashError.NO_PROGRAM

    def restore_factory(self) -> None:
        """Restore the manufacturer's program for the next reset, unless the flash has a complete program."""
        if not self.is_whole:
            self.image, self.error = FACTORY_PROGRAM, FlashError.NONE

    def next_deadline(self) -> int | None:
        return self.reset_at

    def reset(self) -> None:
        """Start the program after a reset, or the boot-loader if the program is incomplete or was stopped."""
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
        """Write the flash; after a failed write, partial data remains and 0x1F57 shows the error."""
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
        return b""  # the data is in the flash and cannot be read

    def _admit(self) -> None:
        """Refuse a download before its data is transferred, unless the flash is cleared and not busy."""
        if self.state is not ProgramState.CLEARED:
            self.error = FlashError.NOT_CLEARED
        self._require(self.state is ProgramState.CLEARED and not self._busy)

    def _reset_for(self, state: ProgramState) -> None:
        self._next, self.reset_at = state, self._clock.now + _RESET_NS

    def _require(self, allowed: bool) -> None:
        if not allowed:
            raise SdoServerAbort(AbortCode.DEVICE_STATE)


def _loader_od(od: ObjectDictionary) -> ObjectDictionary:
    """Return the dictionary of the boot-loader: the objects of `od` that the boot-loader supports."""
    entries = {address: entry for address, entry in od.entries.items() if address[0] in _LOADER_OBJECTS}
    return replace(od, entries=entries)


# Error control of a node: the heartbeats it monitors (0x1016), life guarding, and its CAN controller.
#
# Every kind of lost communication (0x1016, guarding, bus-off, a channel that is down) has the same reaction: axes react
# according to 0x6007, the node according to 0x1029:01 (CiA 301, 7.5.2.32).


OVERRUN, ERROR_PASSIVE, RECOVERED = 0x8110, 0x8120, 0x8140
_LOST = (BusEventKind.BUS_OFF, BusEventKind.DOWN, BusEventKind.CLOSED)


class PoweredAxis(Protocol):
    """Axis or device function that must react to a loss of communication."""

    def connection_lost(self, now: int) -> None:
        """Stop, or set the outputs to their error values, after a loss of communication."""


class ErrorControl:
    """Monitor of heartbeats, guarding and the CAN controller; stops the axes when communication is lost."""

    def __init__(
        self,
        store: VirtualStore,
        nmt: NmtSlave,
        heartbeats: HeartbeatConsumer,
        outbox: NodeOutbox,
        model: DeviceModel,
        axes: Mapping[int, PoweredAxis],
    ) -> None:
        self._store, self._nmt, self._heartbeats, self._outbox = store, nmt, heartbeats, outbox
        self._model, self._axes = model, axes
        self._off_the_bus = False
        self.function: PoweredAxis | None = None  # axis functions of a device that is not a drive

    def watch(self, periods: Mapping[int, int]) -> None:
        """Monitor the heartbeats of exactly the nodes in `periods`: node-ID to consumer time in ns."""
        present = self._heartbeats.watched()
        for node_id in present.keys() - periods.keys():
            self._heartbeats.unwatch(node_id)
            self._clear_if_all_received()
        for node_id, timeout in periods.items():
            if present.get(node_id) != timeout:
                self._heartbeats.watch(node_id, timeout)

    def follow(self, event: HeartbeatEvent | GuardingEvent, now: int) -> None:
        """Handle an event of the heartbeat consumer or of node guarding."""
        node_id = event.node_id if isinstance(event, HeartbeatEvent) else 0
        if event.kind in (HeartbeatEventKind.MISSED, GuardingEventKind.MISSED):
            self._outbox.publish(HeartbeatMissed(node_id, missed=True))
            self._outbox.emergency(HEARTBEAT_ERROR, ErrorRegister.COMMUNICATION, self._model.communication_data)
            self._stop_axes(now)
            self._leave_operational()
        elif event.kind in (HeartbeatEventKind.RESOLVED, GuardingEventKind.RESOLVED):
            self._outbox.publish(HeartbeatMissed(node_id, missed=False))
            self._clear_if_all_received()

    def bus_event(self, kind: BusEventKind, now: int) -> None:
        """Handle an event of the node's CAN controller."""
        outbox = self._outbox
        if kind in _LOST:
            if not self._off_the_bus:
                self._off_the_bus = kind is BusEventKind.BUS_OFF
                self._leave_operational()
                self._stop_axes(now)
        elif kind is BusEventKind.ERROR_PASSIVE:
            outbox.emergency(ERROR_PASSIVE, ErrorRegister.COMMUNICATION)
        elif kind is BusEventKind.OVERRUN:
            outbox.report(OVERRUN, ErrorRegister.COMMUNICATION)
        else:
            outbox.clear_error(ERROR_PASSIVE)
            if self._off_the_bus:
                self._off_the_bus = False
                self.report_recovery()

    def report_recovery(self) -> None:
        """Send the EMCY for recovery from bus-off (0x8140)."""
        self._outbox.report(RECOVERED, ErrorRegister.COMMUNICATION, self._model.communication_data)

    def _clear_if_all_received(self) -> None:
        """Clear the heartbeat error once the heartbeats of all monitored nodes arrive."""
        if not any(self._heartbeats.is_missed(node_id) for node_id in self._heartbeats.watched()):
            self._outbox.clear_error(HEARTBEAT_ERROR)

    def _leave_operational(self) -> None:
        """Change the NMT state as defined by 0x1029:01 for lost communication."""
        command = reaction(self._store.number(0x1029, 1), self._nmt.state)
        if command is not None:
            self._nmt.command(command)

    def _stop_axes(self, now: int) -> None:
        for axis in self._axes.values():
            axis.connection_lost(now)
        if self.function is not None:
            self.function.connection_lost(now)


_MS = 1_000_000
SAVE, LOAD = 0x65766173, 0x64616F6C
# First and last index that subindex n of 0x1010 and 0x1011 covers (CiA 301, 7.5.2.13); from 4 on manufacturer-specific.
_GROUPS = {1: (0x1000, 0xFFFF), 2: (0x1000, 0x1FFF), 3: (0x6000, 0x9FFF)}
_SERIAL = (0x1018, 4)
_MANUFACTURER = (0x2000, 0x5FFF)
_ANY_STATE = (0x1005, 0x1006, 0x1007, 0x100C, 0x100D, 0x1014, 0x1015, 0x1016, 0x1017, 0x1019)


@dataclass(frozen=True, slots=True)
class Services:
    """CiA 301 services of a node that the communication objects configure."""

    emcy: EmcyProducer
    sync: SyncConsumer
    heartbeat: HeartbeatProducer
    guarding: GuardingSlave
    error_control: ErrorControl


def _is_active(cob_id: int) -> bool:
    """Whether a COB-ID enables its service; False for bit 31 (invalid), 0 and restricted identifiers."""
    return not cob_id & INVALID_BIT and not is_restricted(cob_id & 0x7FF)


class CommunicationObjects:
    """Communication objects in `store`, which configure `services`.

    `applied` is called after every change, because identifiers may be different. `stored` is called when power-on
    values changed, and returns whether they could be saved.
    """

    def __init__(
        self,
        store: VirtualStore,
        services: Services,
        clock: NodeClock,
        *,
        applied: Callable[[], None],
        stored: Callable[[], bool],
    ) -> None:
        self._store, self._services, self._clock = store, services, clock
        self._applied, self._stored = applied, stored
        self._guards = {
            0x1003: self._check_history,
            0x1005: self._check_sync,
            0x1010: self._save,
            0x1011: self._load,
            0x1012: self._check_time,
            0x1014: self._check_emcy,
            0x1016: self._check_consumer,
            0x1019: self._check_overflow,
            0x1029: self._check_behaviour,
        }
        for index, guard in self._guards.items():
            store.guard([index], guard)
        store.on_write(_ANY_STATE, lambda _entry, _value: self.apply())
        store.on_read(0x1001, 0, lambda: services.emcy.error_register)
        for subindex in store.od.subindices(0x1003):
            store.on_read(0x1003, subindex, partial(self._history, subindex))
        for index in (0x1010, 0x1011):
            for subindex in store.od.subindices(index)[1:]:
                store.on_read(index, subindex, lambda: 1)

    def identify(self, serial: int, more: Mapping[Address, int | str]) -> None:
        """Set the identity, the device names and the values `more` where the EDS has no value.

        A serial number that is only a default in the file is ignored: all devices with this file would have the same
        one.
        """
        device, store = self._store.od.device, self._store
        values: dict[Address, Value | None] = {
            (0x1018, 1): device.vendor_number,
            (0x1018, 2): device.product_number,
            (0x1018, 3): device.revision_number,
            (0x1018, 4): serial,
            (0x1008, 0): device.product_name,
            (0x1009, 0): "virtual",
            (0x100A, 0): "canopen_control",
            **more,
        }
        for (index, subindex), value in values.items():
            entry = store.od.get(index, subindex)
            if entry is None or value is None:
                continue
            if (entry.parameter_value if (index, subindex) == _SERIAL else entry.value) is None:
                store.preset(index, subindex, value)

    def apply(self) -> None:
        """Configure the services from the values of the objects."""
        services, number = self._services, self._store.number
        emcy, sync, heartbeat, guarding = services.emcy, services.sync, services.heartbeat, services.guarding
        cob_id = number(0x1014, 0, 0x80 + emcy.node_id)
        emcy.cob_id, emcy.enabled = cob_id & 0x7FF, _is_active(cob_id)
        emcy.inhibit_ns = number(0x1015) * 100_000
        sync.cob_id = parse_cob_id_sync(number(0x1005, 0, 0x80))[0]
        sync.overflow = number(0x1019)
        heartbeat.period_ns = round(number(0x1017) * (_MS - self._clock.drift_ppm.value))
        guarding.enabled = not heartbeat.period_ns
        guarding.guard_time_ns = number(0x100C) * _MS
        guarding.life_time_factor = number(0x100D)
        services.error_control.watch({node_id: ms * _MS for node_id, ms in self._consumers()})
        self._applied()

    def _consumers(self) -> Iterator[tuple[int, int]]:
        for subindex in self._store.od.subindices(0x1016)[1:]:
            node_id, ms = parse_consumer_entry(self._store.number(0x1016, subindex))
            if 1 <= node_id <= MAX_NODE_ID and ms:
                yield node_id, ms

    def _history(self, subindex: int) -> int:
        value = self._services.emcy.read_history(subindex)
        if value is None:  # beyond the number of errors (CiA 301, 7.5.2.4)
            raise SdoServerAbort(AbortCode.NO_DATA)
        return value

    # -- guards

    def _check_history(self, _entry: Entry, value: Value) -> Value:
        # CiA 301, 7.5.2.4: only 0 can be written, which clears the history
        refuse(self._services.emcy.write_history_count(int(value)))
        return value

    def _check_sync(self, entry: Entry, value: Value) -> Value:
        # CiA 301, 7.5.2.5: bits 0 to 29 are fixed while the node produces SYNC
        refuse(check_cob_id_sync(int(value), self._store.number(entry.index), can_produce=False))
        return value

    def _check_overflow(self, _entry: Entry, value: Value) -> Value:
        # CiA 301, 7.5.2.22: 0x1019 is fixed while 0x1006 is not 0
        refuse(check_overflow(int(value), self._store.number(0x1006)))
        return value

    def _check_behaviour(self, _entry: Entry, value: Value) -> Value:
        refuse(check_reaction(int(value)))
        return value

    def _check_emcy(self, entry: Entry, value: Value) -> Value:
        """Refuse a new identifier while EMCY is valid, and restricted identifiers."""
        present, new = self._store.number(entry.index), int(value)
        # CiA 301, 7.5.2.17: bits 0 to 29 are fixed while the object is valid (bit 31 clear)
        moved = (present ^ new) & 0x7FF
        wrong = (moved and _is_active(present)) or is_restricted(new & 0x7FF) or new & EXTENDED_BIT
        if not new & INVALID_BIT and wrong:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_time(self, _entry: Entry, value: Value) -> Value:
        """Refuse restricted identifiers (CiA 301, 7.3.5), and identifiers that the node cannot receive."""
        if is_restricted(int(value) & 0x7FF) or int(value) & EXTENDED_BIT:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_consumer(self, entry: Entry, value: Value) -> Value:
        """Refuse a second entry for a node that another entry monitors (CiA 301, 7.5.2.19)."""
        node_id, ms = parse_consumer_entry(int(value))
        entries = [sub for sub in self._store.od.subindices(0x1016)[1:] if sub != entry.subindex]
        consumers = [parse_consumer_entry(self._store.number(0x1016, sub)) for sub in entries]
        if ms and any(consumer == node_id and time for consumer, time in consumers):
            raise SdoServerAbort(AbortCode.PARAMETER_INCOMPATIBLE)
        return value

    def _save(self, entry: Entry, value: Value) -> Value:
        # CiA 301, 7.5.2.13: a wrong signature stores nothing
        if value != SAVE:
            raise SdoServerAbort(AbortCode.CANNOT_STORE)
        self._keep(partial(self._store.keep, self._group(entry.subindex)))
        return 1

    def _load(self, entry: Entry, value: Value) -> Value:
        """Discard the stored values, so that the defaults apply from the next reset on."""
        # CiA 301, 7.5.2.14: a wrong signature restores nothing
        if value != LOAD:
            raise SdoServerAbort(AbortCode.CANNOT_STORE)
        self._keep(partial(self._store.forget, self._group(entry.subindex)))
        return 1

    def _keep(self, change: Callable[[], None]) -> None:
        """Change the power-on values; if they cannot be saved, restore the old values and abort the write."""
        before = dict(self._store.power_on)
        change()
        if not self._stored():
            self._store.power_on = before
            raise SdoServerAbort(AbortCode.HARDWARE_ERROR)

    def _group(self, subindex: int) -> list[Address]:
        first, last = _GROUPS.get(subindex, _MANUFACTURER)
        # Objects with a source, and the store and restore requests themselves, are not parameters.
        return [
            entry.address
            for entry in self._store.od
            if first <= entry.index <= last
            and entry.writable
            and entry.index not in (0x1003, 0x1010, 0x1011, 0x6040)
            and self._store.source_of(*entry.address) is None
        ]
