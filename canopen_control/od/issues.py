"""Issues of an EDS or DCF file, with severity and line.

An issue never stops the reading. ERROR: a value is lost or contradicts another, so that the device cannot match the
file. WARNING: something is doubtful; the text names the interpretation chosen. NOTE: allowed or harmless. Scripts can
rely on the codes; the texts may change.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field


class Severity(enum.Enum):
    """Severity of an issue, from a lost value (ERROR) to a harmless deviation (NOTE)."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Issue:
    """Issue at one line of a file; an issue of the whole file is at line 1."""

    path: str
    line: int
    code: str
    severity: Severity
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.severity.value}: {self.text} [{self.code}]"


@dataclass(slots=True)
class Report:
    """Issues of one file, in the order of detection."""

    path: str
    issues: list[Issue] = field(default_factory=list)

    def add(self, line: int, code: str, severity: Severity, text: str) -> None:
        """Add an issue; line 0 means the file as a whole."""
        self.issues.append(Issue(self.path, max(line, 1), code, severity, text))

    def error(self, line: int, code: str, text: str) -> None:
        self.add(line, code, Severity.ERROR, text)

    def warning(self, line: int, code: str, text: str) -> None:
        self.add(line, code, Severity.WARNING, text)

    def note(self, line: int, code: str, text: str) -> None:
        self.add(line, code, Severity.NOTE, text)
