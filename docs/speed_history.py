"""Generate the page of benchmark results over time, from the rows kept by `tools/bench --json`: one chart per family.

Each panel is a figure, each line in it a build of the package. The horizontal axis is the runs in order, the vertical
one the assessed value, from zero. Runs on a busy machine are drawn as rings, all others as dots.
"""

from __future__ import annotations

import json
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

__all__ = ["drawn", "series_of", "write_history"]

_HISTORY = Path(__file__).parent / "reference" / "speed_history.json"
_WIDTH, _HEIGHT, _LEFT, _TOP, _GAP = 640, 90, 60, 34, 52
_COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd")
_STYLE = "font-family:sans-serif;font-size:12px;fill:#555"
_SOURCES = "from the sources"
_BUILDS = {_SOURCES: _SOURCES, "pure Python": _SOURCES, "compiled": "compiled"}  # as named in figures and packages
_IDLE_ENOUGH = 0.9
_PAGE = """# Speed over time

Results of each run of `tools/bench --json docs/reference/speed_history.json`: ratios to comparable packages, if there
are any, else measured values; see [the page of speeds](../reference/speed.md) for their meaning. A ring is a run on a
busy machine: its times are unreliable, its ratios less so.
"""

Series = dict[str, dict[str, list[tuple[int, float]]]]


def series_of(rows: Sequence[Mapping[str, Any]], family: str) -> Series:
    """Return panel -> line -> (run, value) of a family; a line is the build named by the figure or by its run."""
    found: Series = {}
    for run, row in enumerate(rows):
        for name, value in row["figures"].get(family, {}).items():
            panel, _, build = name.rpartition(", ")
            if build not in _BUILDS:
                panel, build = name, str(row["package"])
            found.setdefault(panel, {}).setdefault(_BUILDS.get(build, build), []).append((run, float(value)))
    return found


def write_history(folder: Path) -> None:
    """Write the page and its charts; unchanged files are not rewritten."""
    folder.mkdir(exist_ok=True)
    rows = json.loads(_HISTORY.read_text(encoding="utf-8"))["history"]
    families = dict.fromkeys(family for row in rows for family, figures in row["figures"].items() if figures)
    page = _PAGE
    for family in families:
        page += f"\n## {family}\n\n![{family} over time](speed_history_{family}.svg)\n"
        _write(folder / f"speed_history_{family}.svg", drawn(_HISTORY, family))
    _write(folder / "speed_history.md", page)


def _write(path: Path, text: str) -> None:
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def drawn(path: Path, family: str) -> str:
    """Return the SVG chart of a family, from the file written by the bench."""
    rows = json.loads(path.read_text(encoding="utf-8"))["history"]
    series = series_of(rows, family)
    height = len(series) * (_HEIGHT + _GAP) + _TOP
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH + _LEFT + 90} {height}" role="img">']
    for number, (panel, lines) in enumerate(series.items()):
        parts += _panel(panel, lines, rows, _TOP + number * (_HEIGHT + _GAP))
    return "\n".join([*parts, "</svg>", ""])


def _panel(
    title: str, lines: Mapping[str, list[tuple[int, float]]], rows: Sequence[Mapping[str, Any]], top: int
) -> list[str]:
    most = max(value for points in lines.values() for _, value in points) or 1.0
    bottom, last = top + _HEIGHT, max(1, len(rows) - 1)
    parts = [
        f'<text x="{_LEFT}" y="{top - 10}" style="{_STYLE};font-weight:bold">{escape(title)}</text>',
        f'<path d="M{_LEFT} {top}V{bottom}H{_LEFT + _WIDTH}" fill="none" stroke="#999"/>',
        f'<text x="{_LEFT - 8}" y="{top + 6}" text-anchor="end" style="{_STYLE}">{most:.3g}</text>',
        f'<text x="{_LEFT - 8}" y="{bottom}" text-anchor="end" style="{_STYLE}">0</text>',
        f'<text x="{_LEFT}" y="{bottom + 16}" style="{_STYLE}">{escape(rows[0]["date"][:10])}</text>',
        f'<text x="{_LEFT + _WIDTH}" y="{bottom + 16}" text-anchor="end" style="{_STYLE}">'
        f"{escape(rows[-1]['date'][:10])}</text>",
    ]
    for number, (line, points) in enumerate(lines.items()):
        colour = _COLOURS[number % len(_COLOURS)]
        places = [(_LEFT + _WIDTH * run / last, bottom - _HEIGHT * value / most) for run, value in points]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        parts.append(f'<polyline points="{corners}" fill="none" stroke="{colour}" stroke-width="2"/>')
        for (run, value), (x, y) in zip(points, places, strict=True):
            fill = colour if (rows[run].get("idle") or 0.0) >= _IDLE_ENOUGH else "#fff"
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{fill}" stroke="{colour}">')
            tooltip = " ".join(filter(None, (rows[run]["date"][:10], rows[run].get("commit"), f"{value:.3g}")))
            parts.append(f"<title>{escape(tooltip)}</title></circle>")
        x = _LEFT + 400 + 120 * number
        parts.append(f'<text x="{x}" y="{top - 10}" style="{_STYLE};fill:{colour}">{escape(line)}</text>')
    return parts
