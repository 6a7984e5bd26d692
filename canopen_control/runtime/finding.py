"""One thing that `check` has to say about a robot's files: where, how bad, what, and what to do about it.

The law of the file: a finding is data. ERROR: the robot must not be run like this. WARNING: it runs, and somebody will
be surprised. NOTE: worth knowing. Line 0 is the file as a whole. The rules that find them return lists and never raise.
"""

from __future__ import annotations

from dataclasses import dataclass

from canopen_control.od.issues import Severity

__all__ = ["Finding", "Severity", "sorted_findings"]

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

    def as_dict(self) -> dict[str, object]:
        """Return what `check --json` prints of it."""
        return {
            "path": self.path,
            "line": self.line,
            "column": self.column,
            "severity": self.severity.value,
            "text": self.text,
            "fix": self.fix,
        }


def sorted_findings(findings: list[Finding]) -> list[Finding]:
    """Return them by file and line, the worst of a line first, each once."""
    once = dict.fromkeys(findings)
    return sorted(once, key=lambda each: (each.path, each.line, _ORDER.index(each.severity), each.text))
