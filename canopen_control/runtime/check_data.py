"""What the rules of `check` look at, a robot's files as far as they could be read, and what they find there.

A finding is data. ERROR: the robot must not be run like this. WARNING: it runs, and somebody will
be surprised. NOTE: worth knowing. Line 0 is the file as a whole. The rules that find them return lists and never raise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.od.issues import Severity
from canopen_control.urdf.wheels import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.controllers_file import ControllerConfig, ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.urdf.description import Description

__all__ = ["CheckedRobot", "Finding", "Severity", "sorted_findings"]

_ORDER = (Severity.ERROR, Severity.WARNING, Severity.NOTE)


@dataclass(frozen=True, slots=True)
class Finding:
    """Something about one line of a file; `fix` says what to do, "" where `text` says it already."""

    path: str
    line: int
    severity: Severity
    text: str
    fix: str = ""
    column: int = 0  # 0: not known
    source: str = ""  # the line itself, with a caret below the place, for people

    def __str__(self) -> str:
        place = ":".join([self.path, *(str(each) for each in (self.line, self.column) if each)])
        fix = f"; {self.fix}" if self.fix else ""
        source = f"\n{self.source}" if self.source else ""
        return f"{place}: {self.severity.value}: {self.text}{fix}{source}"


def sorted_findings(findings: list[Finding]) -> list[Finding]:
    """Return them by file and line, the worst of a line first, each once."""
    once = dict.fromkeys(findings)
    return sorted(once, key=lambda each: (each.path, each.line, _ORDER.index(each.severity), each.text))


@dataclass
class CheckedRobot:
    """What the rules look at; what could not be read is None. `asked` are the names given with --controller.

    With `mock` or `real` the plugins of the description are overruled; `started` are the controllers that a run would
    activate, None: all of the file count. `chosen` says that somebody has named these.
    """

    files: RobotFiles
    bus: BusConfig | None = None
    control: ControllersFile | None = None
    description: Description | None = None
    asked: Sequence[str] = ()
    mock: bool = False
    real: bool = False
    started: frozenset[str] | None = None
    chosen: bool = False
    launch_namespaces: dict[str, str] = field(default_factory=dict)
    configured: dict[str, Controller] = field(default_factory=dict)

    def severity(self, name: str) -> Severity:
        """Return what a mistake of a controller is: an error, or a warning where another one is chosen to be run."""
        waits = (self.chosen or self.mock) and self.started is not None and name not in self.started
        return Severity.WARNING if waits else Severity.ERROR

    def config(self, name: str) -> ControllerConfig:
        """Return what the file says of a configured controller."""
        assert self.control is not None  # there is no configured controller without a file
        return self.control.controllers[name]

    @property
    def geometry(self) -> WheelGeometry | None:
        """The wheels of the description."""
        return None if self.description is None else WheelGeometry(self.description.model)
