"""What a mode of operation is to its drive, and the part that all modes share.

The law of this file: a handler acts only while its drive is `live`. `update` is called after every write that may
matter and makes a new demand only where its inputs changed; `control` sees the controlword and its predecessor;
`arrived` the end of a demand; `bits` gives bits 10, 12 and 13 of the statusword.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction

if TYPE_CHECKING:
    from canopen_control.virtual.drive import VirtualDrive

__all__ = ["BIT_12", "BIT_13", "REACHED", "Following", "Idle", "ModeHandler"]

REACHED, BIT_12, BIT_13 = 1 << 10, 1 << 12, 1 << 13


class ModeHandler(Protocol):
    """One mode of one drive."""

    def reset(self) -> None:
        """Forget everything: the drive is not in operation, or in another mode."""

    def start(self, drive: VirtualDrive, now: int) -> None:
        """Begin in operation, from the present motion; also after a halt."""

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Take set-points that may have changed."""

    def control(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Take the mode's own bits of the controlword."""

    def arrived(self, drive: VirtualDrive, now: int) -> None:
        """Go on at the end of a demand."""

    def bits(self, drive: VirtualDrive) -> int:
        """Return the mode's own bits of the statusword."""

    def measured_velocity(self, drive: VirtualDrive) -> float:
        """Return the velocity that the drive measures, in counts/s."""

    def deceleration(self, drive: VirtualDrive) -> float:
        """Return the slow-down ramp in counts/s^2."""

    def can_halt(self, drive: VirtualDrive) -> bool:
        """Whether controlword bit 8 does anything."""

    def quick_stop_deceleration(self, drive: VirtualDrive) -> float:
        """Return the quick-stop ramp in counts/s^2."""

    def control_unpowered(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Take the mode's own bits of the controlword while the motor has no power."""

    def unpowered_bits(self, drive: VirtualDrive) -> int:
        """Return the mode's own bits of the statusword outside operation."""


class Idle:
    """No mode, or one without a motion: it stops and stands; the base of what the others share."""

    def reset(self) -> None:
        """Forget nothing: there is nothing."""

    def start(self, drive: VirtualDrive, now: int) -> None:
        """Stop along the slow-down ramp."""
        drive.stop(now, Reaction.SLOW_DOWN_RAMP)

    def update(self, drive: VirtualDrive, now: int) -> None:
        """Do nothing."""

    def control(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Do nothing."""

    def arrived(self, drive: VirtualDrive, now: int) -> None:
        """Do nothing."""

    def bits(self, drive: VirtualDrive) -> int:
        """Return bit 10 at standstill."""
        return REACHED if drive.mover.standing else 0

    def measured_velocity(self, drive: VirtualDrive) -> float:
        """Return the plant's."""
        return drive.mover.plant.velocity

    def deceleration(self, drive: VirtualDrive) -> float:
        """Return 0x6084."""
        return drive.ramp(o.PROFILE_DECELERATION)

    def can_halt(self, drive: VirtualDrive) -> bool:  # noqa: ARG002 # homing looks at it
        """Return True."""
        return True

    def quick_stop_deceleration(self, drive: VirtualDrive) -> float:
        """Return 0x6085."""
        return drive.ramp(o.QUICK_STOP_DECELERATION)

    def control_unpowered(self, drive: VirtualDrive, word: int, previous: int, now: int) -> None:
        """Do nothing."""

    def unpowered_bits(self, drive: VirtualDrive) -> int:  # noqa: ARG002 # homing looks at it
        """Return none."""
        return 0


class Following(Idle):
    """A mode whose target is followed as it is, without a handshake: `update` acts when what it looks at changed."""

    def __init__(self) -> None:
        self._inputs: object = None

    def reset(self) -> None:
        """Forget the last target."""
        self._inputs = None

    def start(self, drive: VirtualDrive, now: int) -> None:
        """Go on to the target from the present motion."""
        self._inputs = None
        if drive.live:
            self.update(drive, now)

    def changed(self, inputs: object) -> bool:
        """Whether `inputs`, the target and what limits it, differ from the last ones; keeps them."""
        differs, self._inputs = inputs != self._inputs, inputs
        return differs
