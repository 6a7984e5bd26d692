"""Coverage of each subpackage by the tests, in lines and branches, from coverage's JSON report.

A subpackage below MIN says why in pyproject.toml, [tool.subpackage_coverage.below], or the exit code is 1.

    python tools/subpackage_coverage.py build/coverage.json [NAME ...]
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
MIN = 90.0  # percent
_PARTS = ("covered_lines", "covered_branches", "num_statements", "num_branches")


def subpackage_of(path: str) -> str:
    """Return the subpackage of a file: its folder below the package, or the file itself if it is at the top level."""
    parts = Path(path).parts
    return parts[parts.index(PACKAGE) + 1].removesuffix(".py")


def covered_by_subpackage(files: Mapping[str, Any]) -> dict[str, float]:
    """Return the percentage of covered lines and branches for each subpackage that has any."""
    counts: dict[str, Counter[str]] = {}
    for path, file in files.items():
        counts.setdefault(subpackage_of(path), Counter()).update({part: file["summary"][part] for part in _PARTS})
    wholes = {subpackage: count["num_statements"] + count["num_branches"] for subpackage, count in counts.items()}
    return {
        subpackage: 100 * (counted["covered_lines"] + counted["covered_branches"]) / wholes[subpackage]
        for subpackage, counted in sorted(counts.items())
        if wholes[subpackage]
    }


def judged(
    covered: Mapping[str, float], reasons: Mapping[str, str], subpackages: Iterable[str] = ()
) -> tuple[str, bool]:
    """Return the table of `subpackages` or all, and whether each subpackage below MIN has a reason."""
    wanted = set(subpackages) or set(covered)
    lines, good = [], True
    for subpackage, percent in covered.items():
        if subpackage not in wanted:
            continue
        why = "" if percent >= MIN else reasons.get(subpackage, f"below {MIN:g} % WITHOUT A REASON in pyproject.toml")
        good = good and (percent >= MIN or subpackage in reasons)
        lines.append(f"{subpackage:<14}{percent:6.1f} %  {why}".rstrip())
    return "\n".join(lines), good


def main(arguments: Sequence[str]) -> int:
    """Print the table; return 1 if a reason is missing."""
    path, *subpackages = arguments
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    files = json.loads(Path(path).read_text(encoding="utf-8"))["files"]
    reasons = project["tool"]["subpackage_coverage"]["below"]
    text, good = judged(
        covered_by_subpackage(files),
        reasons,
        [subpackage.split("/")[0] for subpackage in subpackages if subpackage[:1] != "-"],
    )
    print(text)
    return 0 if good else 1


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
