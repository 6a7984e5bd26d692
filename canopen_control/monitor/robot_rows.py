"""The tables of a running robot, made of a sample of its state stream (runtime/status.py has the shape)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.monitor.picture import Cell, LogLine, Picture, Tone, age_cell, plain, sdo_cell, state_cell
from canopen_control.trace.values import statusword_text

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

__all__ = ["is_emergency", "log_line", "picture_of", "without_robot"]

STALE_S: Final = 0.25
"""A node that the robot takes for alive and that has been silent so long is stale; dead is what the robot has lost."""
_ROBOT_TONES: Final = {"running": Tone.GOOD, "fault": Tone.BAD, "starting": Tone.WARN, "stopping": Tone.WARN}
_LEVEL_TONES: Final = {"warning": Tone.WARN, "error": Tone.BAD}
_NO_AXIS: Final[Mapping[str, Any]] = {}


def picture_of(robot: str, state: Mapping[str, Any]) -> Picture:
    """Return the picture of one sample."""
    alarm = ""
    if state.get("latched"):
        alarm = f"STOP is latched by {state['latched_by']}: nothing moves before it is released (key r)"
    return Picture(
        robot,
        Cell(str(state["state"]), _ROBOT_TONES.get(state["state"], Tone.IDLE)),
        alarm,
        tuple(_facts(state)),
        dict(_drives(state)),
        {name: _joint(name, joint) for name, joint in state["joints"].items()},
    )


def without_robot(robot: str, why: str) -> Picture:
    """Return the picture while there is no robot."""
    return Picture(robot, Cell("not connected", Tone.BAD), f"{why}. STOP does not reach it; trying again")


def log_line(event: Mapping[str, Any]) -> LogLine:
    """Return an event as a line."""
    return LogLine(float(event["time"]), str(event["text"]), _LEVEL_TONES.get(str(event["level"]), Tone.PLAIN))


def is_emergency(event: Mapping[str, Any]) -> bool:
    """Whether an event is an emergency object, or tells that one is gone."""
    return str(event["kind"]) in ("emcy", "emcy_reset")


def _facts(state: Mapping[str, Any]) -> Iterator[str]:
    cycle = state["cycle"]
    yield f"cycle {1e3 * cycle['period_s']:g} ms, {cycle['missed']} missed"
    if cycle.get("work_s") is not None:
        yield f"work {1e3 * cycle['work_s']:.2f} ms, at most {1e3 * cycle['work_max_s']:.2f}"
    yield f"late at most {1e3 * cycle['late_max_s']:.2f} ms"
    for bus, load in (state.get("load") or {}).items():
        if load is not None:
            yield f"bus {bus} {100 * load:.1f} %"
    active = [name for name, each in state["controllers"].items() if each == "active"]
    if not state["nodes"]:
        yield "no CANopen drives"
    yield f"active: {', '.join(active) or 'no controller'}"


def _drives(state: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for name, node in state["nodes"].items():
        axes = node["axes"] or [_NO_AXIS]
        for number, axis in enumerate(axes):
            key = name if number == 0 else f"{name}/{axis.get('axis', number)}"
            yield key, _drive(name, node, axis, several=len(axes) > 1)


def _drive(name: str, node: Mapping[str, Any], axis: Mapping[str, Any], *, several: bool) -> tuple[Cell, ...]:
    state = axis.get("cia402_state")
    sdo = node["sdo"]
    which = f"{name} ({node['node_id']})" + (f" axis {axis['axis']}" if several else "")
    dead = 0.0 if node["nmt_state"] is None else float("inf")
    error = str(axis.get("error") or node["error"] or "")
    return (
        plain(which),
        _nmt(node),
        state_cell(None if state is None else State[state]),
        plain(str(axis.get("mode") or "-")),
        age_cell(node["age_s"], stale=STALE_S, dead=dead),
        sdo_cell(sdo["reads"], sdo["writes"], sdo["failed"]),
        Cell(error, Tone.BAD if error else Tone.PLAIN),
        plain(_statusword(axis)),
    )


def _nmt(node: Mapping[str, Any]) -> Cell:
    if node["nmt_state"] is None:
        return Cell("lost" if node["age_s"] is not None else "not there", Tone.BAD)
    name = str(node["nmt_state"]).replace("_", " ")
    return Cell(name, Tone.GOOD) if node["ready"] else Cell(name, Tone.WARN)


def _statusword(axis: Mapping[str, Any]) -> str:
    """Return the statusword with its flags; the state stands in a column of its own."""
    if axis.get("statusword") is None:
        return "-"
    mode = OperationMode.__members__.get(str(axis.get("mode")))
    number, _, rest = statusword_text(int(axis["statusword"]), mode).partition(" ")
    _, _, flags = rest.partition(", ")
    return f"{number} {flags}".rstrip()


def _joint(name: str, joint: Mapping[str, float | None]) -> tuple[Cell, ...]:
    values = (joint.get(key) for key in ("command", "velocity", "position", "effort"))
    return (plain(name), *(plain("-" if value is None else f"{value:.3f}") for value in values))
