"""What the description knows of a robot's wheels, for controllers that are not told it and to check those that are.

The law of the file (ros_controllers noetic): the separation is the distance of two wheel joints' origins, in the plane;
the radius is that of the one cylinder or sphere of the wheel's link. Ours: joints that do not hang on the same link are
followed through fixed joints to a common one; what the description does not say is None, never a guess.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.urdf.geometry import rotate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.urdf.geometry import Vector
    from canopen_control.urdf.robot_model import RobotModel

__all__ = ["WheelGeometry"]


class WheelGeometry:
    """The wheels of one description; lengths in m."""

    def __init__(self, model: RobotModel) -> None:
        self._joints, self._links = model.joints, model.links
        self._above = {joint.child: joint for joint in model.joints.values()}

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
        found = {self._radius(name) for name in wheels}
        return found.pop() if len(found) == 1 else None

    def _radius(self, wheel: str) -> float | None:
        joint = self._joints.get(wheel)
        link = self._links.get(joint.child) if joint is not None else None
        return None if link is None else link.radius

    def place(self, joint: str) -> tuple[str, Vector] | None:
        """Return where a joint is: the link above all fixed joints over it, and the point in that link's frame."""
        found = self._joints.get(joint)
        if found is None:
            return None
        point, link = found.origin.position, found.parent
        seen = {link}
        while (above := self._above.get(link)) is not None and above.fixed and above.parent not in seen:
            point, link = above.origin.of(point), above.parent
            seen.add(link)
        return link, point

    def axis(self, joint: str) -> Vector | None:
        """Return the axis of a joint in the frame of the link it hangs on."""
        found = self._joints.get(joint)
        return None if found is None else rotate(found.origin.rotation, found.axis)
