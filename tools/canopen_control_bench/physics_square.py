"""robby in physics in simulated time, without a bus: a 2 m UMBmark square, and a long drive whose state is hashed.

Wheel trajectories are followed leg by leg in both directions; odometry is made of whole counts every 20 ms. Told is
where the robot ends in truth minus where odometry thinks that it is.

    python -m canopen_control_bench.physics_square SECONDS    # prints the hash of the state after a random drive
"""

from __future__ import annotations

import hashlib
import math
import random
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.calibration.base_link import Driven, WheelValues
from canopen_control.data_files import data_path
from canopen_control.physics.engine import make
from canopen_control.virtual.axis_motion import AxisMotion
from canopen_control.virtual.trajectory import hold, move_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.calibration.umbmark import SquarePath
    from canopen_control.physics.physics_world import PhysicsWorld
    from canopen_control.virtual.trajectory import DemandCurve


MS: Final = 1_000_000
LEFT, RIGHT = (3, 0), (2, 0)
RADIUS, TRACK, COUNTS = 0.035, 0.24, 1600.0
_PER_METRE: Final = COUNTS / (math.tau * RADIUS)
_SCALE: Final = COUNTS / math.tau
_CHECK_NS: Final = 20 * MS
_SPEED, _RAMP = 2200.0, 2200.0  # counts/s, 0.3 m/s
_MOTOR = "rated_torque: 0.5, peak_torque: 1.0, rotor_inertia: 5.0e-4, friction: 0.01, damping: 5.0e-4, encoder: 1000000"


@dataclass(frozen=True, slots=True)
class Ending:
    """True pose minus odometry at the end of a square, in m and rad."""

    x: float
    y: float
    heading: float

    @property
    def error(self) -> float:
        """The distance between both, in m."""
        return math.hypot(self.x, self.y)


@dataclass(frozen=True, slots=True)
class BelievedWheels:
    """The wheels as assumed by odometry, in m; robby's own are the default."""

    left: float = RADIUS
    right: float = RADIUS
    track: float = TRACK

    def counts(self, left: float, right: float) -> tuple[float, float]:
        """Return the counts for the travel of both wheels in m."""
        return left * COUNTS / (math.tau * self.left), right * COUNTS / (math.tau * self.right)

    def ways(self, left: float, right: float) -> tuple[float, float]:
        """Return the travel of both wheels in m for the given counts."""
        return left * math.tau * self.left / COUNTS, right * math.tau * self.right / COUNTS


class Leg:
    """The drive of one wheel: runs one leg after the other, in counts, at its share of the speed."""

    def __init__(self, legs: list[float], pace: float = 1.0) -> None:
        self.legs, self._pace = legs, pace
        self.axis: AxisMotion | None = None

    def arrived(self, now: int) -> None:
        """Start the next leg."""
        if self.legs and self.axis is not None:
            position, velocity = self.axis.state(now)
            target = position + self.legs.pop(0)
            speed, ramp = self._pace * _SPEED, self._pace * _RAMP
            self.axis.run(move_to(now, position, velocity, target, speed, ramp, ramp), now)

    def limit_switch_hit(self, side: int, now: int) -> None:
        """Do nothing: there are no limit switches."""

    def check_following_error(self, error: float, now: int) -> None:
        """Do nothing."""

    def check_load(self, torque: float, now: int) -> None:
        """Do nothing."""

    def on_sample(self) -> None:
        """Do nothing."""

    def wants_samples(self) -> bool:
        """Return False: nothing needs samples."""
        return False

    def next_index(self, demand: DemandCurve, now: int) -> tuple[int, float] | None:
        """Return None: there is no index pulse."""

    def index_passed(self, place: float) -> None:
        """Do nothing."""


def world_of(friction: float = 0.8) -> PhysicsWorld:
    """Return robby's world with the motors used for the figures."""
    urdf = data_path("config", "robby/robby.urdf.xacro")
    axes = "\n".join(
        f'  "{node}": {{joint: {side}_wheel_joint, scale_pos_to_dev: {sign * _SCALE}, {_MOTOR}}}'
        for (node, _), side, sign in ((LEFT, "left", -1), (RIGHT, "right", 1))
    )
    floor = f"floor: {{friction: {friction}, caster_friction: 0.02}}"
    with tempfile.TemporaryDirectory(prefix="bench-") as folder:
        path = Path(folder) / "physics.yml"
        path.write_text(f"engine: mujoco\nurdf: {urdf}\n{floor}\naxes:\n{axes}\n")
        return make(path)


def _axes(world: PhysicsWorld, legs: dict[tuple[int, int], Leg]) -> dict[tuple[int, int], AxisMotion]:
    movers = {}
    for key, owner in legs.items():
        movers[key] = owner.axis = AxisMotion(world.plant(*key), owner)
    for mover in movers.values():
        mover.advance(0)
    for mover in movers.values():
        mover.power(True, 0)
    return movers


def square(
    direction: int, friction: float = 0.8, side: float = 2.0, wheels: BelievedWheels = BelievedWheels()
) -> Ending:
    """Drive the square once with the assumed wheels; direction 1 is counter-clockwise."""
    world = world_of(friction)
    turn = direction * math.pi / 2 * wheels.track / 2
    straight_counts, turn_counts = wheels.counts(side, side), wheels.counts(-turn, turn)
    pace = wheels.counts(1.0, 1.0)
    movers = _axes(
        world,
        {
            LEFT: Leg([-leg for _ in range(4) for leg in (straight_counts[0], turn_counts[0])], pace[0] / _PER_METRE),
            RIGHT: Leg([leg for _ in range(4) for leg in (straight_counts[1], turn_counts[1])], pace[1] / _PER_METRE),
        },
    )
    for mover in movers.values():
        mover.run(hold(0, mover.plant.position), 0)
    now, x, y, heading, last = 0, 0.0, 0.0, 0.0, (0, 0)
    origin = world.describe().base
    assert origin is not None
    while any(mover.owner.legs or now < mover.demand.end_ns + 500 * MS for mover in movers.values()):  # type: ignore[attr-defined] # a Leg
        now += _CHECK_NS
        for mover in movers.values():
            mover.advance(now)
        counts = (math.floor(-movers[LEFT].plant.position), math.floor(movers[RIGHT].plant.position))
        left, right = wheels.ways(counts[0] - last[0], counts[1] - last[1])
        last = counts
        middle = heading + 0.5 * (right - left) / wheels.track
        x += 0.5 * (left + right) * math.cos(middle)
        y += 0.5 * (left + right) * math.sin(middle)
        heading += (right - left) / wheels.track
    true = world.describe().base
    assert true is not None
    return Ending(true.x - origin.x - x, true.y - origin.y - y, true.heading - origin.heading - heading)


class MisjudgedBase:
    """robby in physics with wrongly assumed wheels, as calibrated by UMBmark."""

    def __init__(self, unequal: float, track: float) -> None:
        self._wheels = BelievedWheels(RADIUS * (1.0 + unequal / 2), RADIUS * (1.0 - unequal / 2), TRACK / track)
        self._factors = (1.0, 1.0, 1.0)

    def wheel_values(self) -> WheelValues:
        """Return the assumed wheels."""
        return WheelValues(self._wheels.track * self._factors[0], self._factors)

    def set_factors(self, factors: tuple[float, float, float]) -> None:
        """Set new multipliers of the assumed wheels."""
        self._factors = factors

    def drive(self, path: SquarePath) -> Driven:
        """Drive a square to its end."""
        track, left, right = self._factors
        base = self._wheels
        ending = square(
            path.direction.value,
            side=path.side,
            wheels=BelievedWheels(base.left * left, base.right * right, base.track * track),
        )
        return Driven((0.0, 0.0, 0.0), (ending.x, ending.y, ending.heading))


def digest_after(seconds: float, seed: int = 1) -> str:
    """Return the hash of the complete state after a drive with random speeds, sampled at random intervals."""
    orders, looks = random.Random(seed), random.Random()  # not cryptographic
    world = world_of()
    movers = _axes(world, {LEFT: Leg([]), RIGHT: Leg([])})
    now = 0
    while now < seconds * 1e9:
        end = now + 500 * MS
        for mover in movers.values():
            speed = orders.uniform(-3000.0, 3000.0)
            mover.run(ramp_to(now, *mover.state(now), speed, 6000.0, 6000.0), now)
        while now < end:
            now = min(end, now + looks.randrange(1 * MS, 200 * MS))
            looks.choice(list(movers.values())).advance(now)
        for mover in movers.values():
            mover.advance(now)
    return hashlib.sha256(world.angles.tobytes() + world.speeds.tobytes()).hexdigest()


def rest_cpu(seconds: float) -> float:
    """Return the CPU seconds for a time at rest, enabled, sampled 50 times a second."""
    movers = _axes(world_of(), {LEFT: Leg([]), RIGHT: Leg([])})
    for mover in movers.values():
        mover.run(hold(0, mover.plant.position), 0)
    now = 0
    while now < 2e9:
        now += _CHECK_NS
        for mover in movers.values():
            mover.advance(now)
    began = time.process_time()
    for _ in range(round(seconds * 50)):
        now += _CHECK_NS
        for mover in movers.values():
            mover.advance(now)
    return time.process_time() - began


if __name__ == "__main__":
    print(digest_after(float(sys.argv[1])))
