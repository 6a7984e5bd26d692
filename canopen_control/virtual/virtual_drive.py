"""Axis of a CiA 402 drive: power, modes, limits and motion on an object store.

All objects of a message are written first and applied afterwards, in this order: mode, controlword, set-points; thus
all values of a PDO are written when its controlword is applied. Set-points apply only in OPERATION ENABLED while the
node is OPERATIONAL.
"""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import ErrorRegister
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.loop_gains import LoopGain, gain_objects
from canopen_control.cia402.modes import mode_name, supported_modes
from canopen_control.cia402.objects import OPTION_CODES, Reaction
from canopen_control.cia402.state import (
    HALT_BIT,
    INTERNAL_LIMIT,
    REMOTE,
    TARGET_REACHED,
    VOLTAGE_ENABLED,
    WARNING,
    State,
    command_of,
)
from canopen_control.rpc.messages.drive import AxisState, PlantState
from canopen_control.virtual.axis_motion import UNIT_OBJECTS, AxisMotion, AxisObjects, wrap32
from canopen_control.virtual.device_model import GENERIC, DeviceModel
from canopen_control.virtual.drive_modes import MODES, DriveModes, possible_modes
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.mode_base import AxisParts, SetpointStatistics
from canopen_control.virtual.plant import IdealPlant, Plant, ServoGains
from canopen_control.virtual.power_machine import DriveLimits, PowerMachine

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia301.nmt import NmtSlave
    from canopen_control.cia402.loop_gains import GainObject
    from canopen_control.od.model import DataType, Entry, Value
    from canopen_control.virtual.node_outbox import NodeClock, NodeOutbox
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.trajectory import DemandCurve


# The statusword and the other objects of an axis whose values are computed when they are read.
#
# Reading has no side effects. Positions are in user units and wrap at 32 bits like a counter, velocities and torques
# are limited to their type.


def clamp(value: float, bits: int = 32) -> int:
    """Round a value and clamp it to the range of a signed integer with `bits` bits."""
    edge, number = 1 << bits - 1, round(value)
    if -edge <= number < edge:
        return number
    return edge - 1 if number > 0 else -edge


class Statusword:
    """Statusword 0x6041 of one axis, composed of state, mode, limits and injected bits.

    Injection points: `remote` (bit 9), `warning` (bit 7), and the bits `forced` and `suppressed`. `changes` are
    functions of quirks that are applied to the statusword.
    """

    def __init__(self, axis: AxisParts, modes: DriveModes) -> None:
        self._power, self._limits, self._mover, self._modes = axis.power, axis.limits, axis.mover, modes
        self._velocity_bits = axis.objects.model.velocity_bits
        self.remote: InjectionPoint[bool] = InjectionPoint(True)
        self.warning: InjectionPoint[bool] = InjectionPoint(False)
        self.forced: InjectionPoint[int] = InjectionPoint(0)
        self.suppressed: InjectionPoint[int] = InjectionPoint(0)
        self.changes: tuple[Callable[[int], int], ...] = ()

    def value(self) -> int:
        """Return the statusword at the time to which the axis has been advanced."""
        power, mode = self._power, self._modes.active
        word = power.bits | self.forced.value
        if self._velocity_bits is not None:
            word |= self._velocity_bits(mode.measured_velocity())
        if power.voltage.value:
            word |= VOLTAGE_ENABLED
        if self.remote.value:
            word |= REMOTE
        if self.warning.value:
            word |= WARNING
        if self._limits.active:
            word |= INTERNAL_LIMIT
        enabled = power.state is State.OPERATION_ENABLED
        bits = mode.bits() if enabled else mode.unpowered_bits()
        if not enabled or power.halted:
            bits = bits & ~TARGET_REACHED | (TARGET_REACHED if self._mover.at_standstill else 0)
        word = (word | bits) & ~self.suppressed.value
        if self.changes:
            for change in self.changes:
                word = change(word)
        return word


class AxisReadings:
    """Actual values of one axis, computed when their objects are read.

    `inputs` are additional bits of 0x60FD. The injection point `inverted` reverses the sign of position and velocity.
    """

    def __init__(self, axis: AxisParts, modes: DriveModes) -> None:
        self.mover, self.limits, self.modes = axis.mover, axis.limits, modes
        self.objects, self.units = axis.objects, axis.objects.units
        self.statusword: Statusword = Statusword(axis, modes)
        self.inputs = 0
        self.inverted: InjectionPoint[bool] = InjectionPoint(False)

    @property
    def sign(self) -> float:
        """Sign of the displayed position and velocity: -1 with the fault `inverted`, else 1."""
        return -1.0 if self.inverted.value else 1.0

    def demand(self) -> tuple[float, float]:
        """Return the demanded position and velocity, in plant counts and counts/s."""
        return self.mover.state(self.mover.time)

    def position(self) -> int:
        """Return the actual position 0x6064 in user units."""
        units = self.units
        value = (self.mover.plant.position - units.zero) / units.position
        return wrap32(-value if self.inverted.value else value)

    def velocity(self) -> int:
        """Return the actual velocity 0x606C in user units."""
        value = self.modes.active.measured_velocity() / self.units.velocity
        return clamp(-value if self.inverted.value else value)

    def rpm(self, velocity: float) -> int:
        """Convert a velocity in counts/s to rpm, the unit of velocity mode."""
        return clamp(velocity / self.objects.counts_per_rpm * self.units.turn, 16)

    def torque(self) -> int:
        """Return the actual torque 0x6077 in per mille of the rated torque."""
        return clamp(self.mover.plant.torque, 16)

    def torque_demand(self) -> int:
        """Return the torque demand 0x6074 in per mille, or 0 outside the torque modes."""
        torque = self.mover.torque
        return 0 if torque is None else clamp(torque.at(self.mover.time)[1], 16)

    def digital_inputs(self) -> int:
        """Return the digital inputs 0x60FD: switches and additional bits."""
        return self.mover.switches.inputs(self.mover.plant.position) | self.inputs


SOURCES: dict[int, Callable[[AxisReadings], int]] = {
    o.STATUSWORD: lambda axis: axis.statusword.value(),
    o.VL_VELOCITY_DEMAND: lambda axis: axis.rpm(axis.demand()[1]),
    o.VL_VELOCITY_ACTUAL: lambda axis: axis.rpm(axis.modes.active.measured_velocity()),
    o.MODES_OF_OPERATION_DISPLAY: lambda axis: axis.modes.number,
    o.POSITION_DEMAND: lambda axis: axis.units.user(axis.demand()[0]),
    o.POSITION_ACTUAL_INTERNAL: lambda axis: wrap32((axis.mover.plant.position - axis.units.zero) * axis.sign),
    o.POSITION_ACTUAL: AxisReadings.position,
    o.VELOCITY_SENSOR_ACTUAL: AxisReadings.velocity,
    o.VELOCITY_DEMAND: lambda axis: clamp(axis.demand()[1] / axis.units.velocity),
    o.VELOCITY_ACTUAL: AxisReadings.velocity,
    o.TORQUE_DEMAND: AxisReadings.torque_demand,
    o.TORQUE_ACTUAL: AxisReadings.torque,
    o.CURRENT_ACTUAL: AxisReadings.torque,
    o.FOLLOWING_ERROR_ACTUAL: lambda axis: clamp(axis.limits.following_error / axis.units.position),
    o.POSITION_DEMAND_INTERNAL: lambda axis: wrap32(axis.demand()[0] - axis.units.zero),
    o.DIGITAL_INPUTS: AxisReadings.digital_inputs,
}
"""Functions that compute the values of objects when they are read, by index on axis 0."""


# Overload protection (I2t) of a motor, from the current above the rated current and its duration.
#
# The heat above that of the rated torque grows with the square of the torque and is dissipated below the rated torque.
# A motor can bear twice its rated torque for 2 s, or three times for 0.75 s; then its drive reports continuous
# over-current (0x2310) and faults. Torques are in per mille of the rated torque.


OVERLOAD: Final = 0x2310
TORQUE_LIMITS: Final = (o.MAX_TORQUE, o.MAX_CURRENT)
"""Objects that limit the torque of all loops; current and torque of a motor are proportional."""

_HEAT_S: Final = 6.0  # s for which a motor can bear the additional heat of its rated torque
_GAP_S: Final = 0.1  # a longer time between two calls means that the motor had no power


class OverloadGuard:
    """Thermal model (I2t) of one motor; `heat` is the excess over the heat at rated torque, in s."""

    def __init__(self) -> None:
        self.heat = 0.0
        self._checked_ns: int | None = None

    def exceeded(self, torque: float, now: int) -> bool:
        """Whether the motor is too hot at `now` (ns), after `torque` (per mille) since the last call."""
        seconds = 0.0 if self._checked_ns is None else (now - self._checked_ns) * 1e-9
        self._checked_ns = now
        ratio = 0.0 if seconds > _GAP_S else torque / 1000.0
        self.heat = max(0.0, self.heat + (ratio * ratio - 1.0) * seconds)
        return self.heat > _HEAT_S


# The two touch probes of an axis: positions captured at an edge (CiA 402-2, 9.3.4).
#
# 0x60B8 arms the probes, 0x60B9 shows their status, 0x60BA to 0x60BD are the captured positions. The probe inputs are
# bits 16 and 17 of 0x60FD; a probe may use the index pulse of the encoder instead, which has rising edges only. A probe
# in single mode captures once until it is armed again, in continuous mode at every edge.


_ENABLE, _CONTINUOUS, _INDEX, _RISING, _FALLING = 1 << 0, 1 << 1, 1 << 2, 1 << 4, 1 << 5
_CAUGHT_RISING, _CAUGHT_FALLING = 1 << 1, 1 << 2
_SHIFTS = (0, 8)  # bit offsets of probe 1 and 2 in 0x60B8 and 0x60B9
_FIRST_INPUT = 16
_POSITIONS = (
    (o.TOUCH_PROBE_1_POSITIVE, o.TOUCH_PROBE_1_NEGATIVE),
    (o.TOUCH_PROBE_2_POSITIVE, o.TOUCH_PROBE_2_NEGATIVE),
)


class TouchProbes:
    """Touch probes 1 and 2 of one axis (CiA 402-2, 9.3.4)."""

    def __init__(self, objects: AxisObjects, mover: AxisMotion, outbox: NodeOutbox) -> None:
        self._objects, self._mover, self._outbox = objects, mover, outbox
        self._armed = 0

    def reset(self) -> None:
        self._armed = 0

    def update(self, now: int) -> None:
        """Apply 0x60B8: reset the status of each probe whose function has changed, and arm enabled probes."""
        function = self._objects.number(o.TOUCH_PROBE_FUNCTION)
        if function == self._armed:
            return
        status = self._objects.number(o.TOUCH_PROBE_STATUS)
        for shift in _SHIFTS:
            before, after = self._armed >> shift & 0xFF, function >> shift & 0xFF
            if before != after:
                status = status & ~(0xFF << shift) | ((after & _ENABLE) << shift)
        self._armed = function
        self._show(status)
        self._mover.watch_index(now)

    def inputs_changed(self, before: int, after: int) -> None:
        """Capture the position at edges of the probe inputs; `before` and `after` are the bits of 0x60FD."""
        position = self._mover.plant.position
        for probe, shift in enumerate(_SHIFTS):
            bit = 1 << _FIRST_INPUT + probe
            if (before ^ after) & bit and not self._armed >> shift & _INDEX:
                self._catch(probe, position, rising=bool(after & bit))

    def index_passed(self, position: float) -> None:
        """Capture the `position` (plant counts) of an index pulse."""
        for probe, shift in enumerate(_SHIFTS):
            if self._armed >> shift & _INDEX:
                self._catch(probe, position, rising=True)

    @property
    def wants_index(self) -> bool:
        """Whether a probe waits for an index pulse."""
        return any(self._armed >> shift & (_ENABLE | _INDEX) == _ENABLE | _INDEX for shift in _SHIFTS)

    def next_index(self, demand: DemandCurve, now: int) -> tuple[int, float] | None:
        """Return the time and position of the next index pulse on `demand`, or None if there is none to capture."""
        if not self.wants_index:
            return None
        position = demand.at(now)[0]
        period = self._mover.switches.index_period
        ahead = (math.floor(position / period) + 1) * period
        behind = (math.ceil(position / period) - 1) * period
        candidates = [
            (crossing, pulse) for pulse in (ahead, behind) if (crossing := demand.time_of(pulse, now)) is not None
        ]
        return min(candidates, default=None)

    def _catch(self, probe: int, position: float, *, rising: bool) -> None:
        shift = _SHIFTS[probe]
        function, status = self._armed >> shift, self._objects.number(o.TOUCH_PROBE_STATUS)
        armed, caught = (_RISING, _CAUGHT_RISING) if rising else (_FALLING, _CAUGHT_FALLING)
        if not function & _ENABLE or not function & armed:
            return
        if status >> shift & caught and not function & _CONTINUOUS:
            return
        index = _POSITIONS[probe][0 if rising else 1]
        self._objects.set(index, self._objects.units.user(position))
        self._show(status | caught << shift)

    def _show(self, status: int) -> None:
        self._objects.set(o.TOUCH_PROBE_STATUS, status)
        self._outbox.values_changed()


_OPTIONS = (o.QUICK_STOP_OPTION, o.SHUTDOWN_OPTION, o.DISABLE_OPERATION_OPTION, o.HALT_OPTION, o.FAULT_REACTION_OPTION)


class VirtualDrive:
    """Axis of a virtual drive (CiA 402), attached to the objects of `store`.

    `shows_motion` returns whether an event-driven TPDO contains values that change with a motion. The axis is the
    `MotorMode` of its power state machine and implements the `Reactions` of its mover.
    """

    def __init__(
        self,
        axis: int,
        store: VirtualStore,
        outbox: NodeOutbox,
        clock: NodeClock,
        nmt: NmtSlave,
        *,
        plant: Plant | None = None,
        model: DeviceModel = GENERIC,
        shows_motion: Callable[[], bool],
    ) -> None:
        self.axis, self._store, self._outbox, self._clock = axis, store, outbox, clock
        self.wants_samples = shows_motion
        # attributes that quirks use have annotations: a compiled module is checked before this one
        self.objects: AxisObjects = AxisObjects(store, axis, model)
        self.mover: AxisMotion = AxisMotion(IdealPlant() if plant is None else plant, self)
        objects, mover = self.objects, self.mover
        self.power: PowerMachine = PowerMachine(objects, mover, outbox, nmt, self)
        self.limits = DriveLimits(objects, mover, outbox, self.power)
        self.meter = SetpointStatistics()
        self._overload = OverloadGuard()
        parts = AxisParts(objects, mover, self.power, self.limits, outbox, clock, self.meter)
        self.modes: DriveModes = DriveModes(parts)
        self.readings: AxisReadings = AxisReadings(parts, self.modes)
        self.probes = TouchProbes(objects, mover, outbox)
        self._mode_address = (o.MODES_OF_OPERATION + objects.offset, 0)
        self._values = store.values
        self._gains = gain_objects(store.od, axis)
        self._attach()

    @property
    def state(self) -> State:
        return self.power.state

    def statusword(self) -> int:
        """Return the statusword 0x6041 at the time to which the drive has been advanced."""
        return self.readings.statusword.value()

    def describe(self) -> AxisState:
        """Return the state of the axis and its motor as a message."""
        plant = self.mover.plant
        return AxisState(
            axis=self.axis,
            state=self.state.name,
            statusword=self.statusword(),
            controlword=self.power.controlword,
            mode=mode_name(self.modes.number),
            position=self.readings.position(),
            velocity=self.readings.velocity(),
            plant=PlantState(plant.position, plant.velocity, plant.torque),
            set_points=self.meter.quality(self.objects.units.velocity),
        )

    # -- objects

    def _attach(self) -> None:
        store, shift = self._store, self.objects.offset
        for index, source in SOURCES.items():
            self._show(index + shift, 0, partial(source, self.readings))
        for (index, subindex), shown in self.objects.model.display.items():
            self._show(index + shift, subindex, partial(shown, store))
        modes = store.od.get(o.SUPPORTED_DRIVE_MODES + shift)
        if modes is not None and not modes.value:  # real drives have undocumented values too
            store.preset(*modes.address, possible_modes(self.objects) & modes.data_type.maximum)
        store.guard([o.MODES_OF_OPERATION + shift], self._check_mode, by_values=True)
        store.guard([index + shift for index in _OPTIONS], self._check_option, by_values=True)
        controlword, objects = o.CONTROLWORD + shift, self.objects
        store.on_write([index + shift for index in UNIT_OBJECTS], lambda _entry, _value: objects.units.update(objects))
        store.on_write([o.TOUCH_PROBE_FUNCTION + shift], lambda _entry, _value: self.probes.update(self._clock.now))
        store.on_write([controlword], lambda _entry, _value: self.refresh(self._clock.now, controlword=True))
        store.on_write([index + shift for index in TORQUE_LIMITS], lambda _entry, _value: self._limit_torque())
        store.on_write([o.INTERPOLATION_DATA + shift], self._record_written)
        store.on_write({gain.index for gain in self._gains.values()}, lambda _entry, _value: self._tune())
        indices = {entry.index for entry in store.od if 0x6000 <= entry.index - shift < 0x6800} - {controlword}
        store.on_write(indices, lambda _entry, _value: self.refresh(self._clock.now))

    def _show(self, index: int, subindex: int, source: Callable[[], int]) -> None:
        entry = self._store.od.get(index, subindex)
        if entry is not None and (entry.data_type.is_integer or entry.data_type.is_real):
            self._store.on_read(index, subindex, self._reader(source, entry.data_type))

    def _reader(self, source: Callable[[], int], data_type: DataType) -> Callable[[], int]:
        low, high = (data_type.minimum, data_type.maximum) if data_type.is_integer else (-(1 << 31), 1 << 31)
        mover, clock = self.mover, self._clock

        def read() -> int:
            if mover.now != clock.now or mover.timers:
                mover.advance(clock.now)
            value = source()
            return low if value < low else high if value > high else value

        return read

    def _check_mode(self, _entry: Entry, value: Value) -> Value:
        listed = self.objects.number(o.SUPPORTED_DRIVE_MODES, default=-1)
        if value not in {0, *(MODES if listed == -1 else supported_modes(listed))}:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_option(self, entry: Entry, value: Value) -> Value:
        if isinstance(value, int) and value >= 0 and value not in OPTION_CODES[entry.index - self.objects.offset]:
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    # -- written objects and events

    def power_on(self, now: int) -> None:
        """Reset the axis at power-on (transitions 0 and 1); the current motor position becomes 0."""
        objects, power = self.objects, self.power
        self.mover.advance(now)
        self.mover.timers.clear()
        power.power_off(now)
        objects.units.zero = self.mover.plant.position
        power.controlword = 0
        self.readings.statusword.warning.clear()
        self.probes.reset()
        objects.units.update(objects)
        self._limit_torque()
        self._tune()
        self.modes.clear()
        power.enter(State.NOT_READY_TO_SWITCH_ON, now)
        if delay := power.delays_ns.get(1):
            self.mover.at("ready", now + delay, lambda then: power.enter(State.SWITCH_ON_DISABLED, then))
        else:
            power.enter(State.SWITCH_ON_DISABLED, now)
        self.modes.select(now)

    def set_model(self, model: DeviceModel) -> None:
        """Replace the device model."""
        self.objects.model = model
        self.modes.set_model(model)

    def refresh(self, now: int, *, controlword: bool = False, set_point: bool = False) -> None:
        """Apply written objects: first the mode, then the controlword, then the set-points.

        `set_point` is True if an RPDO contained the set-point of the active mode.
        """
        self.mover.advance(now)
        if self.modes.number != self._values.get(self._mode_address, 0):
            self.modes.select(now)
        if controlword:
            self._control(now)
        if self.power.live and self.modes.is_open:
            mode = self.modes.active
            mode.take(now) if set_point else mode.update(now)

    @property
    def set_point(self) -> int:
        return self.modes.active.set_point

    def set_point_received(self, now: int, *, overwrites: bool) -> None:
        if self.power.live:
            sync_ns = self._clock.sync_ns
            if sync_ns is not None:
                self.meter.received(now - sync_ns)
            self.meter.overwritten += overwrites

    def set_point_missed(self) -> None:
        if self.power.live:
            self.modes.active.count_missed()

    def _limit_torque(self) -> None:
        """Limit the torque of the loops by 0x6072 and 0x6073; 0 means unlimited."""
        limits = [float(limit) for index in TORQUE_LIMITS if (limit := self.objects.number(index)) > 0]
        self.mover.torque_limit = min(limits, default=math.inf)

    def _tune(self) -> None:
        """Set the loop gains of the plant from the gain objects; without a velocity P gain, the plant uses its own."""
        values = {gain: self._gain(gain_object) for gain, gain_object in self._gains.items()}
        speed = self.objects.units.length
        proportional = values.get(LoopGain.VELOCITY_P, 0.0) / speed
        gains = ServoGains(
            proportional,
            values.get(LoopGain.VELOCITY_I, 0.0) / speed,
            values.get(LoopGain.POSITION_P, 0.0),
            values.get(LoopGain.VELOCITY_FEED_FORWARD, 0.0),
        )
        self.mover.set_loop(gains if proportional else None, self._clock.now)

    def _gain(self, gain_object: GainObject) -> float:
        value = self._values.get((gain_object.index, gain_object.subindex), 0)
        return value * gain_object.scale if isinstance(value, (int, float)) else 0.0

    def _record_written(self, entry: Entry, _value: Value) -> None:
        interpolated = self.modes.interpolated
        if (
            self.modes.active is interpolated
            and self.modes.is_open
            and entry.subindex == interpolated.buffer.last_subindex
        ):
            interpolated.record_written(self._clock.now)

    def _control(self, now: int) -> None:
        power = self.power
        word, previous = self.objects.number(o.CONTROLWORD), power.controlword
        power.controlword = word
        before = power.state
        command = command_of(word, previous)
        if command is not None:
            power.obey(command, now)
        if power.running:
            power.halt(bool(word & HALT_BIT), now)
            if power.operational and before is State.OPERATION_ENABLED:
                self.modes.control(word, previous, now)
        elif not self.mover.powered:
            self.modes.active.control_unpowered(word, previous, now)
        if word != previous:
            self._outbox.values_changed()

    def fault(self, code: int, now: int, *, register: int = ErrorRegister.GENERIC, data: bytes = b"") -> None:
        """Raise a fault with the EMCY `code`: stop according to 0x605E, then enter FAULT."""
        self.power.fault(code, now, register=register, data=data)

    def set_inputs(self, bits: int, now: int) -> None:
        """Set the additional bits of 0x60FD; bits 16 and 17 are the inputs of the touch probes."""
        self.mover.advance(now)
        before, self.readings.inputs = self.readings.inputs, bits
        self.probes.inputs_changed(before, bits)
        self._outbox.values_changed()

    def connection_lost(self, now: int) -> None:
        """React to lost communication according to 0x6007; if only 0x1029:01 exists, leave the reaction to the node."""
        if self.objects.has(o.ABORT_CONNECTION_OPTION) or not self._store.has(0x1029, 1):
            self.power.abort_connection(0x8130, now)

    def communication_stopped(self, now: int) -> None:
        """React to NMT STOPPED or a reset of communication according to 0x6007 (default: fault)."""
        self.power.abort_connection(0x8100, now)

    # -- time

    def advance(self, now: int) -> None:
        self.mover.advance(now)

    def next_deadline(self) -> int | None:
        return self.mover.next_deadline()

    # -- the motor of the power state machine

    def start(self, now: int) -> None:
        self.modes.start(now)

    def stop(self, now: int, reaction: Reaction) -> None:
        self.modes.active.stop(now, reaction)

    def can_halt(self) -> bool:
        return self.modes.active.can_halt()

    def released(self) -> None:
        self.limits.reset()
        self.modes.reset()

    # -- the reactions to the motion

    def arrived(self, now: int) -> None:
        """Enter the next state at the end of a stop, or continue the mode at the end of a demand."""
        target = self.power.stop_target
        if target is not None:
            self.power.finish(target, now)
        elif self.power.running and not self.power.halted:
            self.limits.arrived(now)
            self.modes.active.arrived(now)
        self._outbox.values_changed()

    def limit_switch_hit(self, side: int, now: int) -> None:
        """Stop with the quick-stop ramp at a wired limit switch, and report the switch."""
        if self.power.running:
            self.limits.limit_switch_hit(side)
            self.stop(now, Reaction.QUICK_STOP_RAMP)

    def check_following_error(self, error: float, now: int) -> None:
        self.limits.check_following_error(error, now)

    def check_load(self, torque: float, now: int) -> None:
        """Check the thermal load of the motor; an overload raises fault 0x2310."""
        if self._overload.exceeded(torque, now) and self.power.running:
            self.fault(OVERLOAD, now, register=ErrorRegister.GENERIC | ErrorRegister.CURRENT)

    def on_sample(self) -> None:
        self._outbox.values_changed()

    def next_index(self, demand: DemandCurve, now: int) -> tuple[int, float] | None:
        return self.probes.next_index(demand, now)

    def index_passed(self, position: float) -> None:
        self.probes.index_passed(position)
