"""A virtual I/O module (CiA 401): lines that are set from outside, outputs that fall to their error values.

Digital inputs are an event where the masks 0x6006 (any change), 0x6007 (rising) and 0x6008 (falling) say so and 0x6005
allows it; analogue ones once 0x6423 is set, by what 0x6421 chooses: above the upper limit (0x6424), below the lower one
(0x6425), changed by 0x6426, fallen by 0x6427, risen by 0x6428 since the last event; 0x6422 tells which, until it is
read. 0x6002 and 0x6202 turn the polarity of lines. A lost master and NMT stop put each output whose error mode says so
to its error value, in the object too, so that it stays there until somebody writes another one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, nearest
from canopen_control.profiles.error_modes import ERROR_OBJECTS
from canopen_control.profiles.io_tables import AI_DELTA, AI_ENABLE, ANALOGUE_INPUTS, DIGITAL_INPUTS
from canopen_control.rpc.messages.drive import SignalState
from canopen_control.virtual.input_faults import InputFaults

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.profiles.device_signal import Signal
    from canopen_control.virtual.node_outbox import Clock, NodeOutbox
    from canopen_control.virtual.object_store import ObjectStore

__all__ = ["IoDevice", "take_error_values"]

_IN_POLARITY, _OUT_POLARITY = 0x6002, 0x6202
_DIGITAL_ENABLE, _ANY, _RISING, _FALLING = 0x6005, 0x6006, 0x6007, 0x6008
_TRIGGER, _SOURCE, _UPPER, _LOWER, _FALL, _RISE = 0x6421, 0x6422, 0x6424, 0x6425, 0x6427, 0x6428
_TRIGGERS: Final = 0x07  # upper, lower, delta: where there is no 0x6421
_CHANNELS = 32  # of one subindex of 0x6422


class IoDevice:
    """The lines of one module; see `DeviceFunction`."""

    def __init__(self, store: ObjectStore, outbox: NodeOutbox, clock: Clock, signals: Iterable[Signal]) -> None:
        self._store, self._outbox, self._clock = store, outbox, clock
        self._signals = {signal.name: signal for signal in signals}
        self._set: dict[str, float] = {}  # what inputs are outside, by name
        self._reference: dict[Address, float] = {}  # an analogue input at its last event
        self._fired: set[Address] = set()
        self.faults, self.overloaded = InputFaults(), False
        self._inputs = {signal.address for signal in self._signals.values() if not signal.output}
        for sub in store.od.subindices(_SOURCE):
            if sub:
                store.on_read(_SOURCE, sub, lambda sub=sub: self._take_source(sub))  # type: ignore[misc]
        self._sources: dict[int, int] = {}
        watched = {index for index in (_IN_POLARITY,) if (index, 1) in store.od}
        store.on_write(watched, self._polarity_written)

    # -- from outside

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """See `DeviceFunction`."""
        for name in values:
            signal = self._signals.get(name)
            if signal is None:
                raise ConfigError(f"no signal {name!r}{nearest(name, self._signals)}")
            if signal.output:
                raise ConfigError(f"{name} is an output: what it is the master says")
        self._set.update(values)
        for name in values:
            self._show(self._signals[name], now)

    def describe(self) -> tuple[SignalState, ...]:
        """See `DeviceFunction`."""
        return tuple(self._state_of(signal) for signal in self._signals.values())

    def _state_of(self, signal: Signal) -> SignalState:
        if not signal.output:
            return SignalState(signal.name, self._set.get(signal.name, 0.0))
        if self.overloaded:
            return SignalState(signal.name, 0.0, output=True)
        raw = self._number(signal.address)
        if signal.bit is not None:
            raw = int(raw) ^ self._store.number(_OUT_POLARITY, signal.subindex)
        return SignalState(signal.name, signal.value(raw, signal.factor), output=True)

    def break_inputs(self, kind: str, *, on: bool, now: int) -> None:
        """See `DeviceFunction`."""
        self.faults.switch(kind, on=on, now=now)
        self._show_all(now)

    def _show_all(self, now: int) -> None:
        for signal in self._signals.values():
            if not signal.output:
                self._show(signal, now)

    def _show(self, signal: Signal, now: int) -> None:
        """Let an object show what its line is outside, and judge whether that is an event."""
        before = self._number(signal.address)
        outside = self._set.get(signal.name, 0.0)
        if signal.bit is not None:
            raw: float = self._bits(signal, before, self.faults.line(signal.name, outside))
        else:
            raw = self._held(signal, self.faults.value(signal.name, outside, self._full_scale(signal), now))
        if raw == before:
            return
        self._store.set(*signal.address, raw)
        fires = self._digital_event if signal.bit is not None else self._analogue_event
        if fires(signal, before, raw):
            self._fired.add(signal.address)
        self._outbox.values_changed()

    def _number(self, address: Address) -> float:
        value = self._store.values[address]
        return value if isinstance(value, int | float) else 0

    def _bits(self, signal: Signal, before: float, line: float) -> int:
        """Return the lines of an object with one of them as it is outside, polarity applied."""
        mask = 1 << (signal.bit or 0)
        shown = bool(line) != bool(self._store.number(_IN_POLARITY, signal.subindex) & mask)
        return int(before) | mask if shown else int(before) & ~mask

    def _held(self, signal: Signal, value: float) -> float:
        """Return what an analogue object can hold of a value."""
        kind = self._store.od[signal.address].data_type
        return min(max(round(value), kind.minimum), kind.maximum) if kind.is_integer else value

    def _full_scale(self, signal: Signal) -> float:
        kind = self._store.od[signal.address].data_type
        return float(kind.maximum) if kind.is_integer else 1.0

    def _polarity_written(self, _entry: Entry, _value: Value) -> None:
        self._show_all(self._clock.now)

    # -- events

    def _digital_event(self, signal: Signal, before: float, after: float) -> bool:
        if signal.index != DIGITAL_INPUTS[0] or not self._store.number(_DIGITAL_ENABLE, 0, 1):
            return signal.index != DIGITAL_INPUTS[0]
        old, new, sub = int(before), int(after), signal.subindex
        number = self._store.number
        wanted = number(_ANY, sub, 0xFF) & (old ^ new)
        wanted |= number(_RISING, sub, 0) & new & ~old | number(_FALLING, sub, 0) & old & ~new
        return bool(wanted)

    def _analogue_event(self, signal: Signal, before: float, after: float) -> bool:
        store, sub = self._store, signal.subindex
        if not store.number(AI_ENABLE, 0, 1):
            return False
        triggers = store.number(_TRIGGER, sub, _TRIGGERS)
        moved = after - self._reference.get(signal.address, 0.0)
        crossed = (
            store.has(_UPPER, sub) and before < store.number(_UPPER, sub) <= after,
            store.has(_LOWER, sub) and before >= store.number(_LOWER, sub) > after,
            abs(moved) >= max(1, store.number(AI_DELTA, sub)),
            -moved >= max(1, store.number(_FALL, sub)),
            moved >= max(1, store.number(_RISE, sub)),
        )
        if not any(hit and triggers >> bit & 1 for bit, hit in enumerate(crossed)):
            return False
        self._reference[signal.address] = after
        place = divmod(sub - 1, _CHANNELS)
        self._sources[place[0] + 1] = self._sources.get(place[0] + 1, 0) | 1 << place[1]
        return True

    def _take_source(self, sub: int) -> int:
        """Return which inputs had an event, and forget it."""
        return self._sources.pop(sub, 0)

    def starts(self, mapped: Collection[Address]) -> bool:
        """See `DeviceFunction`: analogue inputs are silent until 0x6423 is set."""
        analogue = [address for address in mapped if address[0] in ANALOGUE_INPUTS]
        return not analogue or len(analogue) < len(mapped) or bool(self._store.number(AI_ENABLE, 0, 1))

    def passes(self, changed: Collection[Address]) -> bool:
        """See `DeviceFunction`."""
        return any(address not in self._inputs or address in self._fired for address in changed)

    def told(self) -> None:
        """See `DeviceFunction`."""
        self._fired.clear()

    # -- outputs

    def connection_lost(self, now: int) -> None:
        """See `DeviceFunction`."""
        self._fail(now)

    def communication_stopped(self, now: int) -> None:
        """See `DeviceFunction`."""
        self._fail(now)

    def _fail(self, _now: int) -> None:
        take_error_values(self._store, [signal.address for signal in self._signals.values() if signal.output])
        self._outbox.values_changed()

    # -- life

    def power_on(self, now: int) -> None:
        """See `DeviceFunction`."""
        self._fired.clear()
        self._sources.clear()
        self._reference.clear()
        self._show_all(now)

    def tick(self, now: int) -> None:
        """See `DeviceFunction`."""
        if self.faults.due(now):
            self._show_all(now)

    def next_deadline(self) -> int | None:
        """See `DeviceFunction`."""
        return self.faults.next_deadline()


_DIGITAL_OUTPUTS: Final = frozenset((0x6200, 0x6300, 0x6320))


def take_error_values(store: ObjectStore, outputs: Iterable[Address]) -> None:
    """Put objects of outputs to their error values where their error modes say so; others keep what they have."""
    for address in dict.fromkeys(outputs):
        mode_index, value_index = ERROR_OBJECTS[address[0]]
        mode = store.number(mode_index, address[1], 0)
        value, present = store.values.get((value_index, address[1]), 0), store.values[address]
        if address[0] in _DIGITAL_OUTPUTS and isinstance(present, int) and isinstance(value, int):
            store.set(*address, present & ~mode | value & mode)
        elif mode:
            store.set(*address, value)
