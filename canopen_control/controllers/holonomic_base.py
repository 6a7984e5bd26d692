"""The base class of controllers of vehicles that drive sideways too: mecanum and omni wheels."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.mobile_base import MobileBase
from canopen_control.urdf.joint_element import VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.planar_pose import HolonomicKinematics


HOLONOMIC: Final = ("linear.x", "linear.y", "angular.z")
"""The axes of its twists: forward, to the left, around."""


@mypyc_attr(allow_interpreted_subclasses=True)
class HolonomicBase(MobileBase):
    """Base with commanded wheels only, by `wheels` of its kinematics."""

    twist_axes: ClassVar[tuple[str, ...]] = HOLONOMIC
    references: ClassVar[tuple[str, ...]] = ("linear/x", "linear/y", "angular/z")

    def __init__(self, name: str, type_name: str, wheels: HolonomicKinematics) -> None:
        super().__init__(name, type_name, wheels)
        self._drive = wheels

    def move_by(self, wheels: HolonomicKinematics) -> None:
        """Be moved by these from now on; the pose is theirs."""
        self.pose = self._drive = wheels

    def command_interface_names(self) -> list[str]:
        """Return the velocity of every wheel, in the order of the parameters."""
        return [f"{joint}/{VELOCITY}" for joint in self.joints]

    def velocities(self) -> tuple[float, float, float]:
        """Return the velocities of the last step."""
        return self._drive.forward, self._drive.left, self._drive.angular

    def compute_commands(self, twist: Sequence[float]) -> None:
        """Share a twist out to the wheels."""
        self._drive.command(twist[0], twist[1], twist[2])
        for index in range(len(self.targets)):
            self.targets[index] = self._drive.wheels[index]
