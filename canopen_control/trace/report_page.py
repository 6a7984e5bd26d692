"""Page of a report: one self-contained HTML file for light and dark screens and for printing.

The page loads nothing and runs no script; its content security policy enforces this. All text of a recording is
escaped.
"""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.rpc.messages.health import AXIS_STATES, BAD, GOOD, IDLE, WARN
from canopen_control.rpc.messages.state import UNITS
from canopen_control.rpc.quick_verbs import state_name
from canopen_control.trace.report_facts import clock
from canopen_control.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from canopen_control.rpc.messages.state import BootStep
    from canopen_control.trace.report_facts import EventFacts, FrameFacts, ReportFacts, Span


# -- drawings as inline SVG: lines over time, states over time, bars; the style of the page gives the colours. Every
# drawing is 1000 units wide and scales with the page; all have the same time axis, so that they can be compared. A gap
# in the data is a gap in the line. A line has at most about 2000 points: beyond that, the minimum and maximum of each
# interval are drawn, so that no peak is lost.


WIDTH: Final = 1000
LEFT, RIGHT = 150, 12
_POINTS: Final = 2000
_ROW: Final = 26
_FOOT: Final = 22
_STEPS: Final = (1, 2, 5, 10)


class TimeAxis(NamedTuple):
    """Time axis in s from the beginning of the recording, with the time of the fault or None."""

    begin: float
    end: float
    fault: float | None = None

    def x(self, time: float) -> float:
        """Return the x coordinate of a time; times outside the axis are moved to its ends."""
        span = max(self.end - self.begin, 1e-9)
        return LEFT + (WIDTH - LEFT - RIGHT) * min(max((time - self.begin) / span, 0.0), 1.0)


def _step(span: float, most: int) -> float:
    """Return a round interval that gives at most about `most` ticks over `span`."""
    raw = max(span / most, 1e-12)
    power = 10.0 ** math.floor(math.log10(raw))
    return next(step * power for step in _STEPS if step * power >= raw * 0.999)


def _marks(low: float, high: float, most: int) -> Iterator[float]:
    step = _step(high - low, most)
    for number in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1):
        yield number * step


def _grid(axis: TimeAxis, height: float) -> Iterator[str]:
    """Yield the SVG elements of the time grid: its lines and tick labels."""
    for mark in _marks(axis.begin, axis.end, 10):
        x = axis.x(mark)
        yield f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'
        yield f'<text class="tick" x="{x:.1f}" y="{height + 15}" text-anchor="middle">{mark:g} s</text>'


def _fault(axis: TimeAxis, height: float) -> Iterator[str]:
    """Yield the line that marks the fault, which must be drawn over all other elements."""
    if axis.fault is not None and axis.begin <= axis.fault <= axis.end:
        x = axis.x(axis.fault)
        yield f'<line class="fault" x1="{x:.1f}" x2="{x:.1f}" y1="0" y2="{height}"/>'


def _svg(title: str, height: float, parts: Sequence[str]) -> str:
    body = "".join(parts)
    return f'<svg viewBox="0 0 {WIDTH} {height:g}" role="img" aria-label="{escape(title)}">{body}</svg>'


def timeline(title: str, rows: Sequence[tuple[str, Sequence[Span]]], axis: TimeAxis) -> str:
    """Draw the states of each row over time; the CSS class of a state is ``s-`` plus its name."""
    height = _ROW * len(rows)
    parts = list(_grid(axis, height))
    for number, (label, spans) in enumerate(rows):
        y = number * _ROW
        parts.append(f'<text class="label" x="{LEFT - 8}" y="{y + 17}" text-anchor="end">{escape(label)}</text>')
        parts += [_span(span, axis, y) for span in spans]
    return _svg(title, height + _FOOT, [*parts, *_fault(axis, height)])


def _span(span: Span, axis: TimeAxis, y: float) -> str:
    left, right = axis.x(span.begin), axis.x(span.end)
    state = span.state or "unknown"
    words = state_name(state).lower()
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
    axis: TimeAxis,
    unit: str,
    *,
    from_zero: bool = False,
) -> str:
    """Draw values over time as lines; `series` are pairs of CSS class and values. Return "" without values."""
    values_shown = [value for _, values in series for value in values if value is not None]
    if not values_shown:
        return ""
    low, high = _bounds([0.0, *values_shown] if from_zero else values_shown)
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


def _bounds(values: Sequence[float]) -> tuple[float, float]:
    low, high = min(values), max(values)
    if high - low < 1e-9:
        margin = max(abs(high) * 0.1, 0.1)
        return low - margin, high + margin
    margin = 0.06 * (high - low)
    return low - margin, high + margin


def _thinned(time: Sequence[float], values: Sequence[float | None]) -> tuple[list[float], list[float | None]]:
    """Return the points; if there are too many, only the minimum and maximum of each interval."""
    if len(time) <= _POINTS:
        return list(time), list(values)
    stretch = math.ceil(2 * len(time) / _POINTS)
    indices: list[int] = []
    for begin in range(0, len(time), stretch):
        part = range(begin, min(begin + stretch, len(time)))
        known_points = [(value, index) for index in part if (value := values[index]) is not None]
        indices += sorted({min(known_points)[1], max(known_points)[1]}) if known_points else [begin]
    return [time[index] for index in indices], [values[index] for index in indices]


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
    """Draw a histogram with logarithmic heights, so that one late cycle is visible among a million others."""
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


_MAX_EVENTS: Final = 500
_STYLE: Final = """
:root{--bg:#fff;--fg:#1b1f24;--soft:#57606a;--grid:#d8dee4;--card:#f6f8fa;--cmd:#b35900;--act:#0a5fd0;--err:#a626a4;
--ok:#2da44e;--mid:#8fb8ff;--off:#c9d1d9;--warn:#d4a72c;--bad:#e5484d;
--badbg:#ffebe9;--warnbg:#fff8c5;--in:#111}
@media screen and (prefers-color-scheme:dark){:root{--bg:#0d1117;--fg:#e6edf3;--soft:#9aa5b1;--grid:#2b323b;
--card:#161b22;--cmd:#ffb057;--act:#6cb0ff;--err:#dd8bff;--ok:#2c8f4a;--mid:#3564a8;--off:#39424d;--warn:#9e6a03;
--bad:#d1383d;--badbg:#3a1418;--warnbg:#33290a;--in:#fff}}
@media print{:root{--fg:#000;--soft:#444;--card:#fff}body{padding:0}section{break-inside:avoid}
.long{break-inside:auto}}
*{box-sizing:border-box;print-color-adjust:exact;-webkit-print-color-adjust:exact}
body{margin:0 auto;padding:1.2rem;max-width:1100px;background:var(--bg);color:var(--fg);
font:15px/1.45 system-ui,-apple-system,"Segoe UI",sans-serif}
h1{font-size:1.45rem;margin:.2rem 0 .6rem}h2{font-size:1.05rem;margin:1.6rem 0 .4rem}
.sum{background:var(--card);border-left:5px solid var(--ok);padding:.7rem 1rem;border-radius:4px}
.sum.bad{border-color:var(--bad)}.sum p{margin:.25rem 0}.sum p.first{font-weight:600}
.soft,.key{color:var(--soft);font-size:.85rem}.key b{font-weight:600}
svg{display:block;width:100%;height:auto;margin:.3rem 0;font:11px system-ui,sans-serif}
svg text{fill:var(--fg)}svg .tick{fill:var(--soft)}svg .label{font-weight:600;font-size:12px}svg .in{fill:var(--in)}
.grid{stroke:var(--grid);stroke-width:1}.fault{stroke:var(--bad);stroke-width:2;stroke-dasharray:5 3}
.line{fill:none;stroke-width:1.6;stroke-linejoin:round}.command{stroke:var(--cmd)}.actual{stroke:var(--act)}
.error{stroke:var(--err)}.load{stroke:var(--act)}.bar{fill:var(--act)}
rect{fill:var(--mid)}.s-OPERATIONAL{fill:var(--ok)}.s-unknown,.s-STOPPED{fill:var(--off)}
table{border-collapse:collapse;width:100%;font-size:.84rem}
th{text-align:left;white-space:nowrap;color:var(--soft);font-weight:600;border-bottom:1px solid var(--grid)}
td,th{padding:.16rem .6rem .16rem 0;vertical-align:top}td.n,th.n{text-align:right;white-space:nowrap}
td.m{font-family:ui-monospace,Consolas,monospace;white-space:nowrap;font-size:.8rem}
tr.error{background:var(--badbg)}tr.warning{background:var(--warnbg)}tr.here td{border-top:2px dashed var(--bad)}
.wide{overflow-x:auto}
"""
_FILLS: Final = "".join(
    f".s-{state}{{fill:var(--{ {GOOD: 'ok', IDLE: 'off', WARN: 'warn', BAD: 'bad'}[words.tone] })}}"
    for state, words in AXIS_STATES.items()
)


def page_of(facts: ReportFacts) -> str:
    """Format the facts of a recording as an HTML page."""
    title = f"{facts.robot or 'CAN recording'}, {clock(facts.end, date=True)}"
    sections = (
        _summary,
        _timeline,
        _joints,
        _tracking,
        _measured,
        _events,
        _boot,
        _cycle,
        _buses,
        _last_words,
        _frames,
    )
    body = "\n".join(part for section in sections for part in section(facts))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        """<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">"""
        f"<title>{escape(title)}</title><style>{_STYLE}{_FILLS}</style></head><body>\n<h1>{escape(title)}</h1>\n{body}\n"
        f'<p class="soft">Written by canopen-control {escape(__version__)}. Times are seconds from '
        f"{escape(clock(facts.begin, date=True))}; the dashed line is the first fault.</p>\n</body></html>\n"
    )


def _section(title: str, content: str, *, kind: str = "") -> str:
    return f'<section class="{kind}"><h2>{escape(title)}</h2>\n{content}</section>'


def _table(headings: Sequence[str], rows: Iterable[tuple[str, Sequence[tuple[str, str]]]]) -> str:
    """Return an HTML table; a row is (CSS class, cells), a cell is (CSS class, text), and `headings` come first."""
    rows = list(rows)
    shapes = [shape for shape, _ in rows[0][1]] if rows else [""] * len(headings)
    head = "".join(f'<th class="{shape}">{escape(text)}</th>' for shape, text in zip(shapes, headings, strict=True))
    body = "".join(
        f'<tr class="{kind}">'
        + "".join(f'<td class="{shape}">{escape(text)}</td>' for shape, text in cells)
        + "</tr>\n"
        for kind, cells in rows
    )
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table></div>'


def _axis(facts: ReportFacts) -> TimeAxis:
    return TimeAxis(0.0, facts.seconds, facts.fault_at)


def _summary(facts: ReportFacts) -> Iterator[str]:
    sentences = "".join(
        f'<p class="{"first" if text.startswith("First error") else ""}">{escape(text)}</p>' for text in facts.summary
    )
    yield f'<div class="sum {"bad" if facts.fault else ""}">{sentences}</div>'


def _timeline(facts: ReportFacts) -> Iterator[str]:
    rows = []
    for name, node in facts.nodes.items():
        rows += [(f"{name}: {joint}" if len(node.axes) > 1 else name, spans) for joint, spans in node.axes.items()]
        rows.append((f"{name} NMT" if node.axes else name, node.nmt))
    if rows:
        yield _section(
            "States of the drives (CiA 402) and of their communication (NMT)", timeline("states", rows, _axis(facts))
        )


def _joints(facts: ReportFacts) -> Iterator[str]:
    drawn = []
    for name, joint in facts.joints.items():
        (unit, _), pair = UNITS[joint.quantity], [("command", joint.command), ("actual", joint.actual)]
        drawn.append(lines(name, joint.time, pair, _axis(facts), f"{joint.quantity}, {unit}"))
        drawn.append(lines("following error", joint.time, [("error", joint.error)], _axis(facts), unit))
    if any(drawn):
        key = '<p class="key"><b style="color:var(--cmd)">command</b> and <b style="color:var(--act)">actual</b></p>'
        yield _section("Joints", key + "".join(drawn))


def _tracking(facts: ReportFacts) -> Iterator[str]:
    """Yield a table of the last tracking quality that the master measured for each joint."""
    rows = []
    for name, joint in facts.joints.items():
        if (tracking := joint.tracking) is not None:
            numbers = (
                tracking.error_max,
                tracking.error_rms,
                tracking.error_max_since_enable,
                tracking.error_rms_since_enable,
            )
            cells = [("", name), ("", tracking.interface), *(("n", f"{number:.2g}") for number in numbers)]
            rows.append(("", [*cells, ("n", str(tracking.repeated)), ("n", str(tracking.skipped))]))
    if rows:
        yield _section("Tracking error, rad or rad/s, and set-points", _table(_TRACKING_HEADINGS, rows))


_TRACKING_HEADINGS: Final = (
    "joint", "follows", "max", "RMS", "max since enable", "RMS since enable", "repeated", "skipped",
)  # fmt: skip


def _measured(facts: ReportFacts) -> Iterator[str]:
    """Yield the measured values of sensors, batteries, inputs, outputs and grippers."""
    rows = [
        ("", [("", fact.controller), ("", fact.what), *(("n", f"{value:.4g}") for value in numbers), ("", fact.unit)])
        for fact in facts.measured
        for numbers in [(fact.least, fact.most, fact.last)]
    ]
    if rows:
        yield _section("Measured", _table(("controller", "value", "min", "max", "last", "unit"), rows), kind="long")


def _events(facts: ReportFacts) -> Iterator[str]:
    events = facts.events[-_MAX_EVENTS:]
    rows = [(event.level, _event_cells(event)) for event in events]
    if rows:
        left_out = len(facts.events) - len(events)
        more = f'<p class="soft">{left_out} older events are omitted.</p>' if left_out else ""
        yield _section("Events", more + _table(("s", "time", "node", "event"), rows), kind="long")


def _event_cells(event: EventFacts) -> list[tuple[str, str]]:
    times = [("n", f"{event.at:.3f}"), ("n", clock(event.time))]
    return [*times, ("", event.node or ""), ("", event.text)]


def _frames(facts: ReportFacts) -> Iterator[str]:
    if not facts.frames:
        return
    fault = facts.fault_at
    rows, fault_marked = [], False
    for frame in facts.frames:
        here = fault is not None and frame.time > fault and not fault_marked
        fault_marked = fault_marked or here
        rows.append((f"{frame.mark}{' here' if here else ''}", _frame_cells(frame, fault)))
    title = "Frames around the fault" if fault is not None else "The last frames"
    headings = _FRAME_HEADINGS if fault is not None else ("time", *_FRAME_HEADINGS[1:])
    yield _section(title, _table(headings, rows), kind="long")


def _last_words(facts: ReportFacts) -> Iterator[str]:
    if facts.last_words and facts.fault:
        rows = [(frame.mark, _frame_cells(frame, facts.fault.at)) for frame in facts.last_words]
        yield _section("Last frame of each node before the fault", _table(_FRAME_HEADINGS, rows))


_FRAME_HEADINGS: Final = ("ms to fault", "id", "data", "node", "service", "content")


def _frame_cells(frame: FrameFacts, fault: float | None) -> list[tuple[str, str]]:
    time = f"{frame.time:.4f} s" if fault is None else f"{1e3 * (frame.time - fault):+.2f}"
    return [
        ("n", time),
        ("m", frame.id),
        ("m", frame.data),
        ("", frame.node),
        ("", frame.service),
        ("", frame.text),
    ]


def _boot(facts: ReportFacts) -> Iterator[str]:
    """Yield a table with the durations of the boot steps and the SDO traffic of each node."""
    nodes: dict[str, list[BootStep]] = {}
    for step in facts.boot:
        nodes.setdefault(step.node, []).append(step)
    steps = list(dict.fromkeys(step.step for step in facts.boot))
    if not steps:
        return
    rows = []
    for name, node in nodes.items():
        took = {step.step: step for step in node}
        cells = [("", name), *(("n", _step_text(took.get(step))) for step in steps)]
        cells.append(("n", f"{1e3 * sum(step.seconds or 0.0 for step in node):.1f}"))
        sdo = facts.sdo.get(name)
        cells += [("n", str(cell)) for cell in (("", "", "") if sdo is None else (sdo.reads, sdo.writes, sdo.failed))]
        errors = "; ".join(step.error for step in node if step.error)
        rows.append(("error" if errors else "", [*cells, ("", errors)]))
    headings = ("node", *(f"{step}, ms" for step in steps), "all, ms", "SDO reads", "writes", "failed", "")
    yield _section("Boot", _table(headings, rows))


def _step_text(step: BootStep | None) -> str:
    return "" if step is None or step.seconds is None else f"{1e3 * step.seconds:.1f}"


def _cycle(facts: ReportFacts) -> Iterator[str]:
    cycle = facts.cycle
    if cycle is None or not cycle.late_edges_s:
        return
    edges = cycle.late_edges_s
    if len(cycle.late_counts) != len(edges) + 1:
        return
    names = [_duration(edge) for edge in edges]
    drawn = bars("cycles", [*(f"≤ {name}" for name in names), f"> {names[-1]}"], cycle.late_counts)
    if drawn:
        note = (
            f'<p class="soft">Lateness of the cycles of {1e3 * cycle.period_s:g} ms; heights are logarithmic. '
            f"The longest work of a cycle in the run took {1e3 * cycle.work_max_s:.2f} ms.</p>"
        )
        yield _section("Jitter of the cycle", drawn + note)


def _duration(seconds: float) -> str:
    return f"{1e6 * seconds:g} µs" if seconds < 1e-3 else f"{1e3 * seconds:g} ms"


def _buses(facts: ReportFacts) -> Iterator[str]:
    for name, bus in facts.buses.items():
        percent = [100.0 * value for value in bus.load.value]
        unit = f"% of {bus.bitrate / 1e6:g} Mbit/s"
        drawn = lines(name, bus.load.time, [("load", percent)], _axis(facts), unit, from_zero=True)
        services = ", ".join(f"{count} {service}" for service, count in bus.services.items())
        yield _section(f"Load of bus {name}", f'{drawn}<p class="soft">{bus.frames} frames: {escape(services)}</p>')
