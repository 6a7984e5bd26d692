"""Drawings of a report as inline SVG: lines over time, states over time, bars; colours come from the page's style.

The law of this file: every drawing is 1000 units wide and scales with the page; the axis of time is the same for all,
so that they can be read under each other. A gap in the data is a gap in the line. A line has at most some 2000 points:
of more, the least and the greatest of each stretch are drawn, so that no peak is lost.
"""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.trace.report_facts import Span

__all__ = ["Axis", "bars", "lines", "timeline"]

WIDTH: Final = 1000
LEFT, RIGHT = 150, 12
_POINTS: Final = 2000
_ROW: Final = 26
_FOOT: Final = 22
_STEPS: Final = (1, 2, 5, 10)


class Axis(NamedTuple):
    """The time that is shown, seconds from the begin, and when the fault was, if any."""

    begin: float
    end: float
    fault: float | None = None

    def x(self, time: float) -> float:
        """Return where a time is."""
        span = max(self.end - self.begin, 1e-9)
        return LEFT + (WIDTH - LEFT - RIGHT) * min(max((time - self.begin) / span, 0.0), 1.0)


def _step(span: float, most: int) -> float:
    """Return a round distance for at most about `most` marks over `span`."""
    raw = max(span / most, 1e-12)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(step * power for step in _STEPS if step * power >= raw * 0.999)


def _marks(low: float, high: float, most: int) -> Iterator[float]:
    step = _step(high - low, most)
    for number in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield number * step


def _grid(axis: Axis, height: float) -> Iterator[str]:
    """Yield the grid of time with its numbers."""
    for mark in _marks(axis.begin, axis.end, 10):
        x = axis.x(mark)
        yield f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'
        yield f'<text class="tick" x="{x:.1f}" y="{height + 15}" text-anchor="middle">{mark:g} s</text>'


def _fault(axis: Axis, height: float) -> Iterator[str]:
    """Yield the line of the fault, which goes over everything else."""
    if axis.fault is not None and axis.begin <= axis.fault <= axis.end:
        x = axis.x(axis.fault)
        yield f'<line class="fault" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'


def _svg(title: str, height: float, parts: Sequence[str]) -> str:
    body = "".join(parts)
    return f'<svg viewBox="0 0 {WIDTH} {height:g}" role="img" aria-label="{escape(title)}">{body}</svg>'


def timeline(title: str, rows: Sequence[tuple[str, Sequence[Span]]], axis: Axis) -> str:
    """Draw states over time: rows of (label, spans); a state's class is ``s-`` and its name."""
    height = _ROW * len(rows)
    parts = list(_grid(axis, height))
    for number, (label, spans) in enumerate(rows):
        y = number * _ROW
        parts.append(f'<text class="label" x="{LEFT - 8}" y="{y + 17}" text-anchor="end">{escape(label)}</text>')
        parts += [_span(span, axis, y) for span in spans]
    return _svg(title, height + _FOOT, [*parts, *_fault(axis, height)])


def _span(span: Span, axis: Axis, y: float) -> str:
    left, right = axis.x(span.begin), axis.x(span.end)
    state = span.state or "unknown"
    words = state.replace("_", " ").lower()
    width = max(right - left, 1.5)
    shown = escape(words) if len(words) * 6.2 < width else ""
    hint = escape(f"{words}, {span.begin:.3f} s to {span.end:.3f} s")
    return (
        f'<g><title>{hint}</title><rect class="s-{escape(state)}" x="{left:.1f}" '
        f'y="{y + 3}" width="{width:.1f}" height="{_ROW - 6}"/>'
        f'<text class="in" x="{left + 5:.1f}" y="{y + 17}">{shown}</text></g>'
    )


def lines(
    title: str,
    time: Sequence[float],
    series: Sequence[tuple[str, Sequence[float | None]]],
    axis: Axis,
    unit: str,
    *,
    from_zero: bool = False,
) -> str:
    """Draw values over time: series of (class, values); "" where there is no value at all."""
    known = [value for _, values in series for value in values if value is not None]
    if not known:
        return ""
    low, high = _bounds([0.0, *known] if from_zero else known)
    height = 130

    def y(value: float) -> float:
        return height - 4 - (height - 8) * (value - low) / (high - low)

    parts = list(_grid(axis, height))
    for mark in _marks(low, high, 4):
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(mark):.1f}" y2="{y(mark):.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 6}" y="{y(mark) + 4:.1f}" text-anchor="end">{mark:g}</text>')
    parts.append(f'<text class="label" x="4" y="14">{escape(title)}</text>')
    parts.append(f'<text class="tick" x="4" y="30">{escape(unit)}</text>')
    for name, values in series:
        path = _path([(axis.x(at), value) for at, value in zip(*_thinned(time, values), strict=True)], y)
        parts.append(f'<path class="line {escape(name)}" d="{path}"/>')
    return _svg(title, height + _FOOT, [*parts, *_fault(axis, height)])


def _bounds(known: Sequence[float]) -> tuple[float, float]:
    low, high = min(known), max(known)
    if high - low < 1e-9:
        margin = max(abs(high) * 0.1, 0.1)
        return low - margin, high + margin
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def _thinned(time: Sequence[float], values: Sequence[float | None]) -> tuple[list[float], list[float | None]]:
    """Return the points, of very many the least and the greatest of each stretch, in their order."""
    if len(time) <= _POINTS:
        return list(time), list(values)
    stretch = math.ceil(2 * len(time) / _POINTS)
    kept: list[int] = []
    for begin in range(0, len(time), stretch):
        part = range(begin, min(begin + stretch, len(time)))
        known = [(value, index) for index in part if (value := values[index]) is not None]
        kept += sorted({min(known)[1], max(known)[1]}) if known else [begin]
    return [time[index] for index in kept], [values[index] for index in kept]


def _path(points: Sequence[tuple[float, float | None]], y: Callable[[float], float]) -> str:
    words, pen = [], False
    for x, value in points:
        if value is None:
            pen = False
            continue
        words.append(f"{'L' if pen else 'M'}{x:.1f} {y(value):.1f}")
        pen = True
    return "".join(words)


def bars(title: str, labels: Sequence[str], counts: Sequence[int]) -> str:
    """Draw a histogram, the heights by the logarithm so that a single late cycle is seen beside a million others."""
    if not any(counts):
        return ""
    height, width = 110, (WIDTH - LEFT - RIGHT) / len(counts)
    most = math.log10(1 + max(counts))
    parts = [f'<text class="label" x="4" y="14">{escape(title)}</text>']
    for number, (label, count) in enumerate(zip(labels, counts, strict=True)):
        x, tall = LEFT + number * width, (height - 24) * math.log10(1 + count) / most
        parts.append(
            f'<rect class="bar" x="{x + 3:.1f}" y="{height - tall:.1f}" width="{width - 6:.1f}" height="{tall:.1f}"/>'
        )
        middle = x + width / 2
        if count:
            parts.append(
                f'<text class="tick" x="{middle:.1f}" y="{height - tall - 4:.1f}" text-anchor="middle">{count}</text>'
            )
        parts.append(
            f'<text class="tick" x="{middle:.1f}" y="{height + 15}" text-anchor="middle">{escape(label)}</text>'
        )
    return _svg(title, height + _FOOT, parts)
