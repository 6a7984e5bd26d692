"""Virtual I/O modules, sensors, encoders, batteries and chargers (CiA 401 to 419); clients set their inputs.

A digital input causes an event according to the masks 0x6006 (any change), 0x6007 (rising) and 0x6008 (falling) if
0x6005 allows it. An analogue input causes an event once 0x6423 is set, as selected in 0x6421: above the upper limit
(0x6424), below the lower limit (0x6425), changed by 0x6426, fallen by 0x6427 or risen by 0x6428 since the last event;
0x6422 shows the source until it is read. 0x6002 and 0x6202 invert the polarity of lines. A lost master and NMT stop set
every output whose error mode is active to its error value, also in the object, until another value is written.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, nearest
from canopen_control.profiles import AI_DELTA, AI_ENABLE, ANALOGUE_INPUTS, DIGITAL_INPUTS, ERROR_OBJECTS
from canopen_control.rpc.messages.drive import SignalState

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from canopen_control.od.model import Address, Entry, Value
    from canopen_control.profiles import Signal
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.shaft import ShaftWorld


# Faults of a virtual device's inputs: stuck at the current value, noisy, or off by a sudden jump.
#
# A stuck input keeps its value; noise is up to 2 % of the full scale and changes every 20 ms in a fixed sequence; a
# jump adds a quarter of the full scale. Lines that are bits can only be stuck.


KINDS: Final = ("stuck", "noise", "jump")
NOISE: Final = 0.02  # fraction of the full scale
JUMP: Final = 0.25
_NOISE_NS: Final = 20_000_000
_INPUT_STEPS: Final = 101  # steps of the noise pattern, which is the same each time


class InputFaults:
    """Active faults of a device's inputs, and their effect on the input values."""

    def __init__(self) -> None:
        self._on: set[str] = set()
        self._frozen: dict[str, float] = {}
        self._noise_at = 0
        self._step = 0

    def switch(self, kind: str, *, on: bool, now: int) -> None:
        """Switch a kind of fault on or off; raise ConfigError if unknown."""
        if kind not in KINDS:
            raise ConfigError(f"unknown fault of inputs {kind!r}; choose one of: {', '.join(KINDS)}")
        if on:
            self._on.add(kind)
        else:
            self._on.discard(kind)
        self._frozen.clear()
        self._noise_at = now + _NOISE_NS

    def line(self, name: str, value: float) -> float:
        """Return the level shown for an input line whose true level is `value`."""
        return value if "stuck" not in self._on else self._frozen.setdefault(name, value)

    def value(self, name: str, value: float, full_scale: float) -> float:
        """Return the value shown for an input whose true value is `value`."""
        if "stuck" in self._on:
            value = self._frozen.setdefault(name, value)
        if "jump" in self._on:
            value += JUMP * full_scale
        if "noise" in self._on:
            course = (self._step * 37 % _INPUT_STEPS) / (_INPUT_STEPS - 1) * 2.0 - 1.0
            value += NOISE * full_scale * course
        return value

    def due(self, now: int) -> bool:
        """Advance the noise if a step is due; return whether one was due."""
        if "noise" not in self._on or now < self._noise_at:
            return False
        self._step += 1
        self._noise_at = now + _NOISE_NS
        return True

    def next_deadline(self) -> int | None:
        """Return the time in ns of the next noise step, or None without noise."""
        return self._noise_at if "noise" in self._on else None


_IN_POLARITY, _OUT_POLARITY = 0x6002, 0x6202
_DIGITAL_ENABLE, _ANY, _RISING, _FALLING = 0x6005, 0x6006, 0x6007, 0x6008
_TRIGGER, _SOURCE, _UPPER, _LOWER, _FALL, _RISE = 0x6421, 0x6422, 0x6424, 0x6425, 0x6427, 0x6428
_TRIGGERS: Final = 0x07  # upper, lower, delta: without 0x6421
_CHANNELS = 32  # channels in one subindex of 0x6422


class TerminalDevice:
    """Base class of the virtual devices other than drives: signals, input faults and error values of the outputs.

    `outside` maps the names of inputs to their true values. `moving` maps the names of inputs that change other inputs
    over time to their units.
    """

    moving: Mapping[str, str] = {}  # name to unit

    def __init__(self, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock, signals: Iterable[Signal]) -> None:
        self.store, self._outbox, self.clock = store, outbox, clock
        self.signals = {signal.name: signal for signal in signals}
        self.inputs = {name: signal for name, signal in self.signals.items() if not signal.output}
        self.outside: dict[str, float] = {}
        self.faults, self.overloaded = InputFaults(), False

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        for name in values:
            if name in self.signals and name not in self.inputs:
                raise ConfigError(f"{name} is an output, which only the master can set")
            if name not in self.signals and name not in self.moving:
                raise ConfigError(f"no signal {name!r}{nearest(name, [*self.signals, *self.moving])}")
        self.tick(now)
        self.outside.update(values)
        self.show_all()

    def break_inputs(self, kind: str, *, on: bool, now: int) -> None:
        self.faults.switch(kind, on=on, now=now)
        self.show_all()

    def number(self, address: Address, default: float = 0) -> float:
        """Return the number in an object; `default` if missing or not numeric."""
        value = self.store.values.get(address, default)
        return value if isinstance(value, int | float) else default

    def show_all(self) -> None:
        """Update the objects of all inputs."""

    def scale_written(self, _entry: Entry, _value: Value) -> None:
        """Update the objects of all inputs after a change of scaling or polarity."""
        self.show_all()

    def power_on(self, now: int) -> None:  # noqa: ARG002 - a device with timers needs the time
        self.show_all()

    def connection_lost(self, now: int) -> None:
        self.fail(now)

    def communication_stopped(self, now: int) -> None:
        self.fail(now)

    def tick(self, now: int) -> None:
        if self.faults.due(now):
            self.show_all()

    def next_deadline(self) -> int | None:
        return self.faults.next_deadline()

    def fail(self, _now: int) -> None:
        """Set the outputs whose error mode is active to their error values."""
        take_error_values(self.store, [signal.address for signal in self.signals.values() if signal.output])
        self._outbox.values_changed()


class IoDevice(TerminalDevice):
    """Digital and analogue inputs and outputs of an I/O module (CiA 401)."""

    def __init__(self, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock, signals: Iterable[Signal]) -> None:
        super().__init__(store, outbox, clock, signals)
        self._reference: dict[Address, float] = {}  # an analogue input at its last event
        self._fired: set[Address] = set()
        self._addresses = {signal.address for signal in self.inputs.values()}
        for sub in store.od.subindices(_SOURCE):
            if sub:
                store.on_read(_SOURCE, sub, lambda sub=sub: self._take_source(sub))  # type: ignore[misc]
        self._sources: dict[int, int] = {}
        watched = {index for index in (_IN_POLARITY,) if (index, 1) in store.od}
        store.on_write(watched, self.scale_written)

    # -- from outside

    def describe(self) -> tuple[SignalState, ...]:
        return tuple(self._state_of(signal) for signal in self.signals.values())

    def _state_of(self, signal: Signal) -> SignalState:
        if not signal.output:
            return SignalState(signal.name, self.outside.get(signal.name, 0.0))
        if self.overloaded:
            return SignalState(signal.name, 0.0, output=True)
        raw = self.number(signal.address)
        if signal.bit is not None:
            raw = int(raw) ^ self.store.number(_OUT_POLARITY, signal.subindex)
        return SignalState(signal.name, signal.value(raw, signal.factor), output=True)

    def show_all(self) -> None:
        for signal in self.inputs.values():
            self._show(signal)

    def _show(self, signal: Signal) -> None:
        """Update the object of an input from the line, and check whether the change is an event."""
        before = self.number(signal.address)
        outside = self.outside.get(signal.name, 0.0)
        if signal.bit is not None:
            raw: float = self._bits(signal, before, self.faults.line(signal.name, outside))
        else:
            raw = self._held(signal, self.faults.value(signal.name, outside, self._full_scale(signal)))
        if raw == before:
            return
        self.store.set(*signal.address, raw)
        fires = self._digital_event if signal.bit is not None else self._analogue_event
        if fires(signal, before, raw):
            self._fired.add(signal.address)
        self._outbox.values_changed()

    def _bits(self, signal: Signal, before: float, line: float) -> int:
        """Return the value of a digital input object after a change of one line; apply the polarity 0x6002."""
        mask = 1 << (signal.bit or 0)
        shown = bool(line) != bool(self.store.number(_IN_POLARITY, signal.subindex) & mask)
        return int(before) | mask if shown else int(before) & ~mask

    def _held(self, signal: Signal, value: float) -> float:
        """Return the value of an analogue input, rounded and clamped to the range of an integer object."""
        kind = self.store.od[signal.address].data_type
        return min(max(round(value), kind.minimum), kind.maximum) if kind.is_integer else value

    def _full_scale(self, signal: Signal) -> float:
        kind = self.store.od[signal.address].data_type
        return float(kind.maximum) if kind.is_integer else 1.0

    # -- events

    def _digital_event(self, signal: Signal, before: float, after: float) -> bool:
        if signal.index != DIGITAL_INPUTS[0] or not self.store.number(_DIGITAL_ENABLE, 0, 1):
            return signal.index != DIGITAL_INPUTS[0]
        old, new, sub = int(before), int(after), signal.subindex
        number = self.store.number
        edges = number(_ANY, sub, 0xFF) & (old ^ new)
        edges |= number(_RISING, sub, 0) & new & ~old | number(_FALLING, sub, 0) & old & ~new
        return bool(edges)

    def _analogue_event(self, signal: Signal, before: float, after: float) -> bool:
        store, sub = self.store, signal.subindex
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
        """Return and clear the bits of the inputs that had an event (0x6422)."""
        return self._sources.pop(sub, 0)

    def starts(self, mapped: Collection[Address]) -> bool:
        """Whether a TPDO is sent at the start of OPERATIONAL: not if 0x6423 is 0 and it has only analogue inputs."""
        analogue = [address for address in mapped if address[0] in ANALOGUE_INPUTS]
        return not analogue or len(analogue) < len(mapped) or bool(self.store.number(AI_ENABLE, 0, 1))

    def passes(self, changed: Collection[Address]) -> bool:
        return any(address not in self._addresses or address in self._fired for address in changed)

    def tpdos_checked(self) -> None:
        self._fired.clear()

    # -- start and power

    def power_on(self, now: int) -> None:
        self._fired.clear()
        self._sources.clear()
        self._reference.clear()
        super().power_on(now)


_DIGITAL_OUTPUTS: Final = frozenset((0x6200, 0x6300, 0x6320))


def take_error_values(store: VirtualStore, outputs: Iterable[Address]) -> None:
    """Set the outputs whose error mode is active to their error values."""
    for address in dict.fromkeys(outputs):
        mode_index, value_index = ERROR_OBJECTS[address[0]]
        mode = store.number(mode_index, address[1], 0)
        value, present = store.values.get((value_index, address[1]), 0), store.values[address]
        if address[0] in _DIGITAL_OUTPUTS and isinstance(present, int) and isinstance(value, int):
            store.set(*address, present & ~mode | value & mode)
        elif mode:
            store.set(*address, value)


# Virtual sensors: values from outside, in units, shown in the objects of their profile (CiA 404, 418 and 419).
#
# Raw numbers follow the scaling objects of the device (digits, resolution, steps per turn) as soon as these are
# written. A measured value (404) beyond the range of its object is an overload: bits 1 and 2 of its status (0x6150);
# `status0` sets the other bits, such as 1 for a broken wire. A battery (418) with a `battery_current` (A, negative
# during discharge) integrates its charge by its capacity (0x6020:02), and its voltage falls with the discharge current.
# A charger (419) that misses its master resets the requested current.


_NS: Final = 1e9


class SensorDevice(TerminalDevice):
    """Base class of the virtual sensors."""

    begins_with: Mapping[str, float] = {}
    same_values: Mapping[int, tuple[int, ...]] = {}  # object to those that show the same in another format
    step_ns = 10_000_000  # period in which values that change over time are updated

    def __init__(self, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock, signals: Iterable[Signal]) -> None:
        super().__init__(store, outbox, clock, signals)
        self.outside = {
            name: channel.value(self.number(channel.address), self.gain(channel))
            for name, channel in self.inputs.items()
        }
        self.outside.update(dict.fromkeys(self.moving, 0.0))
        self.outside.update({name: begin for name, begin in self.begins_with.items() if name in self.inputs})
        self._statuses = {signal.status for signal in self.signals.values()}
        self._moved_at: int | None = None
        scaled_by = {address[0] for signal in self.signals.values() for address in signal.needs}
        store.on_write(scaled_by, self.scale_written)

    # -- from outside

    def describe(self) -> tuple[SignalState, ...]:
        signals = [SignalState(name, self.outside[name], unit=unit) for name, unit in self.moving.items()]
        for name, signal in self.signals.items():
            if signal.output:
                value = signal.value(self.number(signal.address), self.gain(signal))
                signals.append(SignalState(name, 0.0 if self.overloaded else value, output=True))
            else:
                signals.append(SignalState(name, self.outside[name], unit=signal.unit))
        return tuple(signals)

    # -- from values to objects

    def gain(self, signal: Signal) -> float:
        """Return the physical units per raw count, from the scaling objects of the device."""
        return signal.gain(self.store.values)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the raw number of a value, before rounding to the data type of the object."""
        return (value - signal.offset) / gain

    def full_scale(self, signal: Signal) -> float:
        """Return the full scale of a signal, on which noise and jumps are based."""
        kind = self.store.od[signal.address].data_type
        return abs(self.gain(signal)) * (float(kind.maximum) if kind.is_integer else 100.0)

    def show_all(self) -> None:
        for name, signal in self.inputs.items():
            if signal.address in self._statuses:
                continue
            value = self.faults.value(name, self.outside[name], self.full_scale(signal))
            self._show(signal, value)

    def _show(self, signal: Signal, value: float) -> None:
        gain = self.gain(signal)
        for index in (signal.index, *self.same_values.get(signal.index, ())):
            entry = self.store.od.get(index, signal.subindex)
            if entry is None:
                continue
            kind = entry.data_type
            if kind.is_integer:
                raw = round(self.raw_of(signal, value, gain))
                shown: float = min(max(raw, kind.minimum), kind.maximum)
                if index == signal.index:
                    self.cut_off(signal, raw - shown)
            else:
                shown = value
            if self.store.values[entry.address] != shown:
                self.store.set(*entry.address, shown)
                self._outbox.values_changed()

    def cut_off(self, signal: Signal, by: float) -> None:
        """Handle a raw value that is out of the range of the object by `by` (negative: below, 0: in range)."""

    # -- life

    def tick(self, now: int) -> None:
        moved = self._move(now)
        if self.faults.due(now) or moved:
            self.show_all()

    def next_deadline(self) -> int | None:
        deadlines = [deadline for deadline in (self.faults.next_deadline(), self._moves_at()) if deadline is not None]
        return min(deadlines, default=None)

    def _moves_at(self) -> int | None:
        moving = any(self.outside[name] for name in self.moving)
        return (self._moved_at or 0) + self.step_ns if moving else None

    def _move(self, now: int) -> bool:
        """Advance the values that change over time if a step is due; return whether one was due."""
        deadline = self._moves_at()
        if self._moved_at is not None and deadline is not None and now >= deadline:
            self.move((now - self._moved_at) / _NS)
            self._moved_at = now
            return True
        if deadline is None or self._moved_at is None:
            self._moved_at = now
        return False

    def move(self, seconds: float) -> None:
        """Advance the values that change over time by `seconds`."""

    # -- conditions for sending TPDOs

    def starts(self, mapped: Collection[Address]) -> bool:
        del mapped
        return True

    def passes(self, changed: Collection[Address]) -> bool:
        return bool(changed)

    def tpdos_checked(self) -> None:
        """Do nothing, since no event is ever pending."""


class MeasuringDevice(SensorDevice):
    """Measuring device whose values have status bits (CiA 404)."""

    same_values: Mapping[int, tuple[int, ...]] = {
        first: tuple(other for other in (0x6130, 0x7130, 0x9130) if other != first)
        for first in (0x6130, 0x7130, 0x9130)
    }  # fmt: skip

    def cut_off(self, signal: Signal, by: float) -> None:
        """Set the overload bits in the status, in addition to the status bits set by a client."""
        if signal.status is not None and signal.status in self.store.values:
            status = int(self.outside.get(f"status{signal.subindex - 1}", 0.0)) | (2 if by > 0 else 4 if by < 0 else 0)
            if self.store.values[signal.status] != status:
                self.store.set(*signal.status, status)
                self._outbox.values_changed()


class BatteryDevice(SensorDevice):
    """Battery with a state of charge (CiA 418)."""

    moving: Mapping[str, str] = {"battery_current": "A"}
    begins_with: Mapping[str, float] = {
        "battery_voltage": 25.6,
        "battery_temperature": 25.0,
        "battery_percentage": 80.0,
    }
    step_ns = 1_000_000_000
    _RESISTANCE: Final = 0.05  # Ohm

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the raw number of a value, including the voltage drop caused by the discharge current."""
        if signal.name == "battery_voltage":
            value += self._RESISTANCE * self.outside["battery_current"]
        return super().raw_of(signal, value, gain)

    def move(self, seconds: float) -> None:
        """Change the state of charge by the current of the last `seconds`."""
        capacity = self.outside.get("battery_capacity", 0.0) or 100.0
        flowed = self.outside["battery_current"] * seconds / 3600.0 / capacity * 100.0
        present = self.outside.get("battery_percentage", 0.0)
        self.outside["battery_percentage"] = min(max(present + flowed, 0.0), 100.0)


class Charger(SensorDevice):
    """Battery charger (CiA 419), which receives battery data and a requested current."""

    def fail(self, _now: int) -> None:
        """Set the requested current to zero when communication is lost, since the battery may be disconnected."""
        requested = self.signals.get("charge_current_requested")
        if requested is not None and requested.output:
            self.store.set(*requested.address, 0)
            self._outbox.values_changed()


# Virtual encoders (CiA 406) and inclinometers (CiA 410): a position or two angles from outside, shown as set up.
#
# An encoder counts `position` (rad, m if linear) in its steps (0x6001 with scaling on, else 0x6501), inverted by the
# code sequence, shifted by the preset (0x6003) and wrapped at the total range (0x6002); the position is moved by
# `velocity`, or by the shaft of a virtual drive (see `shaft`). 0x6200 is the event timer of the first TPDO, and while a
# timer is set changes are not events. An inclinometer shows its angles with the resolution 0x6000, which re-scales at
# once, inverted and shifted according to 0x6x11 to 0x6x14.


_OPERATION, _STEPS, _RANGE, _PRESET, _POSITION = 0x6000, 0x6001, 0x6002, 0x6003, 0x6004
_TIMER, _SINGLE_TURN = 0x6200, 0x6501
_COUNTER_CLOCKWISE, _SCALING = 0x01, 0x04
_EVENT_TIMER: Final = (0x1800, 5)


class Encoder(SensorDevice):
    """Rotary or linear encoder (CiA 406)."""

    moving: Mapping[str, str] = {"velocity": ""}

    def __init__(self, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock, signals: Iterable[Signal]) -> None:
        shown = [signal for signal in signals if signal.name != "position_absolute"]
        super().__init__(store, outbox, clock, shown)
        self._shift = 0.0  # shift by the preset, in steps
        self._world: ShaftWorld | None = None  # world with the shaft of this node
        self._node_id = 0
        store.on_write([_OPERATION], self.scale_written)
        store.on_write([_PRESET], self._preset_written)
        store.on_write([_TIMER], self._timer_written)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return the raw number of a value; positions are in steps, with preset and measuring range."""
        if signal.name != "position":
            return super().raw_of(signal, value, gain)
        return self._counted(value, gain) + self._shift if not self._range else self._wrapped(value, gain)

    def full_scale(self, signal: Signal) -> float:
        return abs(self.gain(signal)) * (self.number((_STEPS, 0)) or 4096)

    def _counted(self, value: float, gain: float) -> float:
        """Convert a position to encoder steps, without preset and measuring range."""
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
            self.show_all()

    def _timer_written(self, _entry: Entry, value: Value) -> None:
        """Copy the cyclic timer 0x6200 to the event timer of TPDO 1, like encoders that have both objects."""
        timer = self.store.od.get(*_EVENT_TIMER)
        if timer is not None and self.store.number(*_EVENT_TIMER) != value:
            self.store.write(timer, value)

    def follow(self, world: ShaftWorld, node_id: int) -> None:
        self._world, self._node_id = world, node_id
        self.move(0.0)

    def set_signals(self, values: Mapping[str, float], now: int) -> None:
        """Set inputs by name; raise ConfigError if one is unknown, an output, or determined by the shaft of a drive."""
        if self._world is not None and (led := [name for name in ("position", "velocity") if name in values]):
            raise ConfigError(f"{led[0]} follows the shaft of a drive, as defined in the plant file; move that drive")
        super().set_signals(values, now)

    def _moves_at(self) -> int | None:
        return super()._moves_at() if self._world is None else (self._moved_at or 0) + self.step_ns

    def move(self, seconds: float) -> None:
        """Advance the position by the velocity, or read the position of the shaft."""
        if self._world is not None:
            place = self._world.shaft_position(self._node_id)
            if place is not None:
                self.outside["position"] = place
            return
        self.outside["position"] += self.outside["velocity"] * seconds

    def passes(self, changed: Collection[Address]) -> bool:
        """Whether changes trigger a TPDO; a change of position does not while an event timer is set."""
        timed = self.number((_TIMER, 0)) or self.number(_EVENT_TIMER)
        return any(address[0] != _POSITION or not timed for address in changed)


class Inclinometer(SensorDevice):
    """Inclinometer with two angles (CiA 410)."""

    same_values: Mapping[int, tuple[int, ...]] = {
        0x6010: (0x6110,),
        0x6020: (0x6120,),
        0x6110: (0x6010,),
        0x6120: (0x6020,),
    }
    _INVERT, _SCALE = 0x01, 0x02  # bits of 0x6x11

    def __init__(self, store: VirtualStore, outbox: NodeOutbox, clock: NodeClock, signals: Iterable[Signal]) -> None:
        super().__init__(store, outbox, clock, signals)
        axes = [
            index & 0xFFF0
            for signal in self.signals.values()
            for index in (signal.index, *self.same_values[signal.index])
        ]
        store.on_write([axis + place for axis in axes for place in (1, 4)], self.scale_written)
        store.on_write([axis + 2 for axis in axes], self._preset_written)

    def raw_of(self, signal: Signal, value: float, gain: float) -> float:
        """Return an angle in steps, with inversion and offsets where enabled."""
        raw, axis = super().raw_of(signal, value, gain), signal.index & 0xFFF0
        operation = int(self.number((axis + 1, 0)))
        raw = -raw if operation & self._INVERT else raw
        return raw + self.number((axis + 3, 0)) + self.number((axis + 4, 0)) if operation & self._SCALE else raw

    def _preset_written(self, entry: Entry, value: Value) -> None:
        """Set the offset so that the current angle equals the written preset."""
        axis = entry.index - 2
        signal = next((signal for signal in self.signals.values() if signal.index == axis), None)
        if signal is not None and isinstance(value, int):
            raw = round(super().raw_of(signal, self.outside[signal.name], self.gain(signal)))
            raw = -raw if int(self.number((axis + 1, 0))) & self._INVERT else raw
            self.store.set(axis + 3, 0, value - raw)
            self.show_all()
