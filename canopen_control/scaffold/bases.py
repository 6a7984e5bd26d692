"""Kinds of bases for `init`, each with its controller, possible numbers of drives, and joint names.

Drives are assigned to joints in this order: left before right, front before rear, traction before steering.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from canopen_control.controllers.types import TYPES
from canopen_control.scaffold.drive_choice import POSITION, VELOCITY


@dataclass(frozen=True, slots=True)
class BaseKind:
    """Kind of base; `shapes` are the possible lists of joint names, empty for any number of drives.

    The last `steering` joints are commanded by position. `type_name` is the type of the controller, "" for none.
    """

    name: str
    type_name: str = ""
    shapes: tuple[tuple[str, ...], ...] = ()
    steering: int = 0
    words: str = ""

    def joints(self, drives: int) -> tuple[str, ...]:
        """Return the default joint names for a number of drives."""
        for shape in self.shapes:
            if len(shape) == drives:
                return shape
        return tuple(f"joint_{number}" for number in range(1, drives + 1))

    def interfaces(self, drives: int, number: int) -> tuple[str, ...]:
        """Return the possible command interfaces of joint `number`, from 0, in order of preference."""
        if not self.type_name:
            return (VELOCITY, POSITION)
        return (POSITION,) if self.steers(drives, number) else (VELOCITY,)

    def steers(self, drives: int, number: int) -> bool:
        """Whether joint `number`, from 0, steers a wheel."""
        return number >= drives - self.steering

    def mirrored(self, drives: int, number: int) -> bool:
        """Whether joint `number`, from 0, is a wheel on the left, whose motor is mounted mirrored."""
        return bool(self.type_name) and not self.steers(drives, number) and number % 2 == 0

    def problem(self, drives: int) -> str:
        """Return the error text if this version lacks the base, or the number of drives is wrong, else ""."""
        if self.type_name and self.type_name not in TYPES:
            return f"--base {self.name}: this version does not include {self.type_name}; omit --base, or use diff"
        if self.shapes and drives not in {len(shape) for shape in self.shapes}:
            count = "1 was" if drives == 1 else f"{drives or 'none'} were"
            return f"--base {self.name} needs {self.words}, but {count} given; give as many node-IDs, or omit --base"
        return ""


_DIFF: Final = (
    ("left_wheel_joint", "right_wheel_joint"),
    ("front_left_wheel_joint", "front_right_wheel_joint", "rear_left_wheel_joint", "rear_right_wheel_joint"),
)

BASES: Final = {
    base.name: base
    for base in (
        BaseKind("none"),
        BaseKind(
            "diff",
            "diff_drive_controller/DiffDriveController",
            _DIFF,
            words="two drives (left, right) or four (front left, front right, rear left, rear right)",
        ),
        BaseKind(
            "tricycle",
            "tricycle_steering_controller/TricycleSteeringController",
            (("left_wheel_joint", "right_wheel_joint", "steering_joint"),),
            steering=1,
            words="three drives (rear left, rear right, steering)",
        ),
        BaseKind(
            "mecanum",
            "mecanum_drive_controller/MecanumDriveController",
            _DIFF[1:],
            words="four drives (front left, front right, rear left, rear right)",
        ),
    )
}
"""Kinds of bases by name."""
