"""Virtual encoders (CiA 406) and inclinometers (CiA 410): a position or two angles from outside, shown as set up.

An encoder counts `position` (rad, of a linear one m) in its steps (0x6001 with scaling on, else 0x6501), turned by the
code sequence, moved by the preset (0x6003) and begun again at the total range (0x6002); `velocity` lets the position go
on by itself, or the shaft of a virtual drive leads it (see `shaft`). 0x6200 is the event timer of its first TPDO, and
while one is set changes are no events. An inclinometer shows its angles with the resolution 0x6000, which re-scales at
once, inverted and moved as 0x6x11 to 0x6x14 say.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError
from canopen_control.virtual.sensor_device import SensorDevice

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.profiles.device_signal import Signal
    from canopen_control.virtual.node_outbox import Clock, NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["Encoder", "Inclinometer"]

_OPERATION, _STEPS, _RANGE, _PRESET, _POSITION = 0x6000, 0x6001, 0x6002, 0x6003, 0x6004
_TIMER, _SINGLE_TURN = 0x6200, 0x6501
_COUNTER_CLOCKWISE, _SCALING = 0x01, 0x04
_EVENT_TIMER: Final = (0x1800, 5)


class Encoder(SensorDevice):
    """One shaft or one length."""

    moving: Mapping[str, str] = {"velocity": ""}

    def __init__(self, store: ObjectStore, outbox: NodeOutbox, clock: Clock, signals: Iterable[Signal]) -> None:
        shown = [signal for signal in signals if signal.name != "position_absolute"]
        super().__init__(store, outbox, clock, shown)
        self._shift = 0.0  # of the preset, in steps
        self._shaft: Callable[[], float | None] | None = None
        store.on_write([_OPERATION], self._scale_written)
        store.on_write([_PRESET], self._preset_written)
        store.on_write([_TIMER], self._timer_written)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the count of a position."""
        if signal.name != "position":
            return super().raw_of(signal, value, gain)
        return self._counted(value, gain) + self._shift if not self._range else self._wrapped(value, gain)

    def full_scale(self, signal: Signal) -> float:
        """Return one turn."""
        return abs(self.gain(signal)) * (self.number((_STEPS, 0)) or 4096)

    def _counted(self, value: float, gain: float) -> float:
        """Return the steps of a position before preset and range."""
        operation = int(self.number((_OPERATION, 0), _SCALING))
        single_turn = self.number((_SINGLE_TURN, 0))
        if not operation & _SCALING and single_turn:
            gain = math.tau / single_turn
        steps = round(value / gain)
        return -steps if operation & _COUNTER_CLOCKWISE else steps

    @property
    def _range(self) -> int:
        return int(self.number((_RANGE, 0)))

    def _wrapped(self, value: float, gain: float) -> float:
        return (self._counted(value, gain) + self._shift) % self._range

    def _preset_written(self, _entry: Entry, value: Value) -> None:
        signal = self.signals.get("position")
        if signal is not None and isinstance(value, int):
            self._shift = value - self._counted(self.outside["position"], self.gain(signal))
            self.show_all(self.clock.now)

    def _timer_written(self, _entry: Entry, value: Value) -> None:
        """Take the cyclic timer as the event timer of TPDO 1, as encoders do that have both."""
        timer = self.store.od.get(*_EVENT_TIMER)
        if timer is not None and self.store.number(*_EVENT_TIMER) != value:
            self.store.write(timer, value)

    def follow(self, shaft: Callable[[], float | None]) -> None:
        """Be where a shaft is from now on; see `Follower`."""
        self._shaft = shaft
        self.move(0.0)

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """See `DeviceFunction`; where it is the shaft says that it sits on."""
        if self._shaft is not None and (led := [each for each in ("position", "velocity") if each in values]):
            raise ConfigError(f"{led[0]} is that of the shaft it sits on, as the plant file says; move the drive")
        super().set_signals(values, now)

    def _moves_at(self) -> int | None:
        return super()._moves_at() if self._shaft is None else (self._moved_at or 0) + self.step_ns

    def move(self, seconds: float) -> None:
        """Turn."""
        if self._shaft is not None:
            place = self._shaft()
            if place is not None:
                self.outside["position"] = place
            return
        self.outside["position"] += self.outside["velocity"] * seconds

    def passes(self, changed: Collection[Address]) -> bool:
        """See `DeviceFunction`: what is sent by a timer is not sent for each step."""
        timed = self.number((_TIMER, 0)) or self.number(_EVENT_TIMER)
        return any(address[0] != _POSITION or not timed for address in changed)


class Inclinometer(SensorDevice):
    """Two angles."""

    same_values: Mapping[int, tuple[int, ...]] = {
        0x6010: (0x6110,),
        0x6020: (0x6120,),
        0x6110: (0x6010,),
        0x6120: (0x6020,),
    }
    _INVERT, _SCALE = 0x01, 0x02  # of 0x6x11

    def __init__(self, store: ObjectStore, outbox: NodeOutbox, clock: Clock, signals: Iterable[Signal]) -> None:
        super().__init__(store, outbox, clock, signals)
        axes = [
            index & 0xFFF0
            for signal in self.signals.values()
            for index in (signal.index, *self.same_values[signal.index])
        ]
        store.on_write([axis + place for axis in axes for place in (1, 4)], self._scale_written)
        store.on_write([axis + 2 for axis in axes], self._preset_written)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the angle in steps, with the offsets where they are switched on."""
        raw, axis = super().raw_of(signal, value, gain), signal.index & 0xFFF0
        operation = int(self.number((axis + 1, 0)))
        raw = -raw if operation & self._INVERT else raw
        return raw + self.number((axis + 3, 0)) + self.number((axis + 4, 0)) if operation & self._SCALE else raw

    def _preset_written(self, entry: Entry, value: Value) -> None:
        """Let the present angle be the preset: the offset is what makes it so."""
        axis = entry.index - 2
        signal = next((each for each in self.signals.values() if each.index == axis), None)
        if signal is not None and isinstance(value, int):
            raw = round(super().raw_of(signal, self.outside[signal.name], self.gain(signal)))
            raw = -raw if int(self.number((axis + 1, 0))) & self._INVERT else raw
            self.store.set(axis + 3, 0, value - raw)
            self.show_all(self.clock.now)
