"""What `/diagnostics` says of nodes, controllers and the cycle, as plain values: this file imports no ROS.

The law of the file (REP 107): OK when it does what it should; WARN when it is not available and that may be meant (an
axis that is not enabled, a controller that is not active); ERROR when something is broken: a node that is missing or in
fault. The message is one sentence, the values are what a person looks at next.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.ros.conversions import ControllerView

__all__ = ["Diagnosis", "Severity", "diagnose"]

_FAULTS = ("FAULT", "FAULT_REACTION_ACTIVE")
_ENABLED = "OPERATION_ENABLED"


class Severity(enum.IntEnum):
    """The levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class Diagnosis(NamedTuple):
    """One status; `values` are shown in this order."""

    name: str
    hardware_id: str
    level: Severity
    message: str
    values: dict[str, str]


def diagnose(
    robot: str, state: Mapping[str, Any], controllers: Mapping[str, ControllerView], missed_before: int = 0
) -> list[Diagnosis]:
    """Return a status of every node, every controller, what diagnostics broadcasters tell, and the cycle.

    `missed_before` is what was told last time.
    """
    nodes = [_node(robot, name, node) for name, node in state["nodes"].items()]
    loaded = [_controller(robot, each) for each in controllers.values()]
    judged = [_told(robot, name, each) for name, told in (state.get("diagnostics") or {}).items() for each in told]
    return [*nodes, *loaded, *judged, _cycle(robot, state, missed_before)]


def _node(robot: str, name: str, node: Mapping[str, Any]) -> Diagnosis:
    axes = [axis for axis in node.get("axes") or () if axis.get("cia402_state") is not None]
    states = [str(axis["cia402_state"]) for axis in axes]
    level, message = _judge_node(node, states)
    age = node.get("age_s")
    values = {
        "node id": str(node["node_id"]),
        "bus": str(node.get("bus")),
        "NMT state": str(node.get("nmt_state") or "unknown"),
        "age": "never seen" if age is None else f"{age:.3f} s",
    }
    for axis in axes:
        values[f"{axis['joint']} state"] = str(axis["cia402_state"])
        values[f"{axis['joint']} mode"] = str(axis.get("mode") or "none")
        values[f"{axis['joint']} statusword"] = (
            f"0x{axis['statusword']:04X}" if axis.get("statusword") is not None else "-"
        )
    return Diagnosis(f"{robot}: {name}", f"node {node['node_id']}", level, message, values)


def _judge_node(node: Mapping[str, Any], states: list[str]) -> tuple[Severity, str]:
    error = node.get("error") or next((axis["error"] for axis in node.get("axes") or () if axis.get("error")), None)
    if any(state in _FAULTS for state in states):
        return Severity.ERROR, str(error or "the drive is in fault")
    if not node.get("ready", True):
        return Severity.ERROR, str(error or f"not ready, NMT state {node.get('nmt_state') or 'unknown'}")
    if error:
        return Severity.WARN, str(error)
    waiting = [state for state in states if state != _ENABLED]
    if waiting:
        return Severity.WARN, f"not enabled: {', '.join(waiting).replace('_', ' ').lower()}"
    return Severity.OK, "operational"


def _controller(robot: str, controller: ControllerView) -> Diagnosis:
    level = Severity.OK if controller.active else Severity.WARN
    values = {"type": controller.type, "joints": ", ".join(controller.joints)}
    return Diagnosis(f"{robot}: {controller.name}", robot, level, controller.state, values)


def _told(robot: str, broadcaster: str, status: Mapping[str, Any]) -> Diagnosis:
    values = {key: "unknown" if value is None else f"{value:g}" for key, value in status["values"].items()}
    name = f"{robot}: {broadcaster}: {status['name']}"
    return Diagnosis(name, robot, Severity(status["level"]), str(status["message"]), values)


def _cycle(robot: str, state: Mapping[str, Any], missed_before: int) -> Diagnosis:
    cycle = state["cycle"]
    missed = int(cycle["missed"]) - missed_before
    level = Severity.WARN if missed > 0 else Severity.OK
    message = f"{missed} cycles missed since the last report" if missed > 0 else f"the robot is {state['state']}"
    if state["state"] == "fault":
        level, message = Severity.ERROR, "the robot is in fault"
    values = {"period": f"{cycle['period_s'] * 1e3:g} ms", "count": str(cycle["count"]), "missed": str(cycle["missed"])}
    for key, label in (("late_max_s", "latest start"), ("work_max_s", "longest work")):
        if cycle.get(key) is not None:
            values[label] = f"{cycle[key] * 1e3:.3f} ms"
    return Diagnosis(f"{robot}: cycle", robot, level, message, values)
