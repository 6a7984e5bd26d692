"""The results of earlier runs: a row for each run, stored in the file written by `--json`, newest last.

A row has the date, the commit, the machine, the package, whether processors were kept awake, how idle the machine was
before the run, and of each figure the number that is judged: the ratio, or what was measured where there is no peer.
Whoever draws it finds all he needs in the file. A run is held against the last one of the same machine and package,
figure by figure.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from canopen_control_bench.figure import AT_LEAST

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from canopen_control_bench.figure import Figure


MAX_RUNS = 500
SLOWER = 1.25  # times what it was is worth a word: a ratio of medians differs by a tenth from run to run
_IDLE_ENOUGH = 0.9
_OF_MACHINE = ("date", "commit", "package", "machine", "processors", "idle")
_SAME = ("machine", "package", "processors", "quick")
_PARTS = {"date": str, "package": str, "figures": dict}


def row_of(machine: Mapping[str, Any], figures: Mapping[str, Sequence[Figure]], *, quick: bool) -> dict[str, Any]:
    """Return the row of a run."""
    judged = {
        family: dict(zip(_names(found), (figure.judged for figure in found), strict=True))
        for family, found in figures.items()
    }
    of_machine = {name: machine.get(name) for name in _OF_MACHINE}
    return {**of_machine, "quick": quick, "figures": judged}


def kept_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows in a file, oldest first; empty if the file is missing or is not a report."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))["history"]
    except (OSError, ValueError, KeyError, TypeError):
        return []
    return [row for row in rows if _is_row(row)][-MAX_RUNS + 1 :] if isinstance(rows, list) else []


def _is_row(row: object) -> bool:
    return isinstance(row, dict) and all(isinstance(row.get(name), kind) for name, kind in _PARTS.items())


def _names(figures: Sequence[Figure]) -> list[str]:
    """Return the names of figures in a row; figures that share a name are distinguished by their peers."""
    several = [figure.name for figure in figures]
    doubled = [name for name in several if several.count(name) > 1]
    return [f"{figure.name} / {figure.peer_name}" if figure.name in doubled else figure.name for figure in figures]


def slower_than_before(
    rows: Sequence[Mapping[str, Any]], row: Mapping[str, Any], figures: Mapping[str, Sequence[Figure]]
) -> list[str]:
    """Return messages about figures of `row` that are worse than in the previous run of the same machine.

    A time is only compared where the machine was idle both times; a ratio or a count always.
    """
    found = []
    like = [earlier for earlier in reversed(rows) if all(earlier.get(key, row[key]) == row[key] for key in _SAME)]
    for family, seen in figures.items():
        for name, figure in zip(_names(seen), seen, strict=True):
            last = next((earlier for earlier in like if name in earlier["figures"].get(family, {})), None)
            if last is None or not (figure.steady or (_was_idle(row) and _was_idle(last))):
                continue
            before = float(last["figures"][family][name])
            if figure.limit is not None and _is_worse(figure, before):
                found.append(f"{family}: {name}: {figure.judged:.3g}, {before:.3g} on {last['date'][:10]}")
    return found


def _was_idle(row: Mapping[str, Any]) -> bool:
    return (row.get("idle") or 0.0) >= _IDLE_ENOUGH


def _is_worse(figure: Figure, before: float) -> bool:
    if figure.direction == AT_LEAST:
        return figure.judged * SLOWER < before
    return figure.judged > before * SLOWER
