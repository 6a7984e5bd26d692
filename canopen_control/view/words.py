"""What the page says in words: pieces of HTML made of the runtime's plain data.

The law of this file: everything that comes from outside is escaped, and a state is always said in words beside its
colour.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

__all__ = ["AxisRow", "active_faults", "alarm", "axis_rows", "drive_table", "event_log", "fault_text", "head"]

GOOD, IDLE, WARN, BAD = "good", "idle", "warn", "bad"
LATE_S: Final = 0.25  # a drive that has not been heard of for so long is shown with its age

#: CiA 402 states: what they mean to who looks, and how good that is
_STATES: Final = {
    "NOT_READY_TO_SWITCH_ON": ("starting up", IDLE),
    "SWITCH_ON_DISABLED": ("disabled", IDLE),
    "READY_TO_SWITCH_ON": ("disabled, ready to switch on", IDLE),
    "SWITCHED_ON": ("switched on, not enabled", WARN),
    "OPERATION_ENABLED": ("enabled, follows commands", GOOD),
    "QUICK_STOP_ACTIVE": ("quick stop", WARN),
    "FAULT_REACTION_ACTIVE": ("fault, stopping", BAD),
    "FAULT": ("fault", BAD),
}
#: runtime states
_ROBOT: Final = {
    "starting": ("starting", WARN),
    "running": ("running", GOOD),
    "fault": ("running, a drive is missing or in a fault", BAD),
    "stopping": ("stopping", WARN),
    "stopped": ("stopped", IDLE),
}
_NOTE: Final = (
    "<p class='cc-note'>STOP (or the space bar) ramps every joint to zero, disables the drives and stays latched. "
    "No safety function (ISO 13850).</p>"
)
_FEW: Final = 3
_LEVELS: Final = {"debug": IDLE, "info": IDLE, "warning": WARN, "error": BAD}


@dataclass(frozen=True, slots=True)
class AxisRow:
    """One axis of a node, or a node without axes; `tone` is how good its state is, `age` in words."""

    node: str
    node_id: int
    joint: str
    state: str
    tone: str
    mode: str
    age: str
    error: str


def axis_rows(state: Mapping[str, Any]) -> list[AxisRow]:
    """Return a row for every axis of a sample of the state stream."""
    return [_row(name, node, axis) for name, node in state["nodes"].items() for axis in node["axes"] or [{"joint": ""}]]


def _row(name: str, node: Mapping[str, Any], axis: Mapping[str, Any]) -> AxisRow:
    words, tone = _STATES.get(str(axis.get("cia402_state")), ("no drive profile" if not node["axes"] else "", IDLE))
    if not node["ready"]:
        nmt = str(node["nmt_state"] or "").replace("_", "-").lower()
        words, tone = (f"not ready, {nmt}", WARN) if nmt and node["age_s"] is not None else ("not there", BAD)
    elif not words:
        words, tone = "no statusword", BAD
    error = str(axis.get("error") or node["error"] or "")
    return AxisRow(
        name, node["node_id"], str(axis.get("joint") or ""), words, BAD if node["error"] and tone != GOOD else tone,
        str(axis.get("mode") or ""), _age(node["age_s"]), error,
    )  # fmt: skip


def _age(seconds: float | None) -> str:
    if seconds is None:
        return "never heard"
    if seconds < LATE_S:
        return "live"
    return f"{seconds:.1f} s ago" if seconds < 60 else f"{seconds / 60:.0f} min ago"


def drive_table(rows: Iterable[AxisRow]) -> str:
    """Return the table of drives."""
    rows = list(rows)
    if not rows:
        return "<p class='cc-note'>No drives: this robot is simulated, or runs on mock hardware.</p>"
    titles = "<tr><th>drive</th><th>state</th><th>mode</th><th>heard</th></tr>"
    many = " cc-many" if len(rows) > _FEW else ""  # a line for each, so that the events stay in sight
    return f"<table class='cc-table{many}'>{titles}{''.join(_table_lines(rows))}</table>"


def _table_lines(rows: Iterable[AxisRow]) -> Iterator[str]:
    for row in rows:
        joint = f"<small>node {row.node_id}{' · ' if row.joint else ''}{escape(row.joint)}</small>"
        late = "" if row.age == "live" else " class='cc-late'"
        yield (
            f"<tr><td><b>{escape(row.node)}</b><br>{joint}</td><td>{_chip(row.state, row.tone)}</td>"
            f"<td>{escape(row.mode) or '-'}</td><td{late}>{row.age}</td></tr>"
        )
        if row.error:
            yield f"<tr class='cc-error'><td colspan='4'>{escape(row.error)}</td></tr>"


def head(robot: str, state: Mapping[str, Any] | None) -> str:
    """Return the first line of the page: who it is and how it is; `state` None while there is no connection."""
    words, tone = ("not connected", BAD) if state is None else _ROBOT.get(state["state"], (state["state"], IDLE))
    if state is not None and state.get("latched"):
        words, tone = "STOP is latched", BAD
    return f"<div class='cc-head'><span class='cc-name'>{escape(robot)}</span>{_chip(words, tone)}</div>"


def alarm(state: Mapping[str, Any] | None, why: str = "") -> str:
    """Return what stands below STOP: whether it is latched, or does not reach the robot for the reason `why`."""
    if state is None:
        lost = "No connection to the robot. STOP does not reach it."
        return f"<div class='cc-alarm cc-lost'>{lost}<br>{escape(why)}</div>"
    facts = f"{_NOTE}<div class='cc-facts'>{' · '.join(_facts(state))}</div>"
    if not state.get("latched"):
        return facts
    by = escape(str(state["latched_by"]))
    return f"<div class='cc-alarm'>Latched by {by}: nothing moves before it is released.</div>{facts}"


def _facts(state: Mapping[str, Any]) -> Iterator[str]:
    active = [name for name, each in state["controllers"].items() if each == "active"]
    yield f"cycle {1e3 * state['cycle']['period_s']:g} ms"
    missed = state["cycle"]["missed"]
    yield f"{missed} missed" if missed else "none missed"
    for bus, load in (state.get("load") or {}).items():
        if load is not None:
            yield f"bus {escape(bus)} {100 * load:.1f} %"
    yield f"active: {escape(', '.join(active)) or 'no controller'}"


def event_log(events: Iterable[Mapping[str, Any]]) -> str:
    """Return the log, newest first."""
    lines = [
        f"<div class='cc-event cc-{_LEVELS.get(event['level'], IDLE)}'><time>{_clock(event['time'])}</time>"
        f"<span>{escape(event['text'])}{_times(event.get('times', 1))}</span></div>"
        for event in reversed(list(events))
    ]
    title = f"<div class='cc-note'>{'Events, newest first' if lines else 'Nothing has happened yet'}</div>"
    return f"<div class='cc-log'>{title}{''.join(lines)}</div>"


def _times(count: int) -> str:
    return f" <b>({count} times)</b>" if count > 1 else ""


def fault_text(fault: Mapping[str, Any] | None) -> str:
    """Explain a fault of a virtual drive."""
    if fault is None:
        return "<p class='cc-note'>No virtual drive is there to be broken.</p>"
    how = "once" if fault["once"] else "until it is switched off"
    does = str(fault["does"])
    what = f"I{does[1:]}" if does.startswith("its ") else f"The drive {does}"
    return f"<p class='cc-note'>{escape(what)} ({how}).<br><b>A good master:</b> {escape(fault['reaction'])}.</p>"


def active_faults(found: Mapping[str, Iterable[str]]) -> str:
    """Say which faults are on, by drive."""
    lines = [f"{escape(drive)}: {escape(', '.join(names))}" for drive, names in found.items() if names]
    if not lines:
        return "<p class='cc-note'>No fault is on.</p>"
    return f"<p class='cc-note cc-on'><b>On now:</b><br>{'<br>'.join(lines)}</p>"


def _chip(words: str, tone: str) -> str:
    return f"<span class='cc-chip cc-{tone}'>{escape(words)}</span>"


def _clock(seconds: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(seconds)) + f".{int(seconds * 10) % 10}"
