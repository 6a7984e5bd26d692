"""Cyclic and torque modes of operation of one axis, and the selection of the active mode by 0x6060."""

from __future__ import annotations

from collections import deque
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.emcy import ErrorRegister
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode
from canopen_control.cia402.objects import Reaction
from canopen_control.virtual.injection_point import InjectionPoint
from canopen_control.virtual.mode_base import (
    BIT_12,
    BIT_13,
    NEW_SET_POINT,
    REACHED,
    FollowingMode,
    Mode,
    ModeGate,
)
from canopen_control.virtual.node_outbox import ModeChanged
from canopen_control.virtual.profile_modes import HomingMode, ProfilePosition, ProfileVelocity, VelocityMode
from canopen_control.virtual.trajectory import INFINITE, linear_to, ramp_to

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.axis_motion import AxisObjects
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.mode_base import AxisParts
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.trajectory import DemandCurve


# Cyclic synchronous modes and torque modes (CiA 402-2, clauses 9 and 12 to 15).
#
# Set-points are user units, demands are the plant's counts. A set-point causes a new demand if it, or a relevant limit,
# has changed, or if it arrives while the drive extrapolates. A drive whose clock drifts relative to the master's reads
# the set-point once in every period of its own clock, not at its arrival, unless it follows the SYNC.
#
# The demand moves to a position with constant velocity within the interpolation time 0x60C2; 0 sets it
# at once. An interpolated demand ends when the next set-point is due, or continues for as long as the device model
# extrapolates. A drive that recovers the SYNC period reaches the position when the next SYNC is due, not one
# interpolation time after this SYNC, and then continues for as long as earlier SYNCs have been late.
#
# If a SYNC is some microseconds late, the motor has reached its position and is at standstill, but 0 is not the
# velocity of the motion: the velocity is then computed as by an encoder, from the distance in the last interpolation
# time.


# A mode with a stream of set-points in RPDOs counts the set-points, and reacts to a missing set-point.
#
# The stream begins with the second RPDO after the start of the mode. Values written by SDO are followed without
# supervision, so that manual writes cause no fault. A set-point is due after the interpolation time 0x60C2, because a
# drive does not know the period of its master.


_MS = 1_000_000


class StreamMode(FollowingMode):
    """Base class of the modes with a stream of set-points in RPDOs: CSP, IP, CSV and CST."""

    def reset(self) -> None:
        super().reset()
        self._arrived = 0  # set-points since the mode began or was stopped
        self._begun = False
        self.mover.feed_forward(0.0, 0.0)

    def start(self, now: int) -> None:
        """Continue from the current motion to the target; the statistics restart, except after a halt."""
        if not self._begun:
            self._begun = self.meter.used = True
            self.meter.restart()
        super().start(now)

    def stop(self, now: int, reaction: Reaction) -> None:
        """End the stream of set-points and the feed-forward, then stop the motor as defined by `reaction`."""
        self.meter.follow(self.mover.demand, now)
        self.meter.pause()
        self._arrived = 0
        self.mover.cancel("set point")
        self.mover.feed_forward(0.0, 0.0)
        super().stop(now, reaction)

    @property
    def streaming(self) -> bool:
        """Whether at least two set-points have arrived since the mode was started or stopped."""
        return self._arrived > 1

    @property
    def cycles(self) -> int:
        """Number of interpolation periods for which the motion continues without a set-point."""
        missing, store = self.model.missing, self.objects.store
        if missing.cycles_object is None:
            return missing.cycles
        return store.number(*missing.cycles_object, default=missing.cycles)

    @property
    def period_ns(self) -> int:
        """Time between set-points in ns: the interpolation time 0x60C2, or 1 ms if it is 0."""
        return round(self.objects.interpolation_s * 1e9) or _MS

    def take(self, now: int) -> None:
        """Count and apply a set-point from an RPDO, and start the supervision of the next set-point."""
        self._arrived += 1
        self.meter.take(self.compared(), now)
        self.update(now)
        self.supervise(now)

    def compared(self) -> float | None:
        """Return the set-point to compare with the previous one, or None if a repeated set-point is normal."""
        return None

    def count_missed(self) -> None:
        if self.streaming:
            self.meter.missed += 1

    def supervise(self, now: int) -> None:
        """Schedule the fault for missing set-points if the device model has one."""
        cycles = self.cycles if self.model.missing.fault and self.streaming else 0
        if cycles:
            period = self.period_ns
            self.mover.at("set point", now + (1 + cycles) * period + period // 2, self._lost)

    def feed(self) -> None:
        """Apply 0x60B1 and 0x60B2 as feed-forward of the control loops; the demand is unchanged."""
        number = self.objects.number
        self.mover.feed_forward(number(o.VELOCITY_OFFSET) * self.units.velocity, float(number(o.TORQUE_OFFSET)))

    def _lost(self, now: int) -> None:
        if self.power.live and self._begun:
            self.power.fault(self.model.missing.fault, now, register=ErrorRegister.MANUFACTURER)


class CyclicPosition(StreamMode):
    """Cyclic synchronous position mode (CSP): move to the target within the interpolation time 0x60C2, without a ramp.

    Bit 12 is set while the drive follows the target, bit 13 on a following error.
    """

    set_point = o.TARGET_POSITION

    def __init__(self, axis: AxisParts) -> None:
        self._demand: DemandCurve | None = None
        self._in_use = False
        super().__init__(axis)

    def reset(self) -> None:
        super().reset()
        self._in_use = False
        self._unseen = 0  # set-points since the last evaluation by the drive's own clock

    def start(self, now: int) -> None:
        self._in_use = True
        super().start(now)

    def take(self, now: int) -> None:
        """Apply the set-point in an RPDO; while the drive extrapolates or recovers SYNC, even an unchanged one."""
        self._unseen += 1
        if not self._drifts and (self.cycles or self._in_rhythm(now)):
            self._inputs = None
        super().take(now)

    def compared(self) -> float | None:
        return self.target()

    def count_missed(self) -> None:
        if not self._drifts:
            super().count_missed()

    def update(self, now: int) -> None:
        """Apply the target; the part of the move beyond the maximum velocity becomes a following error."""
        if not self._drifts:
            self._follow(now)
        elif "interpolate" not in self.mover.timers:
            self._evaluate(now)

    @property
    def _drifts(self) -> bool:
        """Whether the drive's clock runs at a different rate from the master's and does not follow SYNC."""
        locked = self.model.follows_sync and self.clock.sync_ns is not None
        return bool(self.clock.drift_ppm.value) and not locked

    def _evaluate(self, now: int) -> None:
        """Evaluate the target now, then once per period of the drive's own clock."""
        ppm = self.clock.drift_ppm.value
        if self.power.live and self._in_use and self._drifts:
            period = round(self.objects.interpolation_s * (1e9 - 1e3 * ppm)) or _MS
            self.mover.at("interpolate", now + period, self._evaluate)
            self._count_unseen()
            self._follow(now)

    def _count_unseen(self) -> None:
        """Count the set-points missed or overwritten since the last evaluation by a drifting clock."""
        unseen, self._unseen = self._unseen, 0
        if unseen and self.cycles:
            self._inputs = None
        if self.streaming:
            self.meter.missed += not unseen
            self.meter.overwritten += max(0, unseen - 1)

    def _follow(self, now: int) -> None:
        self.feed()
        self.go(self.target(), now)

    def go(self, set_point: float, now: int) -> None:
        """Move to `set_point` (user units) within the interpolation time, unless the target is unchanged."""
        target = self.limits.position(self.units.zero + set_point * self.units.position)
        if not self.changed(target):
            return
        position, seconds = self.mover.state(now)[0], self.objects.interpolation_s
        slack = 0.0
        if self._in_rhythm(now):
            seconds, slack = seconds - self.clock.rhythm.late_ns * 1e-9, self.clock.rhythm.slack_ns * 1e-9
        reach = self.model.max_velocity * seconds
        within = max(-reach, min(reach, target - position)) if seconds else target - position
        onward = self._onward(position + within, within / seconds, slack) if seconds and self.streaming else 0.0
        demand = linear_to(now, position, position + within, seconds, onward)
        self._demand = demand
        self.meter.follow(self.mover.demand, now)
        self.mover.run(demand, now)
        self.limits.check_following_error(target - position - within, now)

    def _in_rhythm(self, now: int) -> bool:
        clock = self.clock
        timed = self.model.recovers_sync and clock.sync_ns == now and self.streaming
        return timed and clock.rhythm.has_period(self.objects.interpolation_s)

    def _onward(self, position: float, velocity: float, slack: float) -> float:
        """Return the time in s for which the demand continues beyond the set-point, up to a position limit."""
        longest = max(self.cycles * self.objects.interpolation_s, slack)
        if not longest or not velocity:
            return 0.0
        low, high = self.limits.bounds()
        distance = high - position if velocity > 0.0 else low - position
        return max(0.0, min(longest, distance / velocity))

    def measured_velocity(self) -> float:
        """Return the plant's velocity in counts/s; after a move, the mean over the interpolation time."""
        mover, demand = self.mover, self.mover.demand
        if demand is not self._demand or mover.time < demand.end_ns or not mover.plant.stiff:
            return mover.plant.velocity
        seconds = self.objects.interpolation_s
        if not seconds:
            return mover.plant.velocity
        since = max(demand.start_ns, mover.time - round(seconds * 1e9))
        return (mover.plant.position - demand.at(since)[0]) / ((mover.time - since) * 1e-9)

    def target(self) -> float:
        """Return the set-point plus the position offset, in user units."""
        return float(self.objects.number(o.TARGET_POSITION) + self.objects.number(o.POSITION_OFFSET))

    def bits(self) -> int:
        """Return bits 12 and 13 of the statusword; bit 10 is reserved in CSP (CiA 402-2)."""
        return (BIT_12 if self.power.live and not self.limits.active else 0) | (BIT_13 if self.limits.exceeded else 0)


class CyclicVelocity(StreamMode):
    """Cyclic synchronous velocity mode (CSV): follow 0x60FF plus 0x60B1, with the accelerations 0x60C5 and 0x60C6.

    Without a new set-point the axis keeps its speed.
    """

    set_point = o.TARGET_VELOCITY

    def update(self, now: int) -> None:
        target = self.limits.target_velocity()
        unit = self.units.acceleration
        up = self.objects.number(o.MAX_ACCELERATION) * unit or INFINITE
        down = self.objects.number(o.MAX_DECELERATION) * unit or INFINITE
        self.mover.feed_forward(0.0, float(self.objects.number(o.TORQUE_OFFSET)))
        self.meter.follow(self.mover.demand, now)
        if self.changed((target, up, down, *self.limits.bounds())):
            self.limits.ramp_velocity(target, up, down, now)

    def bits(self) -> int:
        """Return bit 12 of the statusword while the axis follows the target."""
        return BIT_12 if self.power.live and not self.limits.active else 0


class Torque(StreamMode):
    """Torque modes TQ and CST: apply the limited sum of 0x6071 and 0x60B2, in TQ with the slope 0x6087, in CST at once.

    A motor that moves when the mode starts keeps its velocity at first.
    """

    def __init__(self, axis: AxisParts, *, cyclic: bool = False) -> None:
        super().__init__(axis)
        self._cyclic = cyclic
        self.set_point = o.TARGET_TORQUE if cyclic else 0

    def start(self, now: int) -> None:
        """Continue from the current motion with the target torque; only CST has set-point statistics."""
        self._begun = self._begun or not self._cyclic
        super().start(now)

    def update(self, now: int) -> None:
        target = self.limits.torque(self.objects.number(o.TARGET_TORQUE) + self.objects.number(o.TORQUE_OFFSET))
        slope = INFINITE if self._cyclic else float(self.objects.number(o.TORQUE_SLOPE)) or INFINITE
        if self.changed((target, slope)):
            present = self.mover.torque.at(now)[1] if self.mover.torque is not None else 0.0
            self.mover.apply_torque(ramp_to(now, 0.0, present, target, slope, slope), now)

    def bits(self) -> int:
        """Return bit 10 at the target torque (TQ), or bit 12 while the axis follows the target (CST)."""
        if self._cyclic:
            return BIT_12 if self.power.live else 0
        torque = self.mover.torque
        return REACHED if torque is not None and torque.end_ns <= self.mover.time else 0


# The interpolated position mode IP (7): set-points of 0x60C1, one at a time or from the buffer 0x60C4 (CiA 402-2, 12).
#
# Without a buffer IP is CSP with another set-point object and an enable bit. A dictionary that has 0x60C4 offers the
# buffer: writing 1 to 0x60C4:06 opens it; writing 0 closes and clears it, and it is closed after power-on. A record is
# appended to an open buffer by every RPDO that maps 0x60C1, and by every SDO write to the last subindex of 0x60C1; the
# drive uses one record in every interpolation period (0x60C2) while interpolation is enabled. A record beyond the
# capacity is refused. If the buffer runs empty, the axis reacts as its model does to a missing set-point, and continues
# with the next record at once. Only the linear sub mode 0 (0x60C0) and a first-in first-out buffer (0x60C4:03 = 0) are
# supported; only the position of a record is used, which is the first subindex by default.


MAXIMUM, SIZE, ORGANISATION, POSITION, _, CLEAR = range(1, 7)  # subindices of 0x60C4
_MAX_RECORDS: Final = 1024  # records, even if a file declares another type
_FIFO, _LINEAR = 0, 0


class SetPointBuffer:
    """Interpolation data buffer 0x60C4 of one axis, with the queued positions in user units."""

    def __init__(self, axis: AxisParts) -> None:
        self._objects = axis.objects
        self._waiting: deque[float] = deque()
        self.kept = False
        """Whether the records remain when the motor loses power or the mode changes."""
        store, shift = axis.objects.store, axis.objects.offset
        self.last_subindex = max(store.od.subindices(o.INTERPOLATION_DATA + shift), default=0)
        self._attach(store, shift)

    def _attach(self, store: VirtualStore, shift: int) -> None:
        buffer = o.INTERPOLATION_BUFFER + shift
        store.guard([o.INTERPOLATION_SUB_MODE + shift], _only_linear)
        store.guard([buffer], self._check)
        store.guard([o.INTERPOLATION_DATA + shift], self._check_buffer)
        store.on_write([buffer], self._written)
        store.on_read(buffer, POSITION, lambda: len(self._waiting))

    @property
    def open(self) -> bool:
        """Whether the buffer is open (0x60C4:06 is 1), so that records are queued."""
        return self._objects.number(o.INTERPOLATION_BUFFER, CLEAR) == 1

    @property
    def size(self) -> int:
        """Capacity in records: 0x60C4:02, or 0x60C4:01 if 0x60C4:02 is 0; at most 0x60C4:01."""
        maximum = min(self._objects.number(o.INTERPOLATION_BUFFER, MAXIMUM), _MAX_RECORDS)
        return min(self._objects.number(o.INTERPOLATION_BUFFER, SIZE) or maximum, maximum)

    def put(self, position: float) -> None:
        """Append a record; a full buffer drops it."""
        if len(self._waiting) < self.size:
            self._waiting.append(position)

    def __len__(self) -> int:
        return len(self._waiting)

    def get(self) -> float | None:
        """Remove and return the oldest record, or None if the buffer is empty."""
        return self._waiting.popleft() if self._waiting else None

    def clear(self) -> None:
        self._waiting.clear()

    def _check(self, entry: Entry, value: Value) -> Value:
        number = value if isinstance(value, int) else 0
        if entry.subindex == SIZE and number > self._objects.number(o.INTERPOLATION_BUFFER, MAXIMUM):
            raise SdoServerAbort(AbortCode.VALUE_TOO_HIGH)
        if (entry.subindex == ORGANISATION and number != _FIFO) or (entry.subindex == CLEAR and number > 1):
            raise SdoServerAbort(AbortCode.INVALID_VALUE)
        return value

    def _check_buffer(self, entry: Entry, value: Value) -> Value:
        if entry.subindex == self.last_subindex and self.open and len(self._waiting) >= self.size:
            raise SdoServerAbort(AbortCode.OUT_OF_MEMORY)
        return value

    def _written(self, entry: Entry, value: Value) -> None:
        if entry.subindex == CLEAR and value == 0:
            self.clear()


def _only_linear(_entry: Entry, value: Value) -> Value:
    if value != _LINEAR:
        raise SdoServerAbort(AbortCode.INVALID_VALUE)
    return value


class InterpolatedPosition(CyclicPosition):
    """Interpolated position mode (IP, linear): CSP with set-points from 0x60C1 or the buffer, enabled by bit 4."""

    set_point = o.INTERPOLATION_DATA

    def __init__(self, axis: AxisParts) -> None:
        self.buffer = SetPointBuffer(axis)
        self.position_subindex = 1  # subindex in the data record
        super().__init__(axis)

    def reset(self) -> None:
        super().reset()
        if not self.buffer.kept:
            self.buffer.clear()
        self._dry_ns: int | None = None  # when a record was due but the buffer was empty

    @property
    def _enabled(self) -> bool:
        return bool(self.power.controlword & NEW_SET_POINT)

    def update(self, now: int) -> None:
        """Apply the set-point if interpolation is enabled.

        With an open buffer this starts the first record; the buffer then continues by itself.
        """
        if not self._enabled:
            return
        if not self.buffer.open:
            super().update(now)
        elif len(self.buffer) and "interpolate" not in self.mover.timers:
            self._next(now)

    def count_missed(self) -> None:
        if not self.buffer.open:
            super().count_missed()

    def take(self, now: int) -> None:
        """Apply the set-point in an RPDO, or append it to an open buffer."""
        if not self.buffer.open:
            super().take(now)
        else:
            self.record_written(now)

    def record_written(self, now: int) -> None:
        """Append the data record 0x60C1 to an open buffer."""
        if self.buffer.open:
            self.buffer.put(self.target())
            self.update(now)

    def _next(self, now: int) -> None:
        """Move to the next position in the buffer, and schedule the one after."""
        if not (self.power.live and self._in_use and self._enabled and self.buffer.open):
            return
        set_point = self.buffer.get()
        if set_point is None:
            self._dry_ns = now if self.streaming else None
            return
        if self._dry_ns is not None:
            self.meter.missed += round((now - self._dry_ns) / self.period_ns)
            self._dry_ns = None
        self._arrived += 1
        self.meter.take(set_point, now)
        self.feed()
        self._inputs = None
        self.go(set_point, now)
        self.supervise(now)
        self.mover.at("interpolate", now + self.period_ns, self._next)

    def target(self) -> float:
        """Return the position in the data record 0x60C1, in user units."""
        return float(self.objects.number(o.INTERPOLATION_DATA, self.position_subindex))

    def control(self, word: int, previous: int, now: int) -> None:
        """Stop the axis when bit 4 of the controlword disables interpolation."""
        if previous & ~word & NEW_SET_POINT:
            self._inputs = None
            self.mover.cancel("interpolate")
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self) -> int:
        """Return bit 12 of the statusword while interpolation is active, and bit 10 at the set-point."""
        reached = self.mover.demand.end_ns <= self.mover.time
        return (BIT_12 if self._enabled and self.power.live else 0) | (REACHED if reached else 0)


MODES: dict[int, Callable[[AxisParts], Mode]] = {
    OperationMode.PP: ProfilePosition,
    OperationMode.VL: VelocityMode,
    OperationMode.PV: ProfileVelocity,
    OperationMode.TQ: Torque,
    OperationMode.HM: HomingMode,
    OperationMode.IP: InterpolatedPosition,
    OperationMode.CSP: CyclicPosition,
    OperationMode.CSV: CyclicVelocity,
    OperationMode.CST: partial(Torque, cyclic=True),
    OperationMode.CSTCA: partial(Torque, cyclic=True),
}
_VELOCITY_MODES: Final = frozenset({OperationMode.VL, OperationMode.PV, OperationMode.CSV})
_NEEDED: Final[dict[int, tuple[int, int]]] = {**TARGET_OBJECTS, OperationMode.HM: (o.HOMING_METHOD, 0)}


def possible_modes(objects: AxisObjects) -> int:
    """Return the default value of 0x6502: a bit for every mode whose objects are in the dictionary."""
    return sum(1 << (mode - 1) for mode, address in _NEEDED.items() if objects.has(*address))


class DriveModes:
    """Modes of operation of one axis: `number` is the active mode as in 0x6061, `active` its implementation.

    The mode changes only while all `conditions` hold; `gate` can block set-points. Injection points: `stuck` (the mode
    never changes), `delay_ns` (the delay of a change) and `homing.fails`.
    """

    def __init__(self, axis: AxisParts) -> None:
        self._axis = axis
        self._all = {number: make(axis) for number, make in MODES.items()}
        homing, interpolated = self._all[OperationMode.HM], self._all[OperationMode.IP]
        assert isinstance(homing, HomingMode)
        assert isinstance(interpolated, InterpolatedPosition)
        self.homing: HomingMode = homing
        self.interpolated: InterpolatedPosition = interpolated
        self._none = Mode(axis)
        self.number: int = 0
        self.active: Mode = self._none
        self.stuck: InjectionPoint[bool] = InjectionPoint(False)
        self.delay_ns: InjectionPoint[int] = InjectionPoint(0)
        self.conditions: tuple[Callable[[], bool], ...] = ()
        self.gate: ModeGate | None = None

    def add(self, number: int, like: int) -> None:
        """Add the manufacturer-specific mode `number`, which behaves like the standard mode `like`."""
        self._all[number] = MODES[like](self._axis)

    def remove(self, number: int) -> None:
        """Remove a mode added by `add`."""
        self._all.pop(number, None)

    @property
    def is_open(self) -> bool:
        """Whether set-points reach the active mode: there is no gate, or the gate is open."""
        return self.gate is None or not self.gate.closed_by

    def start(self, now: int) -> None:
        """Start the active mode from the current motion, or stop the axis while the gate is closed."""
        if self.is_open:
            self.active.start(now)
        else:
            self.active.stop(now, Reaction.SLOW_DOWN_RAMP)

    def control(self, word: int, previous: int, now: int) -> None:
        """Pass a controlword to the active mode if the gate and its filters permit."""
        if self.is_open and (self.gate is None or all(takes(word, previous, now) for takes in self.gate.takes)):
            self.active.control(word, previous, now)

    def set_model(self, model: DeviceModel) -> None:
        """Replace the device model in every mode."""
        for mode in (self._none, *self._all.values()):
            mode.set_model(model)

    def clear(self) -> None:
        """Select no mode (0), as after power-on."""
        self.number, self.active = 0, self._none

    def reset(self) -> None:
        """Reset every mode after the motor has lost power."""
        for mode in self._all.values():
            mode.reset()

    def select(self, now: int) -> None:
        """Activate the mode in 0x6060, in any state; an enabled axis continues from the current motion."""
        mover, delay = self._axis.mover, self.delay_ns.value
        if self.stuck.value or (self.conditions and not all(holds() for holds in self.conditions)):
            return
        if not delay:
            self._take(now)
        elif "mode" not in mover.timers:  # a repeated write does not restart a delayed change
            mover.at("mode", now + delay, self._take)

    def _take(self, now: int) -> None:
        axis = self._axis
        number = axis.objects.number(o.MODES_OF_OPERATION)
        if number != self.number:
            axis.outbox.publish(ModeChanged(axis.objects.axis, number))
        self.active.reset()
        axis.mover.cancel("homing", "window")
        axis.mover.velocity_mode = number in _VELOCITY_MODES and not axis.objects.model.ramps_positions
        self.number, self.active = number, self._all.get(number, self._none)
        if axis.power.running and not axis.power.halted:
            self.start(now)
        axis.outbox.values_changed()
