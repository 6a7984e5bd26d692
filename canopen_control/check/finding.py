"""Findings of `check`, and the files of a robot as the input of the rules.

ERROR: the robot cannot be run. WARNING: the robot runs, with surprising results. NOTE: information. Line 0 refers to
the complete file.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.od.issues import Severity
from canopen_control.urdf.robot_model import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.controllers_file import ControllerConfig, ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.urdf.description import UrdfDescription


_NUMBERS: Final = re.compile(r"(\d+)")
_ORDER = (Severity.ERROR, Severity.WARNING, Severity.NOTE)


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding about a line of a file; `fix` is advice, or "" if `text` contains it."""

    path: str
    line: int
    severity: Severity
    text: str
    fix: str = ""
    column: int = 0  # 0 if unknown
    source: str = ""  # the line of the file, with a caret below the column, for display

    def __str__(self) -> str:
        place = ":".join([self.path, *(str(number) for number in (self.line, self.column) if number)])
        fix = f"; {self.fix}" if self.fix else ""
        source = f"\n{self.source}" if self.source else ""
        return f"{place}: {self.severity.value}: {self.text}{fix}{source}"


def sorted_findings(findings: list[Finding]) -> list[Finding]:
    """Return the findings sorted by file and line, without duplicates; the most severe of a line comes first."""
    once = dict.fromkeys(findings)
    return sorted(once, key=_order)


def _order(finding: Finding) -> tuple[str, int, int, list[tuple[int, str]]]:
    """Return the sort key of a finding; numbers in the text count as numbers, so that RPDO 2 precedes RPDO 10."""
    parts = [(int(part), "") if part.isdecimal() else (0, part) for part in _NUMBERS.split(finding.text)]
    return finding.path, finding.line, _ORDER.index(finding.severity), parts


@dataclass
class CheckedRobot:
    """Files of a robot, as the input of the rules; a file that could not be read is None.

    `requested_controllers` are the names of --controller. `mock` and `real` override the plugins of the description.
    `started` are the controllers that a run would activate, None if unknown; `chosen` means that the user named them.
    """

    files: RobotFiles
    bus: BusConfig | None = None
    control: ControllersFile | None = None
    description: UrdfDescription | None = None
    requested_controllers: Sequence[str] = ()
    mock: bool = False
    real: bool = False
    started: frozenset[str] | None = None
    chosen: bool = False
    launch_namespaces: dict[str, str] = field(default_factory=dict)
    configured: dict[str, Controller] = field(default_factory=dict)

    def severity(self, name: str) -> Severity:
        """Return the severity of a controller's errors: WARNING if a selection or --mock omits it, else ERROR."""
        waits = (self.chosen or self.mock) and self.started is not None and name not in self.started
        return Severity.WARNING if waits else Severity.ERROR

    def config(self, name: str) -> ControllerConfig:
        assert self.control is not None  # there is no configured controller without a file
        return self.control.controllers[name]

    @property
    def geometry(self) -> WheelGeometry | None:
        """Positions and sizes of the wheels in the description, or None without a description."""
        return None if self.description is None else WheelGeometry(self.description.model)
