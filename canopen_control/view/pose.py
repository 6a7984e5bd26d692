"""Rotations as quaternions (w, x, y, z), the order that viser takes; angles in rad, lengths in m.

The law of this file: URDF's roll, pitch and yaw turn about the fixed axes of the parent, in this order (REP 103 and the
URDF specification), which is yaw * pitch * roll as quaternions.
"""

from __future__ import annotations

import math

__all__ = ["IDENTITY", "Quaternion", "Vector", "about", "from_rpy", "multiply", "rotate"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)


def about(axis: Vector, angle: float) -> Quaternion:
    """Return the rotation by `angle` about an axis of any length; about none it is no rotation."""
    length = math.hypot(*axis)
    if length == 0.0 or not math.isfinite(angle):
        return IDENTITY
    factor = math.sin(angle / 2) / length
    return math.cos(angle / 2), axis[0] * factor, axis[1] * factor, axis[2] * factor


def from_rpy(rpy: Vector) -> Quaternion:
    """Return the rotation of URDF's `rpy`."""
    roll, pitch, yaw = (about(axis, angle) for axis, angle in zip(((1, 0, 0), (0, 1, 0), (0, 0, 1)), rpy, strict=True))
    return multiply(multiply(yaw, pitch), roll)


def multiply(first: Quaternion, second: Quaternion) -> Quaternion:
    """Return the rotation that is `second` seen from the frame that `first` turned."""
    a, b, c, d = first
    e, f, g, h = second
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned."""
    w, x, y, z = rotation
    _, rx, ry, rz = multiply(multiply(rotation, (0.0, *vector)), (w, -x, -y, -z))
    return rx, ry, rz
