"""What the description knows of a robot's wheels, for controllers that are not told it and to check those that are.

The law of the file (ros_controllers noetic): the separation is the distance of two wheel joints' origins, in the plane;
the radius is that of the one cylinder or sphere of the wheel's link. Ours: joints that do not hang on the same link are
followed through fixed joints to a common one; what the description does not say is None, never a guess.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.hardware.description import Description, UrdfJoint

__all__ = ["WheelGeometry"]

Vector = tuple[float, float, float]


class WheelGeometry:
    """The wheels of one description; lengths in m."""

    def __init__(self, description: Description) -> None:
        self._joints = description.joints
        self._radii = description.radii
        self._above = {joint.child: joint for joint in description.joints.values()}

    def separation(self, left: Sequence[str], right: Sequence[str]) -> float | None:
        """Return the mean distance of the wheels of both sides across the robot, None if it is not known."""
        sides = [[self.place(name) for name in side] for side in (left, right)]
        if not all(sides) or any(place is None for side in sides for place in side):
            return None
        known = [[place for place in side if place is not None] for side in sides]
        if len({root for side in known for root, _ in side}) != 1:
            return None
        means = [tuple(sum(point[axis] for _, point in side) / len(side) for axis in range(2)) for side in known]
        return math.dist(means[0], means[1])

    def radius(self, wheels: Sequence[str]) -> float | None:
        """Return the radius of these wheels, None if it is not known or they differ."""
        found = {self._radii.get(self._joints[name].child) if name in self._joints else None for name in wheels}
        return found.pop() if len(found) == 1 else None

    def place(self, joint: str) -> tuple[str, Vector] | None:
        """Return where a joint is: the link above all fixed joints over it, and the point in that link's frame."""
        found = self._joints.get(joint)
        if found is None:
            return None
        point, link = found.origin_xyz, found.parent
        seen = {link}
        while (above := self._above.get(link)) is not None and above.type == "fixed" and above.parent not in seen:
            point, link = _carried(above, point), above.parent
            seen.add(link)
        return link, point

    def axis(self, joint: str) -> Vector | None:
        """Return the axis of a joint in the frame of the link it hangs on."""
        found = self._joints.get(joint)
        return None if found is None else turned(found.origin_rpy, found.axis)


def _carried(joint: UrdfJoint, point: Vector) -> Vector:
    """Return a point of a joint's child frame in its parent frame."""
    x, y, z = turned(joint.origin_rpy, point)
    return x + joint.origin_xyz[0], y + joint.origin_xyz[1], z + joint.origin_xyz[2]


def turned(rpy: Vector, point: Vector) -> Vector:
    """Turn a point by roll, pitch and yaw about the fixed axes x, y, z, as URDF does; rad."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle), math.cos(angle)) for angle in rpy)
    x, y, z = point
    return (
        cy * cp * x + (cy * sp * sr - sy * cr) * y + (cy * sp * cr + sy * sr) * z,
        sy * cp * x + (sy * sp * sr + cy * cr) * y + (sy * sp * cr - cy * sr) * z,
        -sp * x + cp * sr * y + cp * cr * z,
    )
