"""Which target a mode of operation has, and the targets that are velocities and torques (CiA 402-2).

The law of this file: the profile modes leave the ramp to the drive (0x6084); CSV has none, so the master ramps. What
does not fit the object after scaling is no target: the axis stands, and `Axis.misfit` says so.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.units import INT16_MAX, INT16_MIN, INT32_MAX, INT32_MIN, to_object
from canopen_control.hardware.interfaces import EFFORT, VELOCITY
from canopen_control.hardware.mode_target import ModeTarget, stop_slope
from canopen_control.hardware.position_targets import InterpolatedTarget, PositionTarget, SetPointTarget

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.axis import Axis
    from canopen_control.master.cycle import Output

__all__ = ["MODES", "make_target", "target_address"]

_NAN: Final = math.nan
_VL_RUN: Final = 0x70  # bits 4, 5 and 6: enable ramp, unlock ramp, use the reference


class _ScaledTarget(ModeTarget):
    """What the targets of velocities and torques share: a factor, and the ends of the object."""

    low = INT16_MIN
    high = INT16_MAX

    def _factor(self) -> float:
        """Return device units per SI unit."""
        raise NotImplementedError

    def span(self) -> tuple[float, float]:
        """Return what the object holds, for a reversed axis too; not finite where the factor is that small."""
        factor = self._factor()
        ends = self.low / factor, self.high / factor
        return min(ends), max(ends)

    def pushes(self, value: float) -> bool:
        """Whether a velocity or torque leads beyond the limit that is active."""
        return value * self._factor() * self._axis.limits.blocked > 0  # not for nan

    def _scaled(self, value: float) -> int:
        """Return a target in device units; 0 for none, and for one that does not fit, which is noted."""
        raw = to_object(value * self._factor(), self.low, self.high)
        self._axis.misfit = _NAN if raw is not None else value
        return 0 if raw is None else raw


class VelocityTarget(_ScaledTarget):
    """PV, where the drive ramps."""

    interface = VELOCITY
    tracks = True
    low = INT32_MIN
    high = INT32_MAX
    ramped = False  # by the master

    def hold(self) -> None:
        """Command no velocity."""
        self._value = _NAN
        self._slope = 0.0
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a velocity within the drive's limits."""
        axis = self._axis
        blocked = axis.limits.blocked
        if value == self._value and blocked == self._blocked:
            return  # as `_same`, without the call
        self._value, self._blocked = value, blocked
        self._slope = 0.0
        raw = self._scaled(value)
        self.output.set(axis.limits.of_velocity(raw))

    def _factor(self) -> float:
        return self._axis.scale.vel_to_dev

    def slow(self, period: float) -> bool:
        """Go towards zero along the drive's deceleration; at once where the drive makes the ramp."""
        raw: int = self.output.value
        self._value = _NAN
        if not self.ramped or raw == 0:
            self.output.set(0)
            return True
        self._slope = self._slope or stop_slope(self._axis, abs(raw))
        step = max(1, round(self._slope * period))
        raw = max(0, raw - step) if raw > 0 else min(0, raw + step)
        self.output.set(raw)
        return raw == 0


class RampedVelocityTarget(VelocityTarget):
    """CSV, where the master ramps."""

    ramped = True


class WordVelocityTarget(VelocityTarget):
    """VL: revolutions per minute in a word (0x6042), with the ramp of the drive unlocked."""

    bits = _VL_RUN
    low = INT16_MIN
    high = INT16_MAX

    def _factor(self) -> float:
        return self._axis.rpm_to_dev


class EffortTarget(_ScaledTarget):
    """TQ and CST: a stop takes the torque away."""

    interface = EFFORT

    def hold(self) -> None:
        """Command no torque."""
        self._value = _NAN
        self.output.set(0)

    def follow(self, value: float, now: int, period: float) -> None:  # noqa: ARG002 - the verb of every mode
        """Send a torque within the drive's limits."""
        if not self._same(value):
            raw = self._scaled(value)
            self.output.set(self._axis.limits.of_torque(raw))

    def _factor(self) -> float:
        return self._axis.scale.eff_to_dev

    def slow(self, period: float) -> bool:  # noqa: ARG002 - the verb of every mode
        """Take the torque away."""
        self.hold()
        return True


MODES: Mapping[int, tuple[int, int, Callable[[Axis, Output, DriveMachine], ModeTarget]]] = MappingProxyType(
    {
        OperationMode.PP: (objects.TARGET_POSITION, 0, SetPointTarget),
        OperationMode.VL: (objects.VL_TARGET_VELOCITY, 0, WordVelocityTarget),
        OperationMode.PV: (objects.TARGET_VELOCITY, 0, VelocityTarget),
        OperationMode.TQ: (objects.TARGET_TORQUE, 0, EffortTarget),
        OperationMode.IP: (objects.INTERPOLATION_DATA, 1, InterpolatedTarget),
        OperationMode.CSP: (objects.TARGET_POSITION, 0, PositionTarget),
        OperationMode.CSV: (objects.TARGET_VELOCITY, 0, RampedVelocityTarget),
        OperationMode.CST: (objects.TARGET_TORQUE, 0, EffortTarget),
    }
)
"""Mode to (index and subindex of its target, what makes it)."""


def target_address(mode: int) -> tuple[int, int] | None:
    """Return index and subindex of a mode's target on axis 0, None for a mode without one (homing, vendor modes)."""
    row = MODES.get(mode)
    return None if row is None else (row[0], row[1])


def make_target(mode: int, axis: Axis, machine: DriveMachine) -> ModeTarget | None:
    """Return the target of `mode`, None where the mode has none or no RPDO carries it."""
    row = MODES.get(mode)
    output = None if row is None else axis.output(row[0], row[1])
    return None if row is None or output is None else row[2](axis, output, machine)
