"""Mechanics of the drives: motor and load of each axis (`Plant`), and the simulation of all axes (`World`).

Both are Protocols, so that another engine can replace the built-in one: a world returns the plant of each axis once,
and then follows the commands of the drives. A plant moves from one time to another along the demand of the drive, in
closed form if the equation of motion has one, otherwise in fixed steps, so that the result does not depend on when
the plant is read. The quantities are counts, seconds and per mille of the rated torque; nothing depends on CANopen.
The position is the position of the motor, and homing does not change it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol, runtime_checkable

from canopen_control.rpc.messages.drive import WorldAct, WorldState

if TYPE_CHECKING:
    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.virtual.trajectory import DemandCurve, Piece


WORLD_NOTE: Final = "world: "
"""Prefix of the lines in which a drive process reports an assumption made by its world."""


class Plant(Protocol):
    """Mechanics of one axis; a call advances the plant from `start_ns` to `end_ns`, in monotonic ns."""

    position: float  # counts
    velocity: float  # counts/s
    torque: float  # per mille of the rated torque
    stiff: bool  # whether the position always equals the demand, so that it need not be read in between

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:
        """Move along the demand, as controlled by the position and velocity loops of a drive."""

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:
        """Move under the torque that the velocity of the curve `torque` gives, in per mille of the rated torque."""

    def release(self, start_ns: int, end_ns: int) -> None:
        """Move without power, and clear the feed-forward."""

    def feed_forward(self, velocity: float, torque: float) -> None:
        """Set the feed-forward of the control loops: 0x60B1 in counts/s and 0x60B2 in per mille."""


class ServoGains(NamedTuple):
    """Gains of the control loops of a drive.

    `velocity_p` is in per mille s/count, `velocity_i` in per mille/count, `position_p` in 1/s; `feed_forward` is a
    share of the demanded velocity.
    """

    velocity_p: float
    velocity_i: float
    position_p: float
    feed_forward: float


class AxisOwner(Protocol):
    """Axis of a drive as seen by the coupled plant: demand, limits and timers."""

    powered: bool
    torque: DemandCurve | None  # torque to apply, in per mille; None: follow `demand`
    demand: DemandCurve
    torque_limit: float  # torque limit of the drive in per mille of the rated torque
    velocity_mode: bool  # the loops follow only the velocity of the demand
    gains: ServoGains | None  # gains of the drive's loops; None: the loops are tuned automatically

    def advance(self, now: int) -> None:
        """Advance the axis to `now`, calling each timer at its due time."""

    def next_event(self) -> int | None:
        """Return the time in ns of the next timer, or None if no timer is set."""


@runtime_checkable
class CoupledPlant(Plant, Protocol):
    """Plant in a world that moves all axes together and may read the demand of a drive at any time."""

    rated_torque: float  # Nm, or N
    follow_ns: int  # period at which the drive checks position and load, without a timer of its own

    def set_owner(self, owner: AxisOwner) -> None:
        """Set the axis whose demand the plant follows; called once."""


def _lag(velocity: float, piece: Piece, time_constant: float) -> tuple[float, float]:
    """Return the distance and the final velocity if the velocity follows a piece with a first-order lag."""
    seconds, demand, slope = piece
    decay = math.exp(-seconds / time_constant)
    offset = velocity - demand + slope * time_constant
    settled = (demand - slope * time_constant + 0.5 * slope * seconds) * seconds
    distance = settled + time_constant * offset * (1.0 - decay)
    return distance, demand + slope * (seconds - time_constant) + offset * decay


def _push(plant: IdealPlant | LagPlant, torque: DemandCurve, start_ns: int, end_ns: int, time_constant: float) -> None:
    """Move a plant towards the velocity that corresponds to the torque, with a first-order lag."""
    gain = plant.rated_velocity / 1000.0
    for piece in torque.slices(start_ns, end_ns):
        scaled = piece._replace(velocity=piece.velocity * gain, acceleration=piece.acceleration * gain)
        distance, plant.velocity = _lag(plant.velocity, scaled, time_constant)
        plant.position += distance
    plant.torque = torque.at(end_ns)[1]


@dataclass(slots=True)
class IdealPlant:
    """Plant that is always at the demanded position and stops at once without power, like a small stepper.

    In the torque modes the plant is a mass with viscous friction: `rated_velocity` is the final velocity at rated
    torque, and `torque_time_constant` the time constant of the approach to that velocity.
    """

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    rated_velocity: float = 50_000.0  # counts/s
    torque_time_constant: float = 0.05  # s
    stiff: bool = True

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:  # noqa: ARG002 # the end is enough
        self.position, self.velocity = demand.at(end_ns)
        self.torque = 0.0

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:
        _push(self, torque, start_ns, end_ns, self.torque_time_constant)

    def release(self, start_ns: int, end_ns: int) -> None:  # noqa: ARG002 # a standstill needs no times
        self.velocity = self.torque = 0.0

    def feed_forward(self, velocity: float, torque: float) -> None:
        """Do nothing, since the plant has no following error."""


@dataclass(slots=True)
class LagPlant:
    """Plant whose velocity follows the demand with a time constant, and decays without power.

    The position error while moving is `time_constant` times the velocity, and 0 at standstill, as with a proportional
    position loop. A velocity fed forward bypasses that loop, so that only the rest of the velocity causes an error.
    """

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    time_constant: float = 0.01  # s
    coast_time_constant: float = 0.1  # s
    rated_velocity: float = 50_000.0  # counts/s at rated torque
    stiff: bool = False
    fed_velocity: float = 0.0  # counts/s, part of `velocity`

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:
        for piece in demand.slices(start_ns, end_ns):
            distance, self.velocity = _lag(self.velocity, piece, self.time_constant)
            self.position += distance
        self.torque = 0.0

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:
        _push(self, torque, start_ns, end_ns, self.coast_time_constant)

    def release(self, start_ns: int, end_ns: int) -> None:
        decay = math.exp(-(end_ns - start_ns) * 1e-9 / self.coast_time_constant)
        self.position += self.velocity * self.coast_time_constant * (1.0 - decay)
        self.velocity = 0.0 if abs(self.velocity) < 1e-3 else self.velocity * decay
        self.torque = self.fed_velocity = 0.0

    def feed_forward(self, velocity: float, torque: float) -> None:  # noqa: ARG002 # a torque does not reduce the lag
        """Add the change of the feed-forward to the velocity at once; the velocity loop corrects an excess."""
        self.velocity += velocity - self.fed_velocity
        self.fed_velocity = velocity


@dataclass(slots=True)
class LoadedPlant:
    """Motor with torque limit, inertia, friction, external torque, backlash and stall, simulated in fixed steps.

    Torques are in per mille of the rated torque. The rated torque accelerates the unloaded motor by `acceleration`
    counts/s^2; a load of `inertia` divides that by 1 + inertia. `external` acts in the positive direction (gravity on a
    vertical axis), `friction` against the motion. The position is that of the motor: with a `backlash` the load
    (`load_position`) is up to half of that many counts behind or ahead. `stalled` blocks the shaft. The velocity loop
    gets the output of the position loop plus a feed-forward: the fraction `velocity_feed_forward` of the demanded
    velocity, or the velocity 0x60B1 unless that is 0.
    """

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    acceleration: float = 1_000_000.0
    torque_limit: float = 2000.0
    inertia: float = 0.0
    friction: float = 20.0
    viscosity: float = 0.001  # per mille of torque for each count/s
    external: float = 0.0
    backlash: float = 0.0
    stalled: bool = False
    position_gain: float = 100.0  # 1/s
    velocity_feed_forward: float = 1.0
    velocity_time_constant: float = 0.002  # s
    load_position: float = 0.0
    stiff: bool = False
    fed_velocity: float = 0.0
    fed_torque: float = 0.0
    _STEP_NS = 500_000

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:
        for clock in self._steps(start_ns, end_ns):
            position, velocity = demand.at(clock)
            fed = self.fed_velocity or velocity * self.velocity_feed_forward
            target = fed + self._correction(position - self.position)
            effort = (target - self.velocity) / self.velocity_time_constant + demand.acceleration_at(clock)
            need = effort * self._mass() + self.viscosity * self.velocity - self.external + self.fed_torque
            need += math.copysign(self.friction, target) if target else 0.0
            self._step(max(-self.torque_limit, min(self.torque_limit, need)))

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:
        for clock in self._steps(start_ns, end_ns):
            self._step(max(-self.torque_limit, min(self.torque_limit, torque.at(clock)[1])))

    def release(self, start_ns: int, end_ns: int) -> None:
        self.feed_forward(0.0, 0.0)
        for _ in self._steps(start_ns, end_ns):
            self._step(0.0)

    def feed_forward(self, velocity: float, torque: float) -> None:
        self.fed_velocity, self.fed_torque = velocity, torque

    def _steps(self, start_ns: int, end_ns: int) -> range:
        """Return the end times of the steps between two times, on a fixed grid."""
        step = self._STEP_NS
        return range((start_ns // step + 1) * step, end_ns + 1, step)

    def _correction(self, error: float) -> float:
        """Return the velocity that corrects a position error, low enough for a stop within the torque limit.

        Without that bound a motor that is too weak for its load would oscillate between both torque limits forever.
        """
        braked = math.sqrt(self.torque_limit / self._mass() * abs(error))  # at half of the limit
        return max(-braked, min(braked, self.position_gain * error))

    def _mass(self) -> float:
        """Return the torque in per mille for an acceleration of 1 count/s^2."""
        return 1000.0 * (1.0 + self.inertia) / self.acceleration

    def _step(self, torque: float) -> None:
        self.torque = torque
        seconds = self._STEP_NS * 1e-9
        driving = torque + self.external - self.viscosity * self.velocity
        before = self.velocity
        if self.stalled or (before == 0.0 and abs(driving) <= self.friction):
            self.velocity = 0.0
            return
        friction = math.copysign(self.friction, before or driving)
        after = before + (driving - friction) / self._mass() * seconds
        # Friction can stop a motion but never reverse it.
        self.velocity = 0.0 if before * after < 0.0 and abs(driving) <= self.friction else after
        self.position += 0.5 * (before + self.velocity) * seconds
        half = 0.5 * self.backlash
        self.load_position = max(self.position - half, min(self.position + half, self.load_position))


class World(Protocol):
    """Simulation of all axes of a process; creates the plant of each axis."""

    period_ns: int | None
    """Period in ns at which every axis is advanced even without an event; None if not needed."""

    def plant(self, node_id: int, axis: int) -> Plant:
        """Return the plant of an axis; called once for every axis."""

    def describe(self) -> WorldState:
        """Return the state other than that of the axes, such as the true pose of a base."""

    def close(self) -> None:
        """Release files and other resources of the world."""


@runtime_checkable
class ReportsAssumptions(World, Protocol):
    """World that reports the assumptions made when it was built, as sentences in `notes`."""

    notes: tuple[str, ...]


@runtime_checkable
class HasScenery(World, Protocol):
    """World with shapes that are not part of a robot."""

    def shapes(self) -> tuple[WorldShape, ...]:
        """Return the shapes of the scenery at their current poses."""


class SharedWorld(ReportsAssumptions, Protocol):
    """World shared by several buses of one robot or of several robots."""

    def side(self, robot: str, bus: str = "") -> World:
        """Return the part of the world for a robot's drives on one bus; raise KeyError for an unknown robot."""


@runtime_checkable
class AcceptsEvents(World, Protocol):
    """World to which disturbances can be applied, such as a payload, a push or a blocked joint."""

    def act(self, world_act: WorldAct) -> None:
        """Apply a disturbance now; raise ConfigError for an unknown link or joint."""


class IndependentPlants:
    """World of ideal plants that do not affect each other."""

    period_ns: int | None = None

    def plant(self, node_id: int, axis: int) -> Plant:  # noqa: ARG002 # all plants are alike
        return IdealPlant()

    def describe(self) -> WorldState:
        return WorldState()

    def close(self) -> None:
        """Do nothing, since there are no resources to release."""
