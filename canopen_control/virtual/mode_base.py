"""A mode of operation of one axis, and what it sees of that axis: the base of all modes.

A mode acts only while the power state machine is `live`. `update` is called after every write that may matter and makes
a new demand only where its inputs changed; `control` sees the controlword and its predecessor; `arrived` the end of a
demand; `bits` gives bits 10, 12 and 13 of the statusword.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction
from canopen_control.virtual.trajectory import INFINITE, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.axis_limits import AxisLimits
    from canopen_control.virtual.axis_objects import AxisObjects
    from canopen_control.virtual.mover import Mover
    from canopen_control.virtual.node_outbox import Clock, NodeOutbox
    from canopen_control.virtual.power_machine import PowerMachine
    from canopen_control.virtual.set_point_meter import SetPointMeter

__all__ = ["BIT_12", "BIT_13", "NEW_SET_POINT", "REACHED", "Axis", "FollowingMode", "Mode"]

REACHED, BIT_12, BIT_13 = 1 << 10, 1 << 12, 1 << 13
NEW_SET_POINT = 1 << 4  # of the controlword; HM and IP use the bit as well


class Axis:
    """The parts of one axis that a mode works with."""

    __slots__ = ("clock", "limits", "meter", "mover", "objects", "outbox", "power")

    def __init__(
        self,
        objects: AxisObjects,
        mover: Mover,
        power: PowerMachine,
        limits: AxisLimits,
        outbox: NodeOutbox,
        clock: Clock,
        meter: SetPointMeter,
    ) -> None:
        self.objects, self.mover, self.power, self.limits = objects, mover, power, limits
        self.outbox, self.clock, self.meter = outbox, clock, meter


class Mode:
    """The base of all modes, and the mode without a motion: it stops and stands.

    `set_point` is the object whose RPDOs are its set-points, 0: they do not come in a stream.
    """

    set_point = 0

    def __init__(self, axis: Axis) -> None:
        self.objects, self.units, self.model = axis.objects, axis.objects.units, axis.objects.model
        self.mover, self.power, self.limits = axis.mover, axis.power, axis.limits
        self.outbox, self.clock, self.meter = axis.outbox, axis.clock, axis.meter
        self.reset()

    def reset(self) -> None:
        """Forget everything: the axis is not in operation, or in another mode."""

    def start(self, now: int) -> None:
        """Begin in operation, from the present motion; also after a halt."""
        self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def stop(self, now: int, reaction: Reaction) -> None:
        """Bring the motor to rest as `reaction` says."""
        position, velocity = self.mover.state(now)
        deceleration = INFINITE
        if reaction is Reaction.SLOW_DOWN_RAMP:
            deceleration = self.deceleration()
        elif reaction is Reaction.QUICK_STOP_RAMP:
            deceleration = self.quick_stop_deceleration()
        self.mover.run(ramp_to(now, position, velocity, 0.0, 0.0, deceleration), now)

    def update(self, now: int) -> None:
        """Take set-points that may have changed."""

    def take(self, now: int) -> None:
        """Take the set-point that an RPDO brought, also where it is the one before."""
        self.update(now)

    def missed(self) -> None:
        """Note that a SYNC came without a set-point."""

    def control(self, word: int, previous: int, now: int) -> None:
        """Take the mode's own bits of the controlword."""

    def control_unpowered(self, word: int, previous: int, now: int) -> None:
        """Take the mode's own bits of the controlword while the motor has no power."""

    def arrived(self, now: int) -> None:
        """Go on at the end of a demand."""

    def bits(self) -> int:
        """Return the mode's own bits of the statusword; without a mode bit 10 at standstill."""
        return REACHED if self.mover.standing else 0

    def unpowered_bits(self) -> int:
        """Return the mode's own bits of the statusword outside operation."""
        return 0

    def measured_velocity(self) -> float:
        """Return the velocity that the drive measures, in counts/s."""
        return self.mover.plant.velocity

    def deceleration(self) -> float:
        """Return the slow-down ramp in counts/s^2: 0x6084."""
        return self.objects.ramp(o.PROFILE_DECELERATION)

    def quick_stop_deceleration(self) -> float:
        """Return the quick-stop ramp in counts/s^2: 0x6085."""
        return self.objects.ramp(o.QUICK_STOP_DECELERATION)

    def can_halt(self) -> bool:
        """Whether controlword bit 8 does anything."""
        return True


class FollowingMode(Mode):
    """A mode whose target is followed as it is, without a handshake: `update` acts when what it looks at changed."""

    def reset(self) -> None:
        """Forget the last target."""
        self._inputs: object = None
        self._looked: tuple[int, float] | None = None  # at which version of the values, and with which zero

    def start(self, now: int) -> None:
        """Go on to the target from the present motion."""
        self._inputs = None
        if self.power.live:
            self.update(now)

    def looks_anew(self) -> bool:
        """Whether a value may be another one than when it was asked last; a limit switch may be anywhere."""
        looked = None if self.mover.switches.wired else (self.objects.store.version, self.units.zero)
        before, self._looked = self._looked, looked
        return looked is None or looked != before or self._inputs is None

    def changed(self, inputs: object) -> bool:
        """Whether `inputs`, the target and what limits it, differ from the last ones; keeps them."""
        differs, self._inputs = inputs != self._inputs, inputs
        return differs
