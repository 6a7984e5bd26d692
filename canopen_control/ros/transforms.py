"""Where the links of a robot are relative to each other, from its URDF and the positions of its joints.

The law of the file (URDF, robot_state_publisher): the transform of a joint is its origin, then its motion, a rotation
by the position about its axis, or a shift along it; roll, pitch and yaw are about fixed axes, in that order; a mimic
joint is `multiplier * position + offset` of the other. Fixed joints never move; a movable one whose position is not
known has no transform. Lengths in m, angles in rad, quaternions as (x, y, z, w).
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["JointFrame", "Transform", "read_joints"]

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
_TURNING: Final = ("revolute", "continuous")


class Transform(NamedTuple):
    """From the frame `parent` to the frame `child`."""

    parent: str
    child: str
    translation: Vector
    rotation: Quaternion


class JointFrame(NamedTuple):
    """A joint of the URDF, as far as it moves frames; `mimic` is (joint, multiplier, offset)."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Vector
    rotation: Quaternion
    axis: Vector
    mimic: tuple[str, float, float] | None = None

    @property
    def fixed(self) -> bool:
        """Whether it never moves."""
        return self.kind == "fixed"

    def transform(self, positions: Mapping[str, float]) -> Transform | None:
        """Return where the child is; None if that is not known, or if the joint is of a kind with more freedom."""
        if self.fixed:
            return Transform(self.parent, self.child, self.origin, self.rotation)
        position = self._position(positions)
        if not math.isfinite(position):
            return None
        if self.kind in _TURNING:
            rotation = multiply(self.rotation, about(self.axis, position))
            return Transform(self.parent, self.child, self.origin, rotation)
        if self.kind == "prismatic":
            x, y, z = rotate(self.rotation, (self.axis[0] * position, self.axis[1] * position, self.axis[2] * position))
            origin = (self.origin[0] + x, self.origin[1] + y, self.origin[2] + z)
            return Transform(self.parent, self.child, origin, self.rotation)
        return None

    def _position(self, positions: Mapping[str, float]) -> float:
        if self.mimic is None:
            return positions.get(self.name, math.nan)
        other, multiplier, offset = self.mimic
        return multiplier * positions.get(other, math.nan) + offset


def read_joints(urdf: str) -> list[JointFrame]:
    """Return the joints of a URDF; ValueError when it is none, or a number in it is none."""
    try:
        root = ET.fromstring(urdf)
    except ET.ParseError as error:
        raise ValueError(f"the robot description is no XML: {error}") from error
    return [_read_joint(each) for each in root.findall("joint")]


def of_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of a rotation about the fixed axes x, y and z, in that order."""
    one = about((1.0, 0.0, 0.0), roll)
    return multiply(multiply(about((0.0, 0.0, 1.0), yaw), about((0.0, 1.0, 0.0), pitch)), one)


def about(axis: Vector, angle: float) -> Quaternion:
    """Return the quaternion of a rotation about an axis; the axis may have any length but 0."""
    length = math.hypot(*axis)
    scale = math.sin(angle / 2.0) / length if length else 0.0
    return axis[0] * scale, axis[1] * scale, axis[2] * scale, math.cos(angle / 2.0)


def multiply(one: Quaternion, other: Quaternion) -> Quaternion:
    """Return the rotation `other`, then `one`."""
    ax, ay, az, aw = one
    bx, by, bz, bw = other
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


def rotate(rotation: Quaternion, vector: Vector) -> Vector:
    """Return a vector turned by a rotation."""
    x, y, z, w = rotation
    turned = multiply(multiply(rotation, (*vector, 0.0)), (-x, -y, -z, w))
    return turned[0], turned[1], turned[2]


def _read_joint(joint: ET.Element) -> JointFrame:
    origin, mimic = joint.find("origin"), joint.find("mimic")
    axis = _vector(joint.find("axis"), "xyz", (1.0, 0.0, 0.0))
    length = math.hypot(*axis) or 1.0
    return JointFrame(
        joint.get("name", ""),
        joint.get("type", ""),
        _link(joint, "parent"),
        _link(joint, "child"),
        _vector(origin, "xyz", (0.0, 0.0, 0.0)),
        of_rpy(*_vector(origin, "rpy", (0.0, 0.0, 0.0))),
        (axis[0] / length, axis[1] / length, axis[2] / length),
        None if mimic is None else _mimic(mimic),
    )


def _mimic(mimic: ET.Element) -> tuple[str, float, float]:
    return mimic.get("joint", ""), float(mimic.get("multiplier", "1")), float(mimic.get("offset", "0"))


def _link(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def _vector(element: ET.Element | None, attribute: str, default: Vector) -> Vector:
    text = None if element is None else element.get(attribute)
    if text is None:
        return default
    x, y, z = map(float, text.split())
    return x, y, z
