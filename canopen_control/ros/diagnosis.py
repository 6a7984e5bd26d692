"""Contents of `/diagnostics` as plain values, without importing ROS.

Rules (REP 107): OK if a component works; WARN if it is not available, possibly on purpose (an axis or robot that is not
enabled, a controller that is not active); ERROR if something is broken (a node that is missing or in fault). The
message is one sentence; the values are the details that help to find the cause.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.rpc.messages.health import Health, diagnose_node
from canopen_control.rpc.messages.samples import DiagnosticsSample

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.rpc.messages.samples import JointDiagnosis
    from canopen_control.rpc.messages.state import ControllerReading, NodeReading, StateSample


_TROUBLE: Final = {
    "fault": (Health.ERROR, "the robot is in fault"),
    "disabled": (Health.WARN, "the robot is not enabled"),
}


class Diagnosis(NamedTuple):
    """Diagnostic status of one component; `values` keep their order."""

    name: str
    hardware_id: str
    level: Health
    message: str
    values: dict[str, str]


def diagnose(
    robot: str, state: StateSample, controllers: Mapping[str, ControllerReading], missed_before: int = 0
) -> list[Diagnosis]:
    """Return the diagnostic status of the nodes, the controllers, the diagnostics broadcasters and the cycle.

    `missed_before` is the number of missed cycles in the previous report.
    """
    nodes = [_node(robot, name, node) for name, node in state.nodes.items()]
    loaded = [_controller(robot, controller) for controller in controllers.values()]
    judged = [
        _diagnostic(robot, name, joint)
        for name, sample in state.samples_of(DiagnosticsSample).items()
        for joint in sample.joints
    ]
    return [*nodes, *loaded, *judged, _cycle(robot, state, missed_before)]


def _node(robot: str, name: str, node: NodeReading) -> Diagnosis:
    axes = [axis for axis in node.axes if axis.state is not None]
    level, message = diagnose_node(node)
    values = {
        "node id": str(node.node_id),
        "bus": node.bus,
        "NMT state": node.nmt_state or "unknown",
        "age": "never seen" if node.age is None else f"{node.age:.3f} s",
    }
    values |= {} if node.fault is None else node.fault.values
    for axis in axes:
        values[f"{axis.joint} state"] = str(axis.state)
        values[f"{axis.joint} mode"] = axis.mode or "none"
        values[f"{axis.joint} statusword"] = "-" if axis.statusword is None else f"0x{axis.statusword:04X}"
        if axis.fault is not None and axis.fault.error_code is not None:
            values[f"{axis.joint} error code"] = axis.fault.code_text
    return Diagnosis(f"{robot}: {name}", f"node {node.node_id}", level, message, values)


def _controller(robot: str, controller: ControllerReading) -> Diagnosis:
    level = Health.OK if controller.active else Health.WARN
    values = {"type": controller.type, "joints": ", ".join(controller.joints)}
    return Diagnosis(f"{robot}: {controller.name}", robot, level, controller.state, values)


def _diagnostic(robot: str, broadcaster: str, status: JointDiagnosis) -> Diagnosis:
    values = {key: "unknown" if value is None else f"{value:g}" for key, value in status.values.items()}
    name = f"{robot}: {broadcaster}: {status.name}"
    return Diagnosis(name, robot, Health(status.level), status.message, values)


def _cycle(robot: str, state: StateSample, missed_before: int) -> Diagnosis:
    cycle = state.cycle
    missed = cycle.missed - missed_before
    level = Health.WARN if missed > 0 else Health.OK
    message = f"{missed} cycles missed since the last report" if missed > 0 else f"the robot is {state.state}"
    if state.state in _TROUBLE:
        level, message = _TROUBLE[state.state]
    if state.hint:
        message = f"{message}; {state.hint}"
    values = {
        "period": f"{cycle.period_s * 1e3:g} ms",
        "count": str(cycle.count),
        "missed": str(cycle.missed),
        "latest start": f"{cycle.late_max_s * 1e3:.3f} ms",
        "longest work": f"{cycle.work_max_s * 1e3:.3f} ms",
    }
    return Diagnosis(f"{robot}: cycle", robot, level, message, values)
