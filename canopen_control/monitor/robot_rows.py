"""The tables of a running robot, made of a sample of its state stream."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import State
from canopen_control.monitor.monitor_content import (
    Cell,
    LogLine,
    MonitorContent,
    Tone,
    age_cell,
    plain,
    sdo_cell,
    state_cell,
)
from canopen_control.rpc.messages.state import AxisReading
from canopen_control.trace.values import statusword_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.state import JointReading, NodeReading, RobotEvent, StateSample

__all__ = ["content_of", "is_emergency", "log_line", "without_robot"]

STALE_S: Final = 0.25
"""A node that the robot takes for alive and that has been silent so long is stale; dead is what the robot has lost."""
_ROBOT_TONES: Final = {
    "running": Tone.GOOD,
    "disabled": Tone.WARN,
    "fault": Tone.BAD,
    "starting": Tone.WARN,
    "stopping": Tone.WARN,
}
_LEVEL_TONES: Final = {"warning": Tone.WARN, "error": Tone.BAD}
_NO_AXIS: Final = AxisReading("")


def content_of(robot: str, state: StateSample) -> MonitorContent:
    """Return the content of one sample."""
    alarm = state.hint or ""
    if state.latched:
        alarm = f"STOP is latched by {state.latched_by}: nothing moves before it is released (key r)"
    return MonitorContent(
        robot,
        Cell(state.state, _ROBOT_TONES.get(state.state, Tone.IDLE)),
        alarm,
        tuple(_facts(state)),
        dict(_drives(state)),
        {name: _joint(joint) for name, joint in state.joints.items()},
    )


def without_robot(robot: str, why: str) -> MonitorContent:
    """Return the content while there is no robot."""
    return MonitorContent(robot, Cell("not connected", Tone.BAD), f"{why}. STOP does not reach it; trying again")


def log_line(event: RobotEvent) -> LogLine:
    """Return an event as a line."""
    return LogLine(event.time, event.text, _LEVEL_TONES.get(event.level, Tone.PLAIN))


def is_emergency(event: RobotEvent) -> bool:
    """Whether an event is an emergency object, or tells that one is gone."""
    return event.kind in ("emcy", "emcy_reset")


def _facts(state: StateSample) -> Iterator[str]:
    cycle = state.cycle
    yield f"cycle {1e3 * cycle.period_s:g} ms, {cycle.missed} missed"
    yield f"work {1e3 * cycle.work_s:.2f} ms, at most {1e3 * cycle.work_max_s:.2f}"
    yield f"late at most {1e3 * cycle.late_max_s:.2f} ms"
    for bus, load in state.load.items():
        if load is not None:
            yield f"bus {bus} {100 * load:.1f} %"
    if not state.nodes:
        yield "no CANopen drives"
    yield f"active: {', '.join(state.active) or 'no controller'}"


def _drives(state: StateSample) -> Iterator[tuple[str, tuple[Cell, ...]]]:
    for name, node in state.nodes.items():
        axes = node.axes or (_NO_AXIS,)
        for number, axis in enumerate(axes):
            yield name if number == 0 else f"{name}/{axis.axis}", _drive(name, node, axis, several=len(axes) > 1)


def _drive(name: str, node: NodeReading, axis: AxisReading, *, several: bool) -> tuple[Cell, ...]:
    which = f"{name} ({node.node_id})" + (f" axis {axis.axis}" if several else "")
    dead = 0.0 if node.nmt_state is None else float("inf")
    error = axis.error or node.error or ""
    return (
        plain(which),
        _nmt(node),
        state_cell(None if axis.state is None else State[axis.state]),
        Cell(error, Tone.BAD if error else Tone.PLAIN),
        age_cell(node.age, stale=STALE_S, dead=dead),
        plain(axis.mode or "-"),
        sdo_cell(node.sdo.reads, node.sdo.writes, node.sdo.failed),
        plain(_statusword(axis)),
    )


def _nmt(node: NodeReading) -> Cell:
    if node.nmt_state is None:
        return Cell("lost" if node.age is not None else "not there", Tone.BAD)
    return Cell(node.nmt_state.replace("_", " "), Tone.GOOD if node.ready else Tone.WARN)


def _statusword(axis: AxisReading) -> str:
    """Return the statusword with its flags; the state stands in a column of its own."""
    if axis.statusword is None:
        return "-"
    mode = OperationMode.__members__.get(axis.mode or "")
    number, _, rest = statusword_text(axis.statusword, mode).partition(" ")
    _, _, flags = rest.partition(", ")
    return f"{number} {flags}".rstrip()


def _joint(joint: JointReading) -> tuple[Cell, ...]:
    values = (joint.command, joint.velocity, joint.position, joint.effort)
    return (plain(joint.name), *(plain("-" if value is None else f"{value:.3f}") for value in values))
