"""What a drive shows of one axis: the statusword, and the other objects whose value is made at the moment of reading.

Nothing here changes anything. Positions are user counts and wrap at 32 bits as a counter does, velocities and torques
are cut to their type.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.cia402.state import INTERNAL_LIMIT, REMOTE, TARGET_REACHED, VOLTAGE_ENABLED, WARNING, State
from canopen_control.virtual.axis_objects import wrap32
from canopen_control.virtual.fault_seam import Seam

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.drive_modes import DriveModes
    from canopen_control.virtual.mode_base import Axis

__all__ = ["SOURCES", "AxisReadings", "Statusword", "clamp"]


def clamp(value: float, bits: int = 32) -> int:
    """Return the nearest whole number of a signed type."""
    edge = 1 << bits - 1
    return max(-edge, min(edge - 1, round(value)))


class Statusword:
    """0x6041 of one axis.

    Seams: `remote` (bit 9), `warning` (bit 7), the bits `forced` and `suppressed`, and `replaced`, the word as a whole.
    """

    def __init__(self, axis: Axis, modes: DriveModes) -> None:
        self._power, self._limits, self._mover, self._modes = axis.power, axis.limits, axis.mover, modes
        self._velocity_bits = axis.objects.model.velocity_bits
        self.remote: Seam[bool] = Seam(True)
        self.warning: Seam[bool] = Seam(False)
        self.forced: Seam[int] = Seam(0)
        self.suppressed: Seam[int] = Seam(0)
        self.replaced: Seam[int | None] = Seam(None)

    def value(self) -> int:
        """Return the word at the time the axis was brought to."""
        if self.replaced.value is not None:
            return self.replaced.value
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
            bits = bits & ~TARGET_REACHED | (TARGET_REACHED if self._mover.standing else 0)
        return (word | bits) & ~self.suppressed.value


class AxisReadings:
    """The values that one axis shows; `inputs` are further bits of 0x60FD. Seam `inverted`: the sign is wrong."""

    def __init__(self, axis: Axis, modes: DriveModes) -> None:
        self.mover, self.limits, self.modes = axis.mover, axis.limits, modes
        self.objects, self.units = axis.objects, axis.objects.units
        self.statusword: Statusword = Statusword(axis, modes)
        self.inputs = 0
        self.inverted: Seam[bool] = Seam(False)

    @property
    def sign(self) -> float:
        """-1 where position and velocity are shown with the wrong sign."""
        return -1.0 if self.inverted.value else 1.0

    def demand(self) -> tuple[float, float]:
        """Return position and velocity of the demand, in plant counts."""
        return self.mover.state(self.mover.time)

    def position(self) -> int:
        """Return 0x6064."""
        units = self.units
        return wrap32((self.mover.plant.position - units.zero) * self.sign / units.position)

    def velocity(self) -> int:
        """Return 0x606C."""
        return clamp(self.modes.active.measured_velocity() * self.sign / self.units.velocity)

    def rpm(self, velocity: float) -> int:
        """Return a velocity in counts/s in the unit of the velocity mode."""
        return clamp(velocity / self.objects.counts_per_rpm * self.units.turn, 16)

    def torque(self) -> int:
        """Return 0x6077."""
        return clamp(self.mover.plant.torque, 16)

    def torque_demand(self) -> int:
        """Return 0x6074."""
        torque = self.mover.torque
        return 0 if torque is None else clamp(torque.at(self.mover.time)[1], 16)

    def digital_inputs(self) -> int:
        """Return 0x60FD."""
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
"""Index of axis 0 to how its value is made; objects the dictionary lacks are not served."""
