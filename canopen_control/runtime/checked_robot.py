"""What the rules of `check` look at: a robot's files, as far as they could be read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.hardware.wheels import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.params import ControllerConfig, ControllersFile
    from canopen_control.hardware.description import Description
    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.files import RobotFiles

__all__ = ["CheckedRobot"]


@dataclass
class CheckedRobot:
    """What the rules look at; what could not be read is None. `asked` are the names given with --controller."""

    files: RobotFiles
    bus: BusConfig | None = None
    control: ControllersFile | None = None
    description: Description | None = None
    asked: Sequence[str] = ()
    launch_namespaces: dict[str, str] = field(default_factory=dict)
    configured: dict[str, Controller] = field(default_factory=dict)

    def config(self, name: str) -> ControllerConfig:
        """Return what the file says of a configured controller."""
        assert self.control is not None  # there is no configured controller without a file
        return self.control.controllers[name]

    @property
    def geometry(self) -> WheelGeometry | None:
        """The wheels of the description."""
        return None if self.description is None else WheelGeometry(self.description)
