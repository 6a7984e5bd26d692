"""Vectors, rotations and poses: positions in m, angles in rad, quaternions as (w, x, y, z).

URDF's roll, pitch and yaw are rotations about the fixed axes of the parent frame, in this order (REP 103 and the URDF
specification), so that the quaternion is yaw * pitch * roll.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

IDENTITY: Final[Quaternion] = (1.0, 0.0, 0.0, 0.0)


def about(axis: Vector, angle: float) -> Quaternion:
    """Return the rotation by `angle` rad about an axis of any length.

    For a zero axis or an angle that is not finite, the result is the identity.
    """
    length = math.hypot(*axis)
    if length == 0.0 or not math.isfinite(angle):
        return IDENTITY
    factor = math.sin(angle / 2) / length
    return math.cos(angle / 2), axis[0] * factor, axis[1] * factor, axis[2] * factor


def along(axis: Vector, length: float) -> Vector:
    """Return the vector of length `length` along an axis of any length, or the zero vector for a zero axis."""
    factor = length / (math.hypot(*axis) or 1.0)
    return axis[0] * factor, axis[1] * factor, axis[2] * factor


def from_yaw(yaw: float) -> Quaternion:
    """Return the rotation by `yaw` rad about z, which is the heading of a mobile base."""
    return about((0.0, 0.0, 1.0), yaw)


def from_rpy(rpy: Vector) -> Quaternion:
    """Return the rotation for URDF's `rpy`: roll, pitch and yaw in rad."""
    roll, pitch, yaw = (about(axis, angle) for axis, angle in zip(((1, 0, 0), (0, 1, 0), (0, 0, 1)), rpy, strict=True))
    return multiply(multiply(yaw, pitch), roll)


def multiply(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation `first` followed by `second`, where `second` is relative to the frame rotated by `first`."""
    a, b, c, d = first
    e, f, g, h = second
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return `vector` rotated by a quaternion."""
    w, x, y, z = rotation
    _, rx, ry, rz = multiply(multiply(rotation, (0.0, *vector)), (w, -x, -y, -z))
    return rx, ry, rz


class Pose(NamedTuple):
    """Pose of a frame in its parent frame; the position is in m."""

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Quaternion = IDENTITY

    def of(self, point: Vector) -> Vector:
        """Transform a point from this frame to the parent frame."""
        x, y, z = rotate(self.rotation, point)
        return self.position[0] + x, self.position[1] + y, self.position[2] + z

    def then(self, child: Pose) -> Pose:
        """Return the pose of a child frame in the parent frame; `child` is the pose of the child in this frame."""
        return Pose(self.of(child.position), multiply(self.rotation, child.rotation))


ORIGIN: Final = Pose()
