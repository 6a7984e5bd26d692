"""What earlier runs have seen: a row for each run, kept in the file that `--json` writes, the newest last.

A row has the date, the package, how idle the machine was before the run, and of each figure the number that is judged:
the ratio, or what was measured where there is no peer. Whoever draws it finds all he needs in the file.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from canopen_control_bench.figure import Figure

__all__ = ["MOST_RUNS", "kept_rows", "row_of"]

MOST_RUNS = 500
_PARTS = {"date": str, "package": str, "figures": dict}


def row_of(machine: Mapping[str, Any], figures: Mapping[str, Sequence[Figure]], *, quick: bool) -> dict[str, Any]:
    """Return the row of a run."""
    judged = {family: {each.name: each.judged for each in found} for family, found in figures.items()}
    of_machine = {name: machine.get(name) for name in ("date", "package", "machine", "idle")}
    return {**of_machine, "quick": quick, "figures": judged}


def kept_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows that a file holds, oldest first; none of a file that is not there, or no report."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["history"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [row for row in rows if _is_row(row)][-MOST_RUNS + 1 :] if isinstance(rows, list) else []


def _is_row(row: object) -> bool:
    return isinstance(row, dict) and all(isinstance(row.get(name), kind) for name, kind in _PARTS.items())
