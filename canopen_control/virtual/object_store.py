"""Values of a node's object dictionary, and rules for reading and writing them (CiA 301, 7.2.4 and 7.4).

The dictionary gives the objects, their access, the length of a value and its limits; every violation is an abort code
and changes nothing. The device adds hooks to its objects:

- a source returns the value when an object is read (a statusword, a position);
- a guard checks a value before it is accepted, and may refuse it with an abort code or replace it;
- a watcher is called with an accepted value.

Guards and watchers belong to an index. The device itself reads and writes with `get` and `set`, without checks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.od.codec import above_limit, below_limit, decode, default_of, encode
from canopen_control.od.model import DataType, Entry, ObjectDictionary, Value
from canopen_control.virtual.injection_point import InjectionPoint

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.od.model import Address

    Source = Callable[[], Value]
    Guard = Callable[[Entry, Value], Value]
    Watcher = Callable[[Entry, Value], None]
    DownloadGate = Callable[[], None]
    from canopen_control.cia402.motors import MotorMap
    from canopen_control.od.model import Entry


_OPEN_ENDED = frozenset((DataType.VISIBLE_STRING, DataType.OCTET_STRING, DataType.UNICODE_STRING, DataType.DOMAIN))


def check_limits(entry: Entry, value: Value) -> None:
    """Raise SdoServerAbort if a value is outside the limits of the entry."""
    if isinstance(value, str | bytes):
        return
    if entry.high is not None and above_limit(entry, value):
        raise SdoServerAbort(AbortCode.VALUE_TOO_HIGH)
    if entry.low is not None and below_limit(entry, value):
        raise SdoServerAbort(AbortCode.VALUE_TOO_LOW)


def refuse(code: int | None) -> None:
    """Raise SdoServerAbort with `code`; no effect if `code` is None."""
    if code is not None:
        raise SdoServerAbort(code)


class VirtualStore:
    """Typed values of all entries of `od`, with `upload` and `download` for an SDO server.

    `power_on` are the values after a reset that differ from the file's defaults: identity, and values stored by 0x1010.
    The injection point `ceilings` silently limits accepted values, by index. `version` increases when a value or a
    rule changes.
    """

    def __init__(self, od: ObjectDictionary) -> None:
        self.od = od
        self._initial: dict[Address, Value] = {entry.address: default_of(entry) for entry in od}
        self.values: dict[Address, Value] = self._initial.copy()
        self.power_on: dict[Address, Value] = {}
        self.ceilings: InjectionPoint[dict[int, int]] = InjectionPoint({})
        self.beyond_limits: set[tuple[int, Value]] = set()  # values that a quirk accepts beyond the limits of the EDS
        self.version = 0
        self._presets: dict[Address, Value] = {}
        self._indices = frozenset(entry.index for entry in od)
        self._sources: dict[Address, Source] = {}
        self._guards: dict[int, Guard] = {}
        self._gates: dict[int, DownloadGate] = {}
        self._stateful: set[int] = set()  # indices whose guards depend on more than the values
        self._watchers: dict[int, list[Watcher]] = {}

    # -- the device's side

    def has(self, index: int, subindex: int = 0) -> bool:
        return (index, subindex) in self.values

    def get(self, index: int, subindex: int = 0) -> Value:
        """Return the current value of an entry; raise KeyError if the dictionary lacks the entry."""
        source = self._sources.get((index, subindex))
        return self.values[index, subindex] if source is None else source()

    def number(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Return the stored integer of an entry (not from a source); `default` if missing or not an integer."""
        value = self.values.get((index, subindex), default)
        return value if isinstance(value, int) else default

    def set(self, index: int, subindex: int, value: Value) -> None:
        """Set a value without checks; no effect if the dictionary lacks the entry."""
        if (index, subindex) in self.values:
            self.values[index, subindex] = value
            self.version += 1

    def preset(self, index: int, subindex: int, value: Value) -> None:
        """Set a value now and after every reset; no effect if the dictionary lacks the entry."""
        if (index, subindex) in self.values:
            self.values[index, subindex] = self.power_on[index, subindex] = value
            self._presets[index, subindex] = value
            self.version += 1

    def defaults(self, first: int = 0, last: int = 0xFFFF) -> None:
        """Restore the power-on values of indices `first` to `last`."""
        self.version += 1
        values, power_on = self.values, self.power_on
        for address, value in self._initial.items():
            if first <= address[0] <= last:
                values[address] = power_on.get(address, value)

    def rebase(self, od: ObjectDictionary) -> None:
        """Replace the dictionary; its defaults apply from the next reset on."""
        self.od = od
        self._initial = {entry.address: default_of(entry) for entry in od}

    def saved(self) -> dict[Address, Value]:
        """Return the power-on values stored by 0x1010, without presets and EDS defaults."""
        nothing = object()
        return {
            address: value
            for address, value in self.power_on.items()
            if self._presets.get(address, nothing) != value and address in self.values
        }

    def keep(self, addresses: Iterable[Address]) -> None:
        """Store the current values of `addresses` as power-on values (0x1010)."""
        self.power_on.update({address: self.values[address] for address in addresses})

    def forget(self, addresses: Iterable[Address]) -> None:
        """Discard the stored values of `addresses` (0x1011), so that presets or defaults apply after a reset."""
        for address in addresses:
            self.power_on.pop(address, None)
            if address in self._presets:
                self.power_on[address] = self._presets[address]

    # -- hooks

    def on_read(self, index: int, subindex: int, source: Source) -> None:
        """Get the value of an entry from `source` when it is read; no effect if the dictionary lacks the entry."""
        if (index, subindex) in self.values:
            self._sources[index, subindex] = source

    def guard(self, indices: Iterable[int], guard: Guard, *, by_values: bool = False) -> None:
        """Check writes to `indices` with `guard`, which returns the accepted value or raises SdoServerAbort.

        With `by_values` the decision of the guard depends only on the values of this store.
        """
        added = dict.fromkeys(indices, guard)
        self._guards.update(added)
        self._stateful.difference_update(added)
        if not by_values:
            self._stateful.update(added)
        self.version += 1

    def guard_of(self, index: int) -> tuple[Guard | None, bool]:
        """Return the guard of an index (None: no guard), and whether it depends only on the values of the store."""
        return self._guards.get(index), index not in self._stateful

    def set_guard(self, index: int, guard: Guard | None, *, by_values: bool = False) -> None:
        """Set the guard of an index; None removes the guard."""
        if guard is not None:
            self.guard([index], guard, by_values=by_values)
            return
        self._guards.pop(index, None)
        self._stateful.discard(index)
        self.version += 1

    def gate(self, index: int, check: DownloadGate) -> None:
        """Call `check`, which may raise SdoServerAbort, when a download to an index is initiated."""
        self._gates[index] = check

    def on_write(self, indices: Iterable[int], watcher: Watcher) -> None:
        """Call `watcher` after every accepted write to `indices`."""
        for index in indices:
            self._watchers.setdefault(index, []).append(watcher)

    def set_source(self, index: int, subindex: int, source: Source | None) -> None:
        """Set the source of an entry's value; None restores the stored value."""
        if source is None:
            self._sources.pop((index, subindex), None)
        else:
            self.on_read(index, subindex, source)

    def unwatch(self, index: int, watcher: Watcher) -> None:
        self._watchers[index].remove(watcher)

    def unset_preset(self, index: int, subindex: int, preset: Value | None, power_on: Value | None) -> None:
        """Restore an earlier preset and power-on value; None means the default of the EDS."""
        for values, value in ((self._presets, preset), (self.power_on, power_on)):
            if value is None:
                values.pop((index, subindex), None)
            else:
                values[index, subindex] = value

    def preset_of(self, index: int, subindex: int) -> tuple[Value | None, Value | None]:
        """Return the preset and the power-on value of an entry; None for either means the default of the EDS."""
        return self._presets.get((index, subindex)), self.power_on.get((index, subindex))

    def source_of(self, index: int, subindex: int) -> Source | None:
        """Return the source of an entry's value, or None if the value is stored."""
        return self._sources.get((index, subindex))

    def guarded_by_values(self, index: int) -> bool:
        """Whether a value accepted at `index` is accepted again while `version` is unchanged."""
        return index not in self._stateful and not self.ceilings.value

    # -- the bus's side

    def upload(self, index: int, subindex: int) -> bytes:
        """Return the encoded value of an entry; raise SdoServerAbort if missing or not readable."""
        entry = self._entry(index, subindex)
        if not entry.readable:
            raise SdoServerAbort(AbortCode.WRITE_ONLY)
        try:
            return encode(self.get(index, subindex), entry.data_type)
        except ValueError:
            raise SdoServerAbort(AbortCode.GENERAL_ERROR) from None

    def size_of(self, index: int, subindex: int) -> int | None:
        """Return the required length of a download in bytes, or None if variable.

        Raise SdoServerAbort if the entry is missing or not writable, or if its gate refuses the download, because the
        initiation is refused then (CiA 301, 7.2.4.3.3).
        """
        entry = self._entry(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        if (gate := self._gates.get(index)) is not None:
            gate()
        bits = entry.data_type.bits
        return None if bits is None else (bits + 7) // 8

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write the encoded value of an entry; raise SdoServerAbort, with no change, if a rule forbids the write."""
        entry = self._entry(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        self.write(entry, _decoded(entry, data))

    def write(self, entry: Entry, value: Value) -> None:
        """Write a value and call the watchers; raise SdoServerAbort if a limit or guard refuses the value."""
        self.notify(entry, self.place(entry, value))

    def place(self, entry: Entry, value: Value) -> Value:
        """Write a value like `write`, but without calling the watchers; return the accepted value."""
        try:
            check_limits(entry, value)
        except SdoServerAbort:
            if (entry.index, value) not in self.beyond_limits:
                raise
        guard = self._guards.get(entry.index)
        if guard is not None:
            value = guard(entry, value)
        ceilings = self.ceilings.value
        if ceilings and isinstance(value, int):
            value = min(value, ceilings.get(entry.index, value))
        values, address = self.values, entry.address
        if values[address] != value:
            self.version += 1
        values[address] = value
        return value

    def notify(self, entry: Entry, value: Value) -> None:
        """Call the watchers of an entry with an accepted value."""
        for watcher in self._watchers.get(entry.index, ()):
            watcher(entry, value)

    def _entry(self, index: int, subindex: int) -> Entry:
        entry = self.od.get(index, subindex)
        if entry is None:
            raise SdoServerAbort(AbortCode.NO_SUBINDEX if index in self._indices else AbortCode.NO_OBJECT)
        return entry


def _decoded(entry: Entry, data: bytes) -> Value:
    bits = entry.data_type.bits
    if entry.data_type not in _OPEN_ENDED and bits is not None:
        size = (bits + 7) // 8
        if len(data) != size:
            raise SdoServerAbort(AbortCode.LENGTH_TOO_HIGH if len(data) > size else AbortCode.LENGTH_TOO_LOW)
    try:
        return decode(data, entry.data_type)
    except ValueError:
        raise SdoServerAbort(AbortCode.INVALID_VALUE) from None


# SDO view of a device with several motors in one object set. The store has the objects of several axes as defined by
# CiA 402 (`cia402.motors`); SDO uses the objects of the device.


class DeviceStore:
    """SDO view of a device whose motors share one object set; `store` has the values by axis."""

    def __init__(self, store: VirtualStore, motors: MotorMap) -> None:
        self._store, self._motors = store, motors

    def upload(self, index: int, subindex: int) -> bytes:
        entry = self._entry(index, subindex)
        if entry is None:
            return self._store.upload(index, subindex)
        parts = self._motors.parts(index, subindex)
        if not parts:
            return encode(default_of(entry), entry.data_type)  # the number of subindices
        size = (entry.data_type.bits or 0) // 8 // len(parts)
        return b"".join(self._store.upload(*address)[:size] for address in parts)

    def size_of(self, index: int, subindex: int) -> int | None:
        entry = self._entry(index, subindex)
        if entry is None:
            return self._store.size_of(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        return (entry.data_type.bits or 0) // 8

    def download(self, index: int, subindex: int, data: bytes) -> None:
        """Write an object to all axes that it belongs to; raise SdoServerAbort if refused."""
        entry = self._entry(index, subindex)
        if entry is None:
            for address in ((index, subindex), *self._motors.shared.get((index, subindex), ())):
                self._store.download(*address, data)
            return
        parts = self._motors.parts(index, subindex)
        if not entry.writable:
            raise SdoServerAbort(AbortCode.READ_ONLY)
        if len(data) != self.size_of(index, subindex):
            long = len(data) > (self.size_of(index, subindex) or 0)
            raise SdoServerAbort(AbortCode.LENGTH_TOO_HIGH if long else AbortCode.LENGTH_TOO_LOW)
        size = len(data) // len(parts)
        for number, address in enumerate(parts):
            kind = self._store.od[address].data_type
            value = int.from_bytes(data[number * size : (number + 1) * size], "little", signed=kind.signed)
            self._store.download(*address, encode(value, kind))

    def _entry(self, index: int, subindex: int) -> Entry | None:
        """Return the device's entry if the object has another address in the store, else None."""
        entry = self._motors.device.get(index, subindex)
        if entry is None and (index, subindex) in self._motors.places:  # an address that exists only in the store
            present = index in self._motors.device.objects
            raise SdoServerAbort(AbortCode.NO_SUBINDEX if present else AbortCode.NO_OBJECT)
        elsewhere = bool(self._motors.parts(index, subindex)) or (index, subindex) in self._motors.places
        return entry if elsewhere else None
