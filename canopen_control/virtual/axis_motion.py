"""Motion of one axis over time: timers, demand, the plant that follows it, switches and servo loops.

Time moves from event to event. `advance` processes each timer at its own time and in order, so that the result does not
depend on the number of calls. A demand is set at an event and followed until the next event. The end of a demand, a
limit switch and a following error are reported to the owner through `Reactions`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from canopen_control.cia402 import objects as o
from canopen_control.cia402.units import is_feed, rpm_of_unit
from canopen_control.virtual.plant import CoupledPlant
from canopen_control.virtual.trajectory import DemandCurve, cruise, hold

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.od.model import Value
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.plant import Plant, ServoGains


# Objects of one axis, and its user units in counts of the plant (CiA 402-2, 6.3, 7).
#
# Without a feed constant (0x6092), or with one of 1/1, the user's unit is the count; otherwise counts = user * encoder
# resolution (0x608F) * gear ratio (0x6091) / feed constant, without the factors whose object is missing. 0x6096 and
# 0x6097 scale velocities and accelerations in addition; with 0x60A9 the unit can be rpm. Bits 7 and 6 of 0x607E invert
# positions and velocities. A zero counts as one: no object may cause a division by zero. Internal positions are the
# plant's; positions in user units are relative to `zero`, which homing changes.


UNIT_OBJECTS = (
    o.POLARITY,
    o.POSITION_ENCODER_RESOLUTION,
    o.GEAR_RATIO,
    o.FEED_CONSTANT,
    o.VELOCITY_FACTOR,
    o.ACCELERATION_FACTOR,
    o.SI_UNIT_VELOCITY,
)
_TURN_POSITION, _TURN_VELOCITY = 1 << 7, 1 << 6


def wrap32(value: float) -> int:
    """Return `value` rounded and wrapped to a signed 32-bit integer."""
    return (round(value) + 0x80000000 & 0xFFFFFFFF) - 0x80000000


class DriveUnits:
    """Factors between user units and plant counts.

    `position` and `velocity` are signed counts per user unit; `length`, `speed` and `acceleration` are unsigned.
    `turn` is -1 if 0x607E inverts velocities, else 1, for velocities in rpm. `zero` is the plant position of the user's
    0.
    """

    def __init__(self) -> None:
        self.position = self.velocity = self.length = self.speed = self.acceleration = self.turn = 1.0
        self.zero = 0.0
        self.own_speed = 1.0  # counts/s of a velocity unit that no object describes (a quirk)
        self.own_ramp = 1.0  # velocity units per s in a unit of ramps that no object describes (a quirk)

    def update(self, objects: AxisObjects) -> None:
        polarity = objects.number(o.POLARITY)
        self.length = 1.0
        feed = objects.number(o.FEED_CONSTANT, 1, 1) or 1, objects.number(o.FEED_CONSTANT, 2, 1) or 1
        if is_feed(feed):
            resolution, gear = objects.ratio(o.POSITION_ENCODER_RESOLUTION), objects.ratio(o.GEAR_RATIO)
            self.length = resolution * gear / objects.ratio(o.FEED_CONSTANT)
        factor = objects.ratio(o.VELOCITY_FACTOR)
        own_factor = self.own_speed if not objects.speed_unit and factor == 1.0 else 1.0
        per_second = (objects.speed_unit or self.length) * own_factor
        self.speed = per_second / factor
        self.acceleration = per_second * self.own_ramp / objects.ratio(o.ACCELERATION_FACTOR)
        self.turn = -1.0 if polarity & _TURN_VELOCITY else 1.0
        self.position = -self.length if polarity & _TURN_POSITION else self.length
        self.velocity = self.turn * self.speed

    def user(self, position: float) -> int:
        """Convert a plant position to user units, wrapped to 32 bits."""
        return wrap32((position - self.zero) / self.position)

    def lose_counts(self, counts: float) -> None:
        """Shift the position in user units by `counts`, as if encoder counts had been lost (a fault)."""
        self.zero -= counts


class AxisObjects:
    """Access to the objects of one axis in `store`, addressed by their indices on axis 0."""

    def __init__(self, store: VirtualStore, axis: int, model: DeviceModel) -> None:
        self.axis, self.store, self.model = axis, store, model
        self.offset = o.axis_index(o.CONTROLWORD, axis) - o.CONTROLWORD
        self.units = DriveUnits()
        self._values = store.values

    def number(self, index: int, subindex: int = 0, default: int = 0) -> int:
        """Return the value of an integer object; `default` if missing or of another type."""
        value = self._values.get((index + self.offset, subindex), default)
        return value if isinstance(value, int) else default

    def has(self, index: int, subindex: int = 0) -> bool:
        return (index + self.offset, subindex) in self._values

    def set(self, index: int, value: Value) -> None:
        """Set an object without checks, like the firmware of a drive; no effect if it is missing."""
        self.store.set(index + self.offset, 0, value)

    def ramp(self, index: int) -> float:
        """Return an acceleration object in counts/s^2, or the device model's `unset_ramp` if missing or 0."""
        return self.number(index) * self.units.acceleration or self.model.unset_ramp

    def speed(self, index: int, subindex: int = 0) -> float:
        """Return an unsigned velocity object in counts/s."""
        return self.number(index, subindex) * self.units.speed

    def length(self, index: int) -> float:
        """Return an unsigned distance object in counts."""
        return self.number(index) * self.units.length

    def ratio(self, index: int) -> float:
        """Return subindex 1 of an object divided by subindex 2; missing and zero values count as 1."""
        return float(self.number(index, 1, 1) or 1) / float(self.number(index, 2, 1) or 1)

    @property
    def counts_per_rpm(self) -> float:
        """Encoder counts per second at 1 rpm."""
        counts = self.number(o.POSITION_ENCODER_RESOLUTION, 1) or self.model.counts_per_revolution
        return counts / max(1, self.number(o.POSITION_ENCODER_RESOLUTION, 2, 1)) / 60.0

    @property
    def speed_unit(self) -> float:
        """Velocity unit 0x60A9 in counts/s; 0 unless the unit is rpm times a power of ten."""
        return self.counts_per_rpm * rpm_of_unit(self.number(o.SI_UNIT_VELOCITY))

    @property
    def interpolation_s(self) -> float:
        """Interpolation time 0x60C2 in s."""
        exponent = max(-9, min(1, self.number(o.INTERPOLATION_TIME_PERIOD, 2, -3)))
        return float(self.number(o.INTERPOLATION_TIME_PERIOD, 1, 1) * 10.0**exponent)


# Simulated switches and index pulse of an axis, at fixed plant positions.
#
# A switch is active depending on the plant position. Limit switches are used only by homing, unless they are `wired`:
# then they stop every motion.


NEGATIVE, POSITIVE, HOME = 1, 2, 4  # 0x60FD
_LIMIT, _HOME_LOW, _HOME_HIGH = 50_000.0, 10_000.0, 12_000.0
_OUT_OF_REACH = 1e12


@dataclass(slots=True)
class Switches:
    """Positions of the switches in plant counts; the home switch is active from `home_low` to `home_high`.

    The index pulse repeats every `index_period`. The limit switches are used by homing, or stop every motion if
    `wired`.
    """

    negative: float = -_LIMIT
    positive: float = _LIMIT
    home_low: float = _HOME_LOW
    home_high: float = _HOME_HIGH
    index_period: float = 4096.0
    wired: bool = False
    homing: bool = False

    def inputs(self, position: float) -> int:
        """Return bits 0 to 2 of 0x60FD (negative limit, positive limit, home); 0 while no switch is used."""
        if not (self.wired or self.homing):
            return 0
        home = HOME if self.home_low <= position <= self.home_high else 0
        return home | (NEGATIVE if position <= self.negative else 0) | (POSITIVE if position >= self.positive else 0)

    def next_hit(self, demand: DemandCurve, now: int) -> int | None:
        """Return the time at which `demand` reaches a wired limit switch, or None if never."""
        if not self.wired:
            return None
        position = demand.at(now)[0]
        if self.negative < position < self.positive:
            times = [demand.time_of(switch, now) for switch in (self.negative, self.positive)]
            return min((time for time in times if time is not None), default=None)
        return None

    def bounds(self, position: float) -> tuple[float, float]:
        """Return the lowest and highest allowed position; an active wired limit switch blocks one direction."""
        if not self.wired:
            return -float("inf"), float("inf")
        low = position if position <= self.negative else -float("inf")
        high = position if position >= self.positive else float("inf")
        return low, high

    # -- injection of faults

    def close_positive(self, position: float) -> None:
        """Wire the limit switches and place the positive limit switch at `position` (a fault)."""
        self.wired, self.positive, self.negative = True, position, -_OUT_OF_REACH

    def open_positive(self) -> None:
        """Undo `close_positive`; the limit switches are then used only for homing."""
        self.wired, self.positive, self.negative = False, _LIMIT, -_LIMIT

    def place(self, *, reachable: bool) -> None:
        """Move the switches to their normal positions, or out of reach of homing (a fault)."""
        far = 0.0 if reachable else _OUT_OF_REACH
        self.negative, self.positive = -_LIMIT - far, _LIMIT + far
        self.home_low, self.home_high = _HOME_LOW + far, _HOME_HIGH + far


# Control loops of a virtual servo with gains from objects: position P and feed-forward over velocity PI.
#
# The torque is computed at each point of a fixed grid and kept until the next point, so that the result does not depend
# on when it is read. In velocity modes the position loop is off, as in servo drives. Units are counts, counts/s and per
# mille of the rated torque.


PERIOD_NS: Final = 500_000
_PERIOD_S: Final = PERIOD_NS * 1e-9


class VelocityLoop:
    """Position P loop around a velocity PI loop, with `gains` and the feed-forward `fed` (0x60B1, 0x60B2)."""

    def __init__(self, gains: ServoGains) -> None:
        self.gains = gains
        self.fed = (0.0, 0.0)
        self._integral = self._torque = 0.0

    def rest(self, torque: float = 0.0) -> None:
        """Restart the loop at `torque` without feed-forward."""
        self._integral = self._torque = torque
        self.fed = (0.0, 0.0)

    def follow(
        self, plant: Plant, demand: DemandCurve, start_ns: int, end_ns: int, limit: float, *, velocity_only: bool
    ) -> None:
        """Move a plant along a demand with a torque of at most `limit` per mille."""
        clock = start_ns
        for point in range((start_ns // PERIOD_NS + 1) * PERIOD_NS, end_ns + 1, PERIOD_NS):
            self._push(plant, clock, point)
            position, velocity = demand.at(point)
            fed_velocity = self.fed[0] or (velocity if velocity_only else velocity * self.gains.feed_forward)
            if not velocity_only:
                fed_velocity += self.gains.position_p * (position - plant.position)
            self._control(fed_velocity - plant.velocity, limit, plant)
            clock = point
        self._push(plant, clock, end_ns)

    def _push(self, plant: Plant, start_ns: int, end_ns: int) -> None:
        if end_ns > start_ns:
            plant.apply_torque(cruise(start_ns, 0.0, self._torque), start_ns, end_ns)

    def _control(self, error: float, limit: float, plant: Plant) -> None:
        """Compute the torque until the next point; the integrator stops while the torque is limited."""
        gains = self.gains
        effort = gains.velocity_p * error + self._integral + self.fed[1]
        limited = max(-limit, min(limit, effort))
        bounded = limited != effort or abs(plant.torque) < abs(self._torque) * (1.0 - 1e-9)
        if not bounded or error * effort < 0.0:
            self._integral += gains.velocity_i * error * _PERIOD_S
        self._torque = limited


_MS = 1_000_000
SAMPLE_NS = 5 * _MS  # period in which event-driven TPDOs are checked during a motion
FOLLOW_NS = _MS  # period of the following error checks of a lagging plant


class Reactions(Protocol):
    """Callbacks for events of the motion, implemented by the owner of an axis."""

    def arrived(self, now: int) -> None:
        """Handle the end of the demand."""

    def limit_switch_hit(self, side: int, now: int) -> None:
        """Handle a wired limit switch that has become active; `side` is -1 (negative) or 1 (positive)."""

    def check_following_error(self, error: float, now: int) -> None:
        """Check a following error in counts; called periodically while the plant lags."""

    def check_load(self, torque: float, now: int) -> None:
        """Check the torque (per mille of the rated torque) of a powered motor with a coupled plant."""

    def on_sample(self) -> None:
        """Check event-driven TPDOs for changed feedback; called periodically during a motion."""

    def wants_samples(self) -> bool:
        """Whether an event-driven TPDO contains values that change with the motion."""

    def next_index(self, demand: DemandCurve, now: int) -> tuple[int, float] | None:
        """Return the time and position of the next index pulse that a touch probe will capture, or None if none."""

    def index_passed(self, position: float) -> None:
        """Handle an index pulse; `position` is in plant counts."""


class AxisMotion:
    """Motion of one axis, and the timers of motion events; positions are in plant counts."""

    def __init__(self, plant: Plant, owner: Reactions) -> None:
        self.plant, self.owner = plant, owner
        self.switches = Switches()
        self.demand: DemandCurve = hold(0, plant.position)
        self.torque: DemandCurve | None = None  # torque to apply; None: the plant follows `demand`
        self.powered = False
        self.now: int | None = None  # None: not started
        self.torque_limit = math.inf  # per mille; used by a coupled plant and by `loop`
        self.loop: VelocityLoop | None = None  # control loops with gains; None: the plant follows the demand by itself
        self.gains: ServoGains | None = None
        self.velocity_mode = False  # the loops (with gains or in a world) follow only the velocity, not the position
        self._fed = (0.0, 0.0)
        self.timers: dict[str, tuple[int, Callable[[int], None]]] = {}
        self._coupled = plant if isinstance(plant, CoupledPlant) else None
        if self._coupled is not None:
            self._coupled.set_owner(self)

    # -- timers

    def at(self, name: str, due_ns: int, callback: Callable[[int], None]) -> None:
        """Call `callback` once at `due_ns`; an earlier timer with the same name is replaced."""
        self.timers[name] = (due_ns, callback)

    def cancel(self, *names: str) -> None:
        """Cancel timers; names without a timer have no effect."""
        for name in names:
            self.timers.pop(name, None)

    def advance(self, now: int) -> None:
        """Advance the axis to `now`, calling each timer at its due time."""
        while self._rings(now):
            name, (deadline, callback) = min(self.timers.items(), key=_deadline_of)
            del self.timers[name]
            self._move(deadline)
            callback(deadline)
        if now != self.now:
            self._move(now)

    def _rings(self, now: int) -> bool:
        for deadline, _ in self.timers.values():  # noqa: SIM110 - most often there are none or one
            if deadline <= now:
                return True
        return False

    def next_event(self) -> int | None:
        """Return the time in ns of the next timer, or None if no timer is set."""
        return min([deadline for deadline, _ in self.timers.values()]) if self.timers else None

    def next_deadline(self) -> int | None:
        """Return the time in ns at which `advance` is next due, or None if no timer is set.

        The checks of a coupled plant on its fixed grid are not counted: the next call of `advance` makes up for them.
        """
        if self._coupled is None:
            return self.next_event()
        return min((deadline for name, (deadline, _) in self.timers.items() if name != "follow"), default=None)

    def _move(self, now: int) -> None:
        start = self.now
        if start is None or now <= start:
            self.now = max(now, start or 0)
            return
        self.now = now
        if not self.powered:
            self.plant.release(start, now)
        elif self.torque is not None:
            self.plant.apply_torque(self.torque, start, now)
        elif self.loop is not None:
            limit, only = self.torque_limit, self.velocity_mode
            self.loop.follow(self.plant, self.demand, start, now, limit, velocity_only=only)
        else:
            self.plant.follow(self.demand, start, now)

    def set_loop(self, gains: ServoGains | None, now: int) -> None:
        """Set the gains of the control loops; without gains the plant follows the demand directly.

        A coupled plant has loops of its own, which use `gains`.
        """
        self._move(now)
        self.gains = gains
        if gains is None or self._coupled is not None:
            self.loop = None
        elif self.loop is None:
            self.loop = VelocityLoop(gains)
        else:
            self.loop.gains = gains

    @property
    def time(self) -> int:
        """Time in ns to which the axis has been advanced, or 0 before the first call."""
        return self.now or 0

    # -- motion

    @property
    def at_standstill(self) -> bool:
        """Whether the speed of the plant is below 0.5 counts/s."""
        return abs(self.plant.velocity) < 0.5

    def state(self, now: int) -> tuple[float, float]:
        """Return the position and velocity from which a new demand starts."""
        if self.torque is not None or not self.powered:
            return self.plant.position, self.plant.velocity
        position, velocity = self.demand.at(now)
        return (self.plant.position if self._drifts else position), velocity

    @property
    def _drifts(self) -> bool:
        """Whether the plant follows only the velocity of the demand, not the position."""
        return self.velocity_mode and (self.loop is not None or self._coupled is not None)

    def power(self, on: bool, now: int) -> None:
        """Switch the power stage on or off, and set the demand to the plant's current position."""
        self._move(now)
        self.cancel("arrive", "follow", "switch", "index", "interpolate", "set point", "following error")
        self.powered, self.torque, self._fed = on, None, (0.0, 0.0)
        if not on:
            self.plant.release(now, now)
        if self.loop is not None:
            self.loop.rest()
        self.demand = hold(now, self.plant.position)

    def displace(self, distance: float, now: int) -> None:
        """Displace the plant and its position demand by `distance` counts."""
        self._move(now)
        self.plant.position += distance
        if not self.powered or self.torque is None:
            demand = self.demand
            self.demand = demand.shifted(distance)

    def run(self, demand: DemandCurve, now: int) -> None:
        """Follow `demand`; `arrived` is called at its end, or at once if there is no motion."""
        self._move(now)
        if self.loop is not None and self.torque is not None:
            self.loop.rest(self.torque.at(now)[1])
        self.torque, self.demand = None, demand
        if self.loop is None:
            self.plant.follow(demand, now, now)
        self._watch(now)
        if demand.end_ns > now:
            self.at("arrive", demand.end_ns, self.owner.arrived)
        else:
            self.cancel("arrive")
            self.owner.arrived(now)

    def feed_forward(self, velocity: float, torque: float) -> None:
        """Set the feed-forward of the control loops, in counts/s and per mille."""
        if (velocity, torque) != self._fed and self.powered:
            self._fed = velocity, torque
            if self.loop is not None:
                self.loop.fed = velocity, torque
            self.plant.feed_forward(velocity, torque)

    def apply_torque(self, torque: DemandCurve, now: int) -> None:
        """Apply a torque in per mille of the rated torque; `arrived` is called after the torque ramp."""
        self._move(now)
        self.torque = torque
        self.cancel("follow", "switch")
        self._watch(now)
        self.at("arrive", max(torque.end_ns, now + 1), self.owner.arrived)

    def _watch(self, now: int) -> None:
        if self._coupled is not None:
            self._evaluate_next(self._coupled, now)
        elif (self.loop is not None or not self.plant.stiff) and self.torque is None:
            self.at("follow", now + FOLLOW_NS, self._follow)
        hit = self.switches.next_hit(self.demand, now) if self.torque is None else None
        if hit is None:
            self.cancel("switch")
        else:
            self.at("switch", hit, self._hit_switch)
        self.watch_index(now)
        if "sample" not in self.timers and self.owner.wants_samples():
            self.at("sample", now + SAMPLE_NS, self._sample)

    def watch_index(self, now: int) -> None:
        """Set a timer for the next index pulse of the demand if a touch probe is waiting for one."""
        pulse = self.owner.next_index(self.demand, now) if self.torque is None else None
        if pulse is None:
            self.cancel("index")
        else:
            self.at("index", pulse[0], lambda then: self._index(pulse[1], then))

    def _index(self, position: float, now: int) -> None:
        self.owner.index_passed(position)
        self.watch_index(now)

    def _hit_switch(self, now: int) -> None:
        self.owner.limit_switch_hit(int(math.copysign(1.0, self.demand.at(now)[1])), now)

    def _follow(self, now: int) -> None:
        """Check the following error of a lagging plant periodically until demand and plant are at standstill."""
        if not self.powered or self.torque is not None:
            return
        position, velocity = self.demand.at(now)
        error = 0.0 if self._drifts else position - self.plant.position
        if not self._drifts:
            self.owner.check_following_error(error, now)
        if velocity or now < self.demand.end_ns or abs(error) >= 0.5 or not self.at_standstill:
            self.at("follow", now + FOLLOW_NS, self._follow)

    def _evaluate_next(self, plant: CoupledPlant, now: int) -> None:
        """Schedule the next check of a coupled plant, on a grid of `follow_ns`."""
        every = plant.follow_ns
        self.at("follow", (now // every + 1) * every, lambda then: self._evaluate(plant, then))

    def _evaluate(self, plant: CoupledPlant, now: int) -> None:
        if not self.powered:
            return
        if self.torque is None and not self._drifts:
            self.owner.check_following_error(self.demand.at(now)[0] - plant.position, now)
        self.owner.check_load(plant.torque, now)
        if self.powered:
            self._evaluate_next(plant, now)

    def _sample(self, now: int) -> None:
        self.owner.on_sample()
        moving = self.powered and (now < self.demand.end_ns or self.demand.final_velocity or self.torque is not None)
        if (moving or not self.at_standstill) and self.owner.wants_samples():
            self.at("sample", now + SAMPLE_NS, self._sample)


def _deadline_of(item: tuple[str, tuple[int, object]]) -> int:
    return item[1][0]
