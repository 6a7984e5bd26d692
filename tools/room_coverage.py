"""How much of each room the tests reach, lines and branches, from the JSON of coverage.

A room below LEAST says why in pyproject.toml, [tool.room_coverage.below], or the exit code is 1.

    python tools/room_coverage.py build/coverage.json [ROOM ...]
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

PACKAGE = "canopen_control"
LEAST = 90.0  # percent
_PARTS = ("covered_lines", "covered_branches", "num_statements", "num_branches")


def room_of(path: str) -> str:
    """Return the room of a file: the folder below the package, or the file where it stands there alone."""
    parts = Path(path).parts
    return parts[parts.index(PACKAGE) + 1].removesuffix(".py")


def covered_by_room(files: Mapping[str, Any]) -> dict[str, float]:
    """Return the percentage of lines and branches that were reached, by room; a room without any is left out."""
    counts: dict[str, Counter[str]] = {}
    for path, each in files.items():
        counts.setdefault(room_of(path), Counter()).update({part: each["summary"][part] for part in _PARTS})
    wholes = {room: each["num_statements"] + each["num_branches"] for room, each in counts.items()}
    return {
        room: 100 * (each["covered_lines"] + each["covered_branches"]) / wholes[room]
        for room, each in sorted(counts.items())
        if wholes[room]
    }


def judged(covered: Mapping[str, float], reasons: Mapping[str, str], rooms: Iterable[str] = ()) -> tuple[str, bool]:
    """Return the table, of `rooms` or all, and whether each room below LEAST has a reason."""
    wanted = set(rooms) or set(covered)
    lines, good = [], True
    for room, percent in covered.items():
        if room not in wanted:
            continue
        why = "" if percent >= LEAST else reasons.get(room, f"below {LEAST:g} % WITHOUT A REASON in pyproject.toml")
        good = good and (percent >= LEAST or room in reasons)
        lines.append(f"{room:<14}{percent:6.1f} %  {why}".rstrip())
    return "\n".join(lines), good


def main(arguments: Sequence[str]) -> int:
    """Print the table; 1 where a reason is missing."""
    path, *rooms = arguments
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    files = json.loads(Path(path).read_text(encoding="utf-8"))["files"]
    reasons = project["tool"]["room_coverage"]["below"]
    text, good = judged(covered_by_room(files), reasons, [room.split("/")[0] for room in rooms if room[:1] != "-"])
    print(text)
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
