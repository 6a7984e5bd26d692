"""CANopen and CiA 402 drives for robots: master, virtual drives and ros2_control's world in Python.

from canopen_control import Robot

with Robot.from_config("robby", can="local:robby") as robot:
    robot.command("robby_forward_controller", [10.0, 10.0])
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from canopen_control.runtime.robot import Robot

__all__ = ["Robot", "__version__"]

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """Import the public names when they are used: most processes of a robot need only a corner of the package."""
    if name == "Robot":
        from canopen_control.runtime.robot import Robot

        return Robot
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
