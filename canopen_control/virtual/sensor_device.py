"""Virtual sensors: values from outside, in units, shown in the objects of their profile (CiA 404, 418 and 419).

What a value is in raw numbers follows the device's own objects (digits, resolution, steps per turn) at once when they
are written. A measured value (404) that its object cannot hold is an overload: bits 1 and 2 of its status (0x6150);
`status0` sets the others, as 1 for a broken wire. A battery (418) that is given a `battery_current` (A, negative when
it is discharged) counts its charge by its capacity (0x6020:02), and its voltage sags. Encoders and inclinometers are
made of the same. A charger (419) that misses its master forgets the current that was requested of it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, nearest
from canopen_control.rpc.messages.drive import SignalState
from canopen_control.virtual.input_faults import InputFaults
from canopen_control.virtual.io_device import take_error_values

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.profiles.device_signal import Signal
    from canopen_control.virtual.node_outbox import Clock, NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["Battery", "Charger", "MeasuringDevice", "SensorDevice"]

_NS: Final = 1e9


class SensorDevice:
    """The signals of one sensor; see `DeviceFunction`. `moving` are further inputs that change others by time."""

    moving: Mapping[str, str] = {}  # name to unit
    begins_with: Mapping[str, float] = {}
    same_values: Mapping[int, tuple[int, ...]] = {}  # object to those that show the same in another format
    step_ns = 10_000_000  # between two looks at what changes by time

    def __init__(self, store: ObjectStore, outbox: NodeOutbox, clock: Clock, signals: Iterable[Signal]) -> None:
        self.store, self._outbox, self.clock = store, outbox, clock
        self.signals = {signal.name: signal for signal in signals}
        self._inputs = {name: signal for name, signal in self.signals.items() if not signal.output}
        self.outside = {
            name: each.value(self.number(each.address), self.gain(each)) for name, each in self._inputs.items()
        }
        self.outside.update(dict.fromkeys(self.moving, 0.0))
        self.outside.update({name: each for name, each in self.begins_with.items() if name in self._inputs})
        self.faults, self.overloaded = InputFaults(), False
        self._statuses = {signal.status for signal in self.signals.values()}
        self._moved_at: int | None = None
        scaled_by = {address[0] for signal in self.signals.values() for address in signal.needs}
        store.on_write(scaled_by, self._scale_written)

    # -- from outside

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """See `DeviceFunction`."""
        known = [*self._inputs, *self.moving]
        for name in values:
            if name in self.signals and name not in self._inputs:
                raise ConfigError(f"{name} is an output: what it is the master says")
            if name not in known:
                raise ConfigError(f"no signal {name!r}{nearest(name, known)}")
        self._move(now)
        self.outside.update(values)
        self.show_all(now)

    def describe(self) -> tuple[SignalState, ...]:
        """See `DeviceFunction`."""
        found = [SignalState(name, self.outside[name], unit=unit) for name, unit in self.moving.items()]
        for name, signal in self.signals.items():
            if signal.output:
                value = signal.value(self.number(signal.address), self.gain(signal))
                found.append(SignalState(name, 0.0 if self.overloaded else value, output=True))
            else:
                found.append(SignalState(name, self.outside[name], unit=signal.unit))
        return tuple(found)

    def break_inputs(self, kind: str, *, on: bool, now: int) -> None:
        """See `DeviceFunction`."""
        self.faults.switch(kind, on=on, now=now)
        self.show_all(now)

    # -- from values to objects

    def number(self, address: Address, default: float = 0) -> float:
        """Return the number in an object."""
        value = self.store.values.get(address, default)
        return value if isinstance(value, int | float) else default

    def gain(self, signal: Signal) -> float:
        """Return units per raw number, as the device's objects say now."""
        return signal.gain(self.store.values)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the raw number of a value, before it is rounded to what its object holds."""
        return (value - signal.offset) / gain

    def full_scale(self, signal: Signal) -> float:
        """Return of how much noise and jumps are a share."""
        kind = self.store.od[signal.address].data_type
        return abs(self.gain(signal)) * (float(kind.maximum) if kind.is_integer else 100.0)

    def show_all(self, now: int) -> None:
        """Let all objects show what is outside; the status of a value is shown with that."""
        for name, signal in self._inputs.items():
            if signal.address in self._statuses:
                continue
            value = self.faults.value(name, self.outside[name], self.full_scale(signal), now)
            self._show(signal, value)

    def _show(self, signal: Signal, value: float) -> None:
        gain = self.gain(signal)
        for index in (signal.index, *self.same_values.get(signal.index, ())):
            entry = self.store.od.get(index, signal.subindex)
            if entry is None:
                continue
            kind = entry.data_type
            if kind.is_integer:
                wanted = round(self.raw_of(signal, value, gain))
                shown: float = min(max(wanted, kind.minimum), kind.maximum)
                if index == signal.index:
                    self.cut_off(signal, wanted - shown)
            else:
                shown = value
            if self.store.values[entry.address] != shown:
                self.store.set(*entry.address, shown)
                self._outbox.values_changed()

    def cut_off(self, signal: Signal, by: float) -> None:
        """Take that an object holds its value, or that this is beyond the greatest (least) one `by` so much."""

    def _scale_written(self, _entry: Entry, _value: Value) -> None:
        self.show_all(self.clock.now)

    # -- life

    def power_on(self, now: int) -> None:
        """See `DeviceFunction`."""
        self.show_all(now)

    def connection_lost(self, now: int) -> None:
        """See `DeviceFunction`."""
        self._fail(now)

    def communication_stopped(self, now: int) -> None:
        """See `DeviceFunction`."""
        self._fail(now)

    def _fail(self, _now: int) -> None:
        take_error_values(self.store, [signal.address for signal in self.signals.values() if signal.output])
        self._outbox.values_changed()

    def tick(self, now: int) -> None:
        """See `DeviceFunction`."""
        moved = self._move(now)
        if self.faults.due(now) or moved:
            self.show_all(now)

    def next_deadline(self) -> int | None:
        """See `DeviceFunction`."""
        deadlines = [each for each in (self.faults.next_deadline(), self._moves_at()) if each is not None]
        return min(deadlines, default=None)

    def _moves_at(self) -> int | None:
        moving = any(self.outside[name] for name in self.moving)
        return (self._moved_at or 0) + self.step_ns if moving else None

    def _move(self, now: int) -> bool:
        """Let what changes by time change until now."""
        due = self._moves_at()
        if self._moved_at is not None and due is not None and now >= due:
            self.move((now - self._moved_at) / _NS)
            self._moved_at = now
            return True
        if due is None or self._moved_at is None:
            self._moved_at = now
        return False

    def move(self, seconds: float) -> None:
        """Change what changes by time."""

    # -- the gate of its TPDOs

    def starts(self, mapped: Collection[Address]) -> bool:
        """See `DeviceFunction`."""
        del mapped
        return True

    def passes(self, changed: Collection[Address]) -> bool:
        """See `DeviceFunction`."""
        return bool(changed)

    def told(self) -> None:
        """See `DeviceFunction`."""


class MeasuringDevice(SensorDevice):
    """Measured values with status bits (CiA 404)."""

    same_values: Mapping[int, tuple[int, ...]] = {
        first: tuple(other for other in (0x6130, 0x7130, 0x9130) if other != first)
        for first in (0x6130, 0x7130, 0x9130)
    }  # fmt: skip

    def cut_off(self, signal: Signal, by: float) -> None:
        """Set the bits of an overload beside those that are set from outside."""
        if signal.status is not None and signal.status in self.store.values:
            wanted = int(self.outside.get(f"status{signal.subindex - 1}", 0.0)) | (2 if by > 0 else 4 if by < 0 else 0)
            if self.store.values[signal.status] != wanted:
                self.store.set(*signal.status, wanted)
                self._outbox.values_changed()


class Battery(SensorDevice):
    """A battery with a state of charge (CiA 418)."""

    moving: Mapping[str, str] = {"battery_current": "A"}
    begins_with: Mapping[str, float] = {
        "battery_voltage": 25.6,
        "battery_temperature": 25.0,
        "battery_percentage": 80.0,
    }
    step_ns = 1_000_000_000
    _RESISTANCE: Final = 0.05  # Ohm

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the raw number; the voltage sags with the current."""
        if signal.name == "battery_voltage":
            value += self._RESISTANCE * self.outside["battery_current"]
        return super().raw_of(signal, value, gain)

    def move(self, seconds: float) -> None:
        """Count the charge that has flowed."""
        capacity = self.outside.get("battery_capacity", 0.0) or 100.0
        flowed = self.outside["battery_current"] * seconds / 3600.0 / capacity * 100.0
        present = self.outside.get("battery_percentage", 0.0)
        self.outside["battery_percentage"] = min(max(present + flowed, 0.0), 100.0)


class Charger(SensorDevice):
    """A battery charger (CiA 419), which charges by what it is told of the battery."""

    def _fail(self, _now: int) -> None:
        """Request nothing of it: who asked for a current may be gone with the battery."""
        requested = self.signals.get("charge_current_requested")
        if requested is not None and requested.output:
            self.store.set(*requested.address, 0)
            self._outbox.values_changed()
