"""Issues of an EDS or DCF file: what is odd, how bad, and where.

An issue never stops the reading. ERROR: a value is lost or contradicts another, so the device cannot be as described.
WARNING: a doubt, with what was made of it. NOTE: allowed or harmless, but worth knowing. The codes are stable, for
scripts; the texts are for people.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field


class Severity(enum.Enum):
    """How bad it is."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Issue:
    """Something odd at one line of a file; what concerns the file as a whole is at line 1."""

    path: str
    line: int
    code: str
    severity: Severity
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.severity.value}: {self.text} [{self.code}]"


@dataclass(slots=True)
class Report:
    """The issues of one file, as they are found."""

    path: str
    issues: list[Issue] = field(default_factory=list)

    def add(self, line: int, code: str, severity: Severity, text: str) -> None:
        """Add an issue; line 0 stands for the file as a whole."""
        self.issues.append(Issue(self.path, max(line, 1), code, severity, text))

    def error(self, line: int, code: str, text: str) -> None:
        """Add an ERROR."""
        self.add(line, code, Severity.ERROR, text)

    def warning(self, line: int, code: str, text: str) -> None:
        """Add a WARNING."""
        self.add(line, code, Severity.WARNING, text)

    def note(self, line: int, code: str, text: str) -> None:
        """Add a NOTE."""
        self.add(line, code, Severity.NOTE, text)
