"""Control loops of a servo drive on a joint of the world: encoder, position loop, velocity loop and current limit.

The loops run once per step of the world, measure the joint only through its encoder, and output a torque for the step.
Angles are in rad and torques in Nm at the joint (m and N for a prismatic joint); the drive's counts and per mille
values are converted here, using the mounting direction of the motor.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from canopen_control.physics.body_model import JointPlace
    from canopen_control.physics.motor_estimate import EstimatedMotor
    from canopen_control.physics.physics_file import AxisSettings
    from canopen_control.virtual.plant import AxisOwner, ServoGains
    from canopen_control.virtual.trajectory import DemandCurve


_COARSE: Final = 1e-4  # rad per count above which the encoder's speed needs a filter
_FILTER_S: Final = 0.004
_ENCODER: Final = 16_384  # minimum counts per revolution by default: 4096 lines
_RESET: Final = 0.25  # fraction of the bandwidth: damping 1 at the tuned inertia
_FOLLOW_NS: Final = 10_000_000


class ServoLoop:
    """Position P loop around a velocity PI loop; `quantum` is one encoder count in rad.

    `period` is in s. The gains follow from the settings, unless the drive sets its own.
    """

    kp: float
    _ki: float
    _gain: float
    _feed_forward: float

    def __init__(self, motor: EstimatedMotor, settings: AxisSettings, period: float) -> None:
        counts = abs(settings.scale_pos_to_dev)
        if settings.encoder is None:
            counts = max(counts, _ENCODER * settings.gear / math.tau)
        else:
            counts = settings.encoder * settings.gear / math.tau
        self.quantum = 1.0 / counts
        kp = settings.bandwidth * motor.inertia
        self._own = (kp, _RESET * settings.bandwidth * kp, settings.position_gain, 1.0)
        self._period = period
        self.tune()
        self._share = period / (_FILTER_S + period) if self.quantum > _COARSE else 1.0
        self._place: float | None = None
        self._velocity = self._integral = 0.0

    def tune(self, gains: ServoGains | None = None, counts: float = 1.0, per_mille: float = 1.0) -> None:
        """Set the gains of the drive as loop gains; None restores the gains derived from the settings.

        `counts` is the number of drive counts per rad, `per_mille` the torque of one per mille in Nm. The state of the
        integrator is kept.
        """
        scale = counts * per_mille
        values = (gains[0] * scale, gains[1] * scale, gains[2], gains[3]) if gains is not None else self._own
        self.kp, ki, self._gain, self._feed_forward = values
        self._ki = ki * self._period

    def rest(self, torque: float = 0.0) -> None:
        """Set the integrator so that the loops continue with `torque`."""
        self._integral = torque

    def begin(self) -> None:
        """Reset all loop states after the joint has been moved to another position."""
        self._place, self._velocity, self._integral = None, 0.0, 0.0

    def torque(self, angle: float, position: float, velocity: float, limit: float) -> float:
        """Return the torque of the position loop with velocity feed-forward, limited to `limit`."""
        error = position - self._measure(angle)
        if velocity == 0.0 and -self.quantum <= error <= self.quantum:
            return self._hold(limit)
        return self._velocity_loop(self._feed_forward * velocity + self._gain * error - self._velocity, limit)

    def velocity_torque(self, angle: float, velocity: float, limit: float) -> float:
        """Return the torque of the velocity loop without a position loop, limited to `limit`."""
        self._measure(angle)
        return self._velocity_loop(velocity - self._velocity, limit)

    def _measure(self, angle: float) -> float:
        """Sample the encoder and return the measured position."""
        place = round(angle / self.quantum) * self.quantum
        way = 0.0 if self._place is None else place - self._place
        self._place = place
        self._velocity += self._share * (way / self._period - self._velocity)
        return place

    def _velocity_loop(self, error: float, limit: float) -> float:
        """Return the torque of the PI velocity loop for a velocity error, limited to `limit`."""
        torque = self.kp * error + self._integral
        if torque > limit:
            force = limit
        elif torque < -limit:
            force = -limit
        else:
            force = torque
        if force == torque or error * torque < 0.0:  # anti-windup
            self._integral += self._ki * error
        return force

    def _hold(self, limit: float) -> float:
        """Return the torque that holds the position within one encoder count, without oscillation."""
        return max(-limit, min(limit, self._integral - self.kp * self._velocity))


class JointWorld(Protocol):
    """Interface of a world, as used by the plants of its joints."""

    angles: NDArray[np.float64]
    speeds: NDArray[np.float64]
    efforts: NDArray[np.float64]

    @property
    def asleep(self) -> bool:
        """Whether the simulation is suspended because nothing moves and no drive requests motion."""

    def reach(self, now: int, by: JointPlant) -> None:
        """Advance the simulation to `now`; `by` is the calling plant, which serves its own timers."""

    def wake(self) -> None:
        """Resume a suspended simulation because something outside it has changed."""

    def set_lock(self, place: JointPlace, locked: bool) -> None: ...

    def set_friction(self, place: JointPlace, torque: float) -> None:
        """Change the friction of a joint, in Nm."""


class JointPlant:
    """Plant of one joint of a world (a `CoupledPlant`), which advances the whole world.

    `external` acts in the drive's positive direction and `friction` against the motion, both in per mille of the rated
    torque; `stalled` blocks the joint.
    """

    stiff = False

    def __init__(self, world: JointWorld, place: JointPlace, settings: AxisSettings, period: float) -> None:
        self._world, self.place, self.joint = world, place, settings.joint
        self.loop = ServoLoop(place.motor, settings, period)
        self.rated_torque = place.motor.rated_torque
        self._scale = settings.scale_pos_to_dev
        self._sign = math.copysign(1.0, self._scale)
        self._per_mille = self._sign * self.rated_torque / 1000.0  # Nm per per mille
        self._peak = place.motor.peak_torque
        self.owner: AxisOwner | None = None
        self.busy = False  # whether its timers are being processed
        self._offset = 0.0  # displacement of the encoder in counts
        self._position = self.velocity = self.torque = 0.0
        self._external, self._stalled = 0.0, False
        self._friction = 1000.0 * place.motor.friction / self.rated_torque
        self._held: bool | None = None  # True if the joint is held by its brake or by a stall
        self._gains: ServoGains | None = None  # gains of the loop, set by the drive
        self.show(0.0)

    # -- drive side

    @property
    def follow_ns(self) -> int:
        """Interval in ns at which the drive checks position and load; longer while the simulation is suspended."""
        return 10 * _FOLLOW_NS if self._world.asleep else _FOLLOW_NS

    def set_owner(self, owner: AxisOwner) -> None:
        """Set the axis that commands the joint; called once."""
        self.owner = owner

    @property
    def position(self) -> float:
        """Position of the joint in counts of the drive."""
        return self._position

    @position.setter
    def position(self, value: float) -> None:
        """Shift the encoder so that it reads `value`; the joint does not move."""
        self._offset += value - self._position
        self._position = value
        self._world.wake()

    def follow(self, demand: DemandCurve, start_ns: int, end_ns: int) -> None:  # noqa: ARG002 # the owner's is read
        """Advance the world to `end_ns` while the servo loops follow the owner's demand."""
        self._world.reach(end_ns, self)

    def apply_torque(self, torque: DemandCurve, start_ns: int, end_ns: int) -> None:  # noqa: ARG002 # as above
        """Advance the world to `end_ns` while the owner's torque drives the joint."""
        self._world.reach(end_ns, self)

    def release(self, start_ns: int, end_ns: int) -> None:  # noqa: ARG002 # as above
        """Advance the world to `end_ns` while the joint has no power."""
        self._world.reach(end_ns, self)

    def feed_forward(self, velocity: float, torque: float) -> None:
        """Ignore the velocity and torque offsets; the loops use the demanded velocity."""

    # -- external actions

    @property
    def external(self) -> float:
        """External torque in per mille of the rated torque, positive in the drive's direction."""
        return self._external

    @external.setter
    def external(self, value: float) -> None:
        self._external = value
        self._world.wake()

    @property
    def friction(self) -> float:
        """Friction in per mille of the rated torque."""
        return self._friction

    @friction.setter
    def friction(self, value: float) -> None:
        self._friction = max(0.0, value)
        self._world.set_friction(self.place, self._friction * self.rated_torque / 1000.0)
        self._world.wake()

    @property
    def stalled(self) -> bool:
        """Whether an external block, rather than the brake, holds the joint."""
        return self._stalled

    @stalled.setter
    def stalled(self, value: bool) -> None:
        self._stalled = value
        self._world.wake()

    # -- world side

    def wants(self, now: int) -> bool:
        """Whether the drive requests motion at `now`."""
        owner = self.owner
        if owner is None or not owner.powered:
            return False
        return owner.torque is not None or now < owner.demand.end_ns or owner.demand.final_velocity != 0.0

    def order(self) -> tuple[object, ...]:
        """Return the drive's demand and settings as a tuple; a changed tuple is a changed demand."""
        owner = self.owner
        if owner is None:
            return ()
        return owner.powered, owner.torque, owner.demand, owner.torque_limit, owner.velocity_mode, owner.gains

    def control(self, clock: int) -> None:
        """Set the joint's torque for the simulation step that begins at `clock`."""
        owner, is_stalled, newtons = self.owner, self._stalled, 0.0
        if owner is None or not owner.powered:
            is_stalled = is_stalled or self.place.motor.brake
            self.loop.rest()
        else:
            limit = min(self._peak, owner.torque_limit * self.rated_torque / 1000.0)
            if owner.gains is not self._gains:
                self._gains = owner.gains
                self.loop.tune(owner.gains, abs(self._scale), abs(self._per_mille))
            if owner.torque is None:
                newtons = self._loop_torque(owner, clock, limit)
            else:
                newtons = max(-limit, min(limit, owner.torque.at(clock)[1] * self._per_mille))
                self.loop.rest(newtons)
        if is_stalled is not self._held:
            self._held = is_stalled
            self._world.set_lock(self.place, is_stalled)
        self.torque = newtons / self._per_mille
        self._world.efforts[self.place.dof] = newtons + self._external * self._per_mille

    def _loop_torque(self, owner: AxisOwner, clock: int, limit: float) -> float:
        """Return the torque in Nm of the velocity or position loop for the owner's demand."""
        position, velocity = owner.demand.at(clock)
        angle, speed = float(self._world.angles[self.place.qpos]), velocity / self._scale
        if owner.velocity_mode:
            return self.loop.velocity_torque(angle, speed, limit)
        return self.loop.torque(angle, (position - self._offset) / self._scale, speed, limit)

    def show(self, beyond: float) -> None:
        """Update position and velocity from the world, extrapolating the position by `beyond` s after the last step."""
        speed = float(self._world.speeds[self.place.dof])
        angle = float(self._world.angles[self.place.qpos]) + speed * beyond
        quantum = self.loop.quantum
        self.velocity = speed * self._scale
        self._position = self._offset + round(angle / quantum) * quantum * self._scale
