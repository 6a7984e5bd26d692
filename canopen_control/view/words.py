"""Texts of the page about the robot's state, drives and events, with levels for colours, without NiceGUI."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from html import escape
from typing import TYPE_CHECKING, Final

from canopen_control.errors import without_node
from canopen_control.rpc.messages.health import (
    AXIS_STATES,
    BAD,
    GOOD,
    IDLE,
    LATCHED,
    ROBOT_STATES,
    WARN,
    Health,
    StateWords,
    diagnose_axis,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.rpc.messages.drive import FaultListing, QuirkListing
    from canopen_control.rpc.messages.state import (
        AxisReading,
        JointReading,
        NodeReading,
        RobotEvent,
        StateSample,
        TrackingReading,
    )


LATE_S: Final = 0.25  # age from which the time of the last message is shown


@dataclass(frozen=True, slots=True)
class Banner:
    """Robot state for the banner: problem, advice, and the API name of the next action."""

    words: str
    tone: str
    cause: str = ""
    advice: str = ""
    action: str = ""

    @staticmethod
    def of(words: StateWords, cause: str = "") -> Banner:
        """Return the banner of a state; `cause` is the problem, if any."""
        return Banner(words.text, words.tone, cause, words.advice, words.action)


_LEVELS: Final = {"debug": IDLE, "info": IDLE, "warning": WARN, "error": BAD}
_FEW: Final = 3


@dataclass(frozen=True, slots=True)
class AxisRow:
    """Table row of one axis, or of a node without axes; `tone` is the level for the colour, `age` a text."""

    node: str
    node_id: int
    joint: str
    state: str
    tone: str
    mode: str
    age: str
    error: str


def banner(state: StateSample) -> Banner:
    """Return the banner for the robot's state, with the problem and the next step."""
    if state.latched:
        by = f" (by {state.latched_by})" if state.latched_by else ""
        return Banner.of(LATCHED, f"Latched{by}: nothing moves.")
    result = Banner.of(ROBOT_STATES.get(state.state, StateWords(state.state or "unknown", WARN)))
    if result.tone == BAD:
        return replace(result, cause=_causes(axis_rows(state)))
    off = [axis for node in state.nodes.values() for axis in node.axes if not axis.enabled]
    if result.action == "enable" or (result.tone == GOOD and off):  # a stop that has ended leaves the drives disabled
        drives = _disabled_text(off, sum(len(node.axes) for node in state.nodes.values()))
        return Banner.of(ROBOT_STATES["disabled"], state.hint or drives)
    return result


def _disabled_text(off: list[AxisReading], axes: int) -> str:
    if len(off) in (0, axes):
        return "All drives are disabled."
    return f"{', '.join(axis.joint for axis in off)} {'is' if len(off) == 1 else 'are'} disabled."


def lost_banner(why: str) -> Banner:
    """Return the banner for a robot that is not connected, with the reason."""
    return Banner(
        "not connected", BAD, f"STOP on this page does not reach the robot. {why}".strip(),
        "The values on this page are out of date. Use another way to stop the robot (emergency stop, terminal); "
        "the page reconnects automatically.",
    )  # fmt: skip


def _causes(rows: Iterable[AxisRow]) -> str:
    """Return a text with the drives that are missing or in a fault, each with its reason."""
    errors = [(row, without_node(row.error, row.node_id, row.node)) for row in rows if row.tone == BAD]
    texts = dict.fromkeys(f"{row.node}: {error or row.state}" for row, error in errors)
    return " · ".join(texts) or "A drive is missing or in a fault."


def axis_rows(state: StateSample) -> list[AxisRow]:
    """Return a row for every axis and for every node without axes."""
    return [_row(node, axis) for node in state.nodes.values() for axis in node.axes or (None,)]


def _row(node: NodeReading, axis: AxisReading | None) -> AxisRow:
    words, tone = ("", IDLE) if axis is not None else ("no drive profile", IDLE)
    if axis is not None and axis.state in AXIS_STATES:
        words, tone, *_ = AXIS_STATES[axis.state]
    if not node.ready:
        nmt = (node.nmt_state or "").replace("_", "-").lower()
        words, tone = (f"not ready, {nmt}", WARN) if nmt and node.age is not None else ("not there", BAD)
    elif not words:
        words, tone = "no statusword", BAD
    diagnosis = diagnose_axis(node, axis)
    if diagnosis.level is Health.ERROR:
        tone = BAD
    elif diagnosis.level is Health.WARN and tone == GOOD:
        tone = WARN
    error = (axis.error if axis is not None else None) or node.error or ""
    return AxisRow(
        node.name,
        node.node_id,
        axis.joint if axis is not None else "",
        words,
        tone,
        (axis.mode or "") if axis is not None else "",
        "not heard" if words == "not there" and node.age is not None and node.age < LATE_S else _age(node.age),
        error,
    )


def _age(seconds: float | None) -> str:
    if seconds is None:
        return "never heard"
    if seconds < LATE_S:
        return "live"
    return f"{seconds:.1f} s ago" if seconds < 60 else f"{seconds / 60:.0f} min ago"


def drive_table(rows: Iterable[AxisRow]) -> str:
    """Return the table of drives as HTML."""
    rows = list(rows)
    if not rows:
        return "<p class='cc-note'>No drives: this robot is simulated, or runs on mock hardware.</p>"
    titles = "<tr><th>drive</th><th>state</th><th>mode</th><th>last seen</th></tr>"
    many = " cc-many" if len(rows) > _FEW else ""  # one line per drive, so that the events remain visible
    return f"<table class='cc-table{many}'>{titles}{''.join(_table_lines(rows))}</table>"


def _table_lines(rows: Iterable[AxisRow]) -> Iterator[str]:
    for row in rows:
        joint = f"<small>node {row.node_id}{' · ' if row.joint else ''}{escape(row.joint)}</small>"
        late = "" if row.age == "live" else " class='cc-late'"
        yield (
            f"<tr><td><b>{escape(row.node)}</b><br>{joint}</td><td>{chip(row.state, row.tone)}</td>"
            f"<td>{escape(row.mode) or '-'}</td><td{late}>{row.age}</td></tr>"
        )
        if row.error:
            yield f"<tr class='cc-error'><td colspan='4'>{escape(row.error)}</td></tr>"


def joint_table(joints: Mapping[str, JointReading], linear: frozenset[str], commanded: Mapping[str, str]) -> str:
    """Return the table of joints as HTML; `linear` joints are in m, `commanded` maps joints to commanded interfaces."""
    if not joints:
        return "<p class='cc-note'>No joints.</p>"
    lines = []
    for name, joint in joints.items():
        unit = "m" if name in linear else "rad"
        interface = commanded.get(name, "")
        command = (
            f"{_number(joint.command)}<wbr><small>{escape(interface)}</small>" if joint.command is not None else "-"
        )
        lines.append(
            f"<tr><td><b>{escape(name)}</b></td><td>{_number(joint.position)}<wbr><small>{unit}</small></td>"
            f"<td>{_number(joint.velocity)}<wbr><small>{unit}/s</small></td><td>{_number(joint.effort)}</td>"
            f"<td>{command}</td></tr>"
        )
        if joint.tracking is not None:  # in a row of its own, because a column would be too wide
            lines.append(f"<tr class='cc-tracking'><td colspan='5'>{_tracking(joint.tracking, unit)}</td></tr>")
    titles = "".join(f"<th>{joint_title}</th>" for joint_title in _JOINT_TITLES)
    return f"<table class='cc-table cc-joints'><tr>{titles}</tr>{''.join(lines)}</table>"


_JOINT_TITLES: Final = ("joint", "position", "velocity", "effort", "command")


def _tracking(reading: TrackingReading, unit: str) -> str:
    """Return, as HTML, the maximum and RMS tracking error of a joint, and its repeated and skipped set-points."""
    per = "" if reading.interface == "position" else "/s"
    odd = [
        f"{count} {title}" for count, title in ((reading.repeated, "repeated"), (reading.skipped, "skipped")) if count
    ]
    words = ", ".join([f"{reading.error_rms:.2g}", *odd])
    return f"tracking error {reading.error_max:.2g}<small>{unit}{per}, RMS {words}</small>"


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if abs(value) >= 1000 else f"{value + 0.0:.2f}"


def facts(state: StateSample) -> str:
    """Return, as HTML, a line about the cycle, the buses and the active controllers."""
    return f"<div class='cc-facts'>{' · '.join(_facts(state))}</div>"


def _facts(state: StateSample) -> Iterator[str]:
    active = state.active
    yield f"cycle {1e3 * state.cycle.period_s:g} ms"
    yield f"{state.cycle.missed} missed" if state.cycle.missed else "none missed"
    for bus, load in state.load.items():
        if load is not None:
            yield f"bus {escape(bus)} {100 * load:.1f} %"
    yield f"active: {escape(', '.join(active)) or 'no controller'}"
    if state.true_pose is not None:
        yield escape(state.true_pose.words)


def event_log(events: Iterable[RobotEvent]) -> str:
    """Return the list of events as HTML, newest first."""
    lines = [
        f"<div class='cc-event cc-{_LEVELS.get(event.level, IDLE)}'><time>{_clock(event.time)}</time>"
        f"<span>{escape(event.text)}</span></div>"
        for event in reversed(list(events))
    ]
    return "".join(lines) or "<p class='cc-note'>No events yet.</p>"


def fault_text(fault: FaultListing | None) -> str:
    """Return the explanation of a virtual drive's fault as HTML, or a note if `fault` is None."""
    if fault is None:
        return "<p class='cc-note'>No virtual drive is running.</p>"
    duration = "once" if fault.once else "until it is switched off"
    effect = f"I{fault.does[1:]}" if fault.does.startswith("its ") else f"The drive {fault.does}"
    return (
        f"<p class='cc-note'>{escape(effect)} ({duration}).<br><b>A correct master:</b> {escape(fault.reaction)}.</p>"
    )


def quirk_text(quirk: QuirkListing | None) -> str:
    """Return the explanation of a virtual drive's quirk as HTML, or "" if `quirk` is None."""
    if quirk is None:
        return ""
    strength = ""
    if quirk.default is not None:
        strength = (
            f"<br><b>Strength:</b> {quirk.low:g} to {quirk.high:g} {escape(quirk.unit)} (default: {quirk.default:g})"
        )
    source = f"<b>Deviates from</b> {escape(quirk.clause or 'no clause')}; source: {escape(quirk.source)}"
    return f"<p class='cc-note'>The drive {escape(quirk.does)}.{strength}<br>{source}</p>"


def active_faults(active: Mapping[str, Iterable[str]]) -> str:
    """Return the active faults and quirks by drive as HTML."""
    lines = [f"{escape(drive)}: {escape(', '.join(names))}" for drive, names in active.items() if names]
    if not lines:
        return "<p class='cc-note'>No fault is active.</p>"
    return f"<p class='cc-note cc-on'><b>Active now:</b><br>{'<br>'.join(lines)}</p>"


def chip(words: str, tone: str) -> str:
    """Return a coloured label as HTML."""
    return f"<span class='cc-chip cc-{tone}'>{escape(words)}</span>"


def sentence(text: str, tone: str = IDLE) -> str:
    """Return a line of text as HTML; "" for an empty text."""
    return f"<p class='cc-line cc-{tone}'>{escape(text)}</p>" if text else ""


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds)) + f".{int(seconds * 10) % 10}"
