"""What a drive shows: the objects whose value is made at the moment of reading, by index of axis 0.

The law of this file: nothing here changes anything. Positions are user counts and wrap at 32 bits as a counter does,
velocities and torques are cut to their type.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.virtual.drive import VirtualDrive

__all__ = ["SOURCES", "clamp", "user_position", "wrap32"]


def wrap32(value: float) -> int:
    """Return `value`, rounded, as a 32-bit counter shows it."""
    return (round(value) + 0x80000000 & 0xFFFFFFFF) - 0x80000000


def clamp(value: float, bits: int = 32) -> int:
    """Return the nearest whole number of a signed type."""
    edge = 1 << bits - 1
    return max(-edge, min(edge - 1, round(value)))


def user_position(drive: VirtualDrive, place: float) -> int:
    """Return the user's position of a place of the plant."""
    return wrap32((place - drive.zero) / drive.units.position)


def _position(drive: VirtualDrive) -> int:
    return wrap32((drive.mover.plant.position - drive.zero) * (-1.0 if drive.inverted else 1.0) / drive.units.position)


def _internal(drive: VirtualDrive) -> int:
    return wrap32((drive.mover.plant.position - drive.zero) * (-1.0 if drive.inverted else 1.0))


def _demand(drive: VirtualDrive) -> int:
    return user_position(drive, drive.mover.state(drive.now)[0])


def _internal_demand(drive: VirtualDrive) -> int:
    return wrap32(drive.mover.state(drive.now)[0] - drive.zero)


def _velocity(drive: VirtualDrive) -> int:
    return clamp(drive.handler.measured_velocity(drive) * (-1.0 if drive.inverted else 1.0) / drive.units.velocity)


def _velocity_demand(drive: VirtualDrive) -> int:
    return clamp(drive.mover.state(drive.now)[1] / drive.units.velocity)


def _torque(drive: VirtualDrive) -> int:
    return clamp(drive.mover.plant.torque, 16)


def _torque_demand(drive: VirtualDrive) -> int:
    torque = drive.mover.torque
    return 0 if torque is None else clamp(torque.at(drive.now)[1], 16)


def _rpm(drive: VirtualDrive) -> int:
    return clamp(drive.handler.measured_velocity(drive) / drive.counts_per_rpm * drive.units.turn, 16)


def _rpm_demand(drive: VirtualDrive) -> int:
    return clamp(drive.mover.state(drive.now)[1] / drive.counts_per_rpm * drive.units.turn, 16)


def _mode(drive: VirtualDrive) -> int:
    return drive.mode


def _inputs(drive: VirtualDrive) -> int:
    return drive.mover.switches.inputs(drive.mover.plant.position) | drive.inputs


SOURCES: dict[int, Callable[[VirtualDrive], int]] = {
    o.STATUSWORD: lambda drive: drive.statusword(),
    o.VL_VELOCITY_DEMAND: _rpm_demand,
    o.VL_VELOCITY_ACTUAL: _rpm,
    o.MODES_OF_OPERATION_DISPLAY: _mode,
    o.POSITION_DEMAND: _demand,
    o.POSITION_ACTUAL_INTERNAL: _internal,
    o.POSITION_ACTUAL: _position,
    o.VELOCITY_SENSOR_ACTUAL: _velocity,
    o.VELOCITY_DEMAND: _velocity_demand,
    o.VELOCITY_ACTUAL: _velocity,
    o.TORQUE_DEMAND: _torque_demand,
    o.TORQUE_ACTUAL: _torque,
    o.CURRENT_ACTUAL: _torque,
    o.FOLLOWING_ERROR_ACTUAL: lambda drive: clamp(drive.following_error / drive.units.position),
    o.POSITION_DEMAND_INTERNAL: _internal_demand,
    o.DIGITAL_INPUTS: _inputs,
}
"""Index of axis 0 to how its value is made; objects the dictionary lacks are not served."""
