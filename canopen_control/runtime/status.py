"""What a robot says of itself, as plain data: `status --json`, and the stream its clients watch.

The law of this file: SI units, None where nothing is known (JSON has no nan), times in Unix seconds, and the same names
as in bus.yml and the description. Keys may be added, never renamed.
"""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from canopen_control.cia402.modes import mode_name
from canopen_control.controllers.broadcasters import DiagnosticsBroadcaster, GpioBroadcaster
from canopen_control.controllers.diff_drive import DiffDriveController
from canopen_control.hardware.simulation import SimulatedSystem
from canopen_control.master.layout import layout_of
from canopen_control.runtime.pacer import LATE_EDGES_NS

if TYPE_CHECKING:
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.master.events import Event
    from canopen_control.master.node import RemoteNode
    from canopen_control.runtime.core import RobotCore

__all__ = ["event_dict", "layout_dict", "nodes_dict", "odometry_dict", "state_dict", "status_dict"]

_MAX_EVENTS = 50


def status_dict(robot: RobotCore) -> dict[str, Any]:
    """Return everything that `status --json` prints."""
    return {
        "robot": robot.setup.name,
        **_common(robot),
        "late_edges_s": [edge / 1e9 for edge in LATE_EDGES_NS],
        "buses": {
            name: {
                "channel": bus.channel,
                "rx": bus.port.stats.rx if bus.port else 0,
                "tx": bus.port.stats.tx if bus.port else 0,
                "lost": bus.port.stats.lost if bus.port else 0,
                "unknown": bus.network.unknown,
                "load": bus.load,
            }
            for name, bus in robot.buses.items()
        },
        "boot": [step for node in robot.nodes.values() for step in _boot_steps(node)],
        "failure": robot.failure,
        "commander": robot.commander,
        "events": [event_dict(robot, event) for event in list(robot.events.recent)[-_MAX_EVENTS:]],
    }


def state_dict(robot: RobotCore) -> dict[str, Any]:
    """Return one sample of the state stream."""
    return {
        "time": (robot.reactor.now() + robot.wall_offset_ns) / 1e9,
        **_common(robot),
        "load": {name: bus.load for name, bus in robot.buses.items()},
        "sim_time": simulated_seconds(robot),
        "odometry": odometry_dict(robot),
        "gpio": {each.name: finite_values(each) for each in robot.manager.running if isinstance(each, GpioBroadcaster)},
        "diagnostics": {
            each.name: [status.as_dict() for status in each.statuses()]
            for each in robot.manager.running
            if isinstance(each, DiagnosticsBroadcaster)
        },
    }


def simulated_seconds(robot: RobotCore) -> float | None:
    """Return how long the simulation has run, for `/clock`; None if nothing is simulated."""
    return next(
        (each.elapsed_ns / 1e9 for each in robot.registry.components if isinstance(each, SimulatedSystem)), None
    )


def finite_values(broadcaster: GpioBroadcaster) -> dict[str, dict[str, float | None]]:
    """Return what a broadcaster of inputs and outputs tells, by joint and interface."""
    return {
        joint: {interface: _finite(value) for interface, value in values.items()}
        for joint, values in broadcaster.by_joint().items()
    }


def odometry_dict(robot: RobotCore) -> dict[str, Any]:
    """Return where each active diff drive controller believes to be; `time` is that of its last publication."""
    return {
        controller.name: {"time": (controller.stamp + robot.wall_offset_ns) / 1e9, **controller.sample()}
        for controller in robot.manager.running
        if isinstance(controller, DiffDriveController) and controller.publications
    }


def nodes_dict(robot: RobotCore) -> dict[str, Any]:
    """Return where each node is and which EDS describes it, for clients that talk to it in its own words."""
    return {
        "buses": {
            name: {"channel": bus.channel, "node_id": bus.config.master.node_id} for name, bus in robot.buses.items()
        },
        "nodes": [
            {
                "name": name,
                "node_id": node.node_id,
                "bus": robot.bus_of(node).name,
                "eds": str(robot.bus_of(node).config.eds_paths[name].resolve()),
                "identity": asdict(node.plan.identity),
                "driver": node.config.driver,
                "namespace": node.config.namespace,
                "remappings": node.config.remappings,
                "channel_names": node.config.channel_names,
            }
            for name, node in robot.nodes.items()
        ],
    }


def layout_dict(robot: RobotCore) -> dict[str, Any]:
    """Return what the PDOs of each bus carry, for those who listen to it."""
    return {"buses": {name: layout_of(bus.config, bus.channel) for name, bus in robot.buses.items()}}


def event_dict(robot: RobotCore, event: Event) -> dict[str, Any]:
    """Return an event as clients see it."""
    return {
        "time": (event.time + robot.wall_offset_ns) / 1e9,
        "kind": event.kind,
        "node": event.node or None,
        "level": event.level.name.lower(),
        "text": event.text,
        **({} if event.details is None else {"details": dict(event.details)}),
    }


def _common(robot: RobotCore) -> dict[str, Any]:
    now, pacer = robot.reactor.now(), robot.pacer
    axes: dict[RemoteNode, list[dict[str, Any]]] = {}
    for joint in robot.joints.values():
        axes.setdefault(joint.node, []).append(_axis(joint))
    return {
        "state": robot.state.value,
        "latched": robot.latch.held,
        "latched_by": robot.latch.by,
        "cycle": {
            "period_s": pacer.period_ns / 1e9,
            "count": pacer.count,
            "missed": pacer.missed,
            "late_max_s": pacer.late_max / 1e9,
            "work_s": pacer.work / 1e9,
            "work_max_s": pacer.work_max / 1e9,
            "late_counts": pacer.late_counts,
        },
        "nodes": {name: _node(robot, node, now, axes.get(node, [])) for name, node in robot.nodes.items()},
        "joints": _joints(robot),
        "controllers": robot.manager.states,
    }


def _node(robot: RobotCore, node: RemoteNode, now: int, axes: list[dict[str, Any]]) -> dict[str, Any]:
    age = node.age_ns(now)
    return {
        "bus": robot.bus_of(node).name,
        "node_id": node.node_id,
        "nmt_state": node.nmt_state.name if node.nmt_state is not None else None,
        "ready": node.ready,
        "age_s": age / 1e9 if age is not None else None,
        "error": node.error,
        "sdo": {"reads": node.sdo_reads, "writes": node.sdo_writes, "failed": node.sdo_failed},
        "axes": axes,
    }


def _axis(joint: JointDrive) -> dict[str, Any]:
    state, machine = joint.state, joint.machine
    return {
        "joint": joint.joint,
        "axis": joint.axis.number,
        "cia402_state": state.name if state is not None else None,
        "statusword": joint.statusword if state is not None else None,
        "mode": mode_name(machine.mode) if machine.mode is not None else None,
        "error": joint.node.error if machine.fault else None,
    }


def _joints(robot: RobotCore) -> dict[str, dict[str, float | None]]:
    joints: dict[str, dict[str, float | None]] = {}
    for state in robot.registry.state_interfaces:
        values = joints.setdefault(state.joint, dict.fromkeys(("position", "velocity", "effort", "command")))
        values[state.interface] = _finite(state.value)
    for command in robot.registry.command_interfaces:
        if command.owner is not None and command.joint in joints:
            joints[command.joint]["command"] = _finite(command.value)
    return joints


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _boot_steps(node: RemoteNode) -> list[dict[str, Any]]:
    return [
        {"node": node.name, "step": step.name, "seconds": step.seconds, "error": step.error or None}
        for step in node.boot_steps
    ]
