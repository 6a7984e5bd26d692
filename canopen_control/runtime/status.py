"""Messages to clients about a robot: status, state samples, nodes and PDO mappings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.controllers.base import finite
from canopen_control.master.pdo_layout import layout_of
from canopen_control.rpc.messages.layout import Layout
from canopen_control.rpc.messages.robot import BusPlace, NodeListing, NodePlace
from canopen_control.rpc.messages.state import (
    BootStep,
    BusTraffic,
    CycleTimes,
    JointReading,
    Snapshot,
    StateSample,
    Status,
    TrackingReading,
)
from canopen_control.runtime.pacer import LATE_EDGES_NS
from canopen_control.runtime.sync_choice import linear_axes
from canopen_control.urdf.joint_element import POSITION
from canopen_control.version import __version__, build

if TYPE_CHECKING:
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.runtime.core import RobotCore


def snapshot_of(robot: RobotCore) -> Snapshot:
    """Return the robot's current state, which the status and the state samples contain."""
    state, hint = robot.state_and_hint
    return Snapshot(
        state=state.value,
        hint=robot.cycle.clock.hint or hint,
        latched=robot.latch.held,
        latched_by=robot.latch.by,
        cycle=_cycle(robot),
        nodes=robot.node_readings.at(robot.reactor.now()),
        joints=_joints(robot),
        controllers=robot.manager.states,
        true_pose=robot.truth.reading,
    )


def status_message(robot: RobotCore, snapshot: Snapshot | None = None) -> Status:
    """Return the status of a robot, as in `status --json`; `snapshot` is an existing one, if any."""
    return (snapshot or snapshot_of(robot)).grown(
        Status,
        robot=robot.setup.name,
        version=__version__,
        build=build(),
        late_edges_s=[edge / 1e9 for edge in LATE_EDGES_NS],
        buses=_buses(robot),
        boot=[
            BootStep(node.name, step.name, step.seconds, step.error or None)
            for node in robot.nodes.values()
            for step in node.boot_steps
        ],
        failure=robot.failure,
        missing_programs=dict(robot.missing_programs),
        commander=robot.commander,
        events=robot.recent_events.at(robot.wall_offset_ns),
    )


def state_sample(robot: RobotCore, snapshot: Snapshot | None = None) -> StateSample:
    """Return a sample of the state stream; `snapshot` is an existing one, if any."""
    return (snapshot or snapshot_of(robot)).grown(
        StateSample,
        time=(robot.reactor.now() + robot.wall_offset_ns) / 1e9,
        load={name: bus.load for name, bus in robot.buses.items()},
        sim_time=simulated_seconds(robot),
        sim_epoch=simulated_epoch(robot),
        samples=robot.manager.running.samples(robot.wall_offset_ns + robot.cycle.clock.stood_ns),
    )


def simulated_seconds(robot: RobotCore) -> float | None:
    """Return the simulated time in s for `/clock`, or None if nothing is simulated."""
    if robot.in_virtual_time:
        return robot.reactor.now() / 1e9
    times = (component.simulated_ns for component in robot.registry.components)
    return next((time_ns / 1e9 for time_ns in times if time_ns is not None), None)


def simulated_epoch(robot: RobotCore) -> float | None:
    """Return the Unix time in s at which the simulated time was 0, or None if nothing is simulated."""
    if robot.in_virtual_time:
        return robot.wall_offset_ns / 1e9
    clock = robot.cycle.clock
    seconds = simulated_seconds(robot) if clock.simulated else None
    if seconds is None:
        return None
    return (clock.edge + clock.stood_ns + robot.wall_offset_ns) / 1e9 - seconds


def nodes_message(robot: RobotCore) -> NodeListing:
    """Return the bus, node-ID, EDS and ROS settings of each node, for clients that access the bus directly."""
    return NodeListing(
        {name: BusPlace(bus.channel, bus.config.master.node_id) for name, bus in robot.buses.items()},
        [
            NodePlace(
                name=name,
                node_id=node.node_id,
                bus=robot.bus_of(node).name,
                eds=str(robot.bus_of(node).config.eds_paths[name].resolve()),
                identity=node.plan.identity,
                driver=node.config.ros.driver,
                namespace=node.config.ros.namespace,
                remappings=_texts(node.config.ros.remappings),
                channel_names=node.config.ros.channel_names,
                joints=[joint.joint for joint in robot.joints.values() if joint.node is node],
                axes=len(node.plan.axes),
            )
            for name, node in robot.nodes.items()
        ],
    )


def _texts(content: Any) -> dict[str, str]:  # noqa: ANN401 - any value of bus.yml
    return {str(key): str(value) for key, value in content.items()} if isinstance(content, dict) else {}


def layout_message(robot: RobotCore) -> Layout:
    """Return the PDO mappings of all nodes, by bus."""
    description = robot.setup.description
    return Layout(
        {
            name: layout_of(bus.config, bus.channel, linear_axes(bus.config, description))
            for name, bus in robot.buses.items()
        }
    )


def _cycle(robot: RobotCore) -> CycleTimes:
    pacer = robot.pacer
    return CycleTimes(
        pacer.period_ns / 1e9,
        pacer.count,
        pacer.missed,
        pacer.late_max / 1e9,
        pacer.work / 1e9,
        pacer.work_max / 1e9,
        pacer.late_counts,
    )


def _buses(robot: RobotCore) -> dict[str, BusTraffic]:
    buses = {}
    for name, bus in robot.buses.items():
        stats = bus.port.stats if bus.port else None
        counts = (0, 0, 0) if stats is None else (stats.rx, stats.tx, stats.lost)
        buses[name] = BusTraffic(bus.channel, *counts, bus.network.unknown, bus.load, bus.sync_words)
    return buses


def _joints(robot: RobotCore) -> dict[str, JointReading]:
    """Return the states, commands and tracking errors of all joints; None replaces values that are not finite."""
    joints: dict[str, dict[str, float | None]] = {}
    for state in robot.registry.state_interfaces:
        joints.setdefault(state.joint, {})[state.interface] = finite(state.value)
    commands: dict[str, float | None] = {}
    for command in robot.registry.command_interfaces:
        if command.owner is not None and (command.interface == POSITION or command.joint not in commands):
            commands[command.joint] = finite(command.value)  # the position if velocity feed-forward is also commanded
    return {
        name: JointReading(
            name,
            values.pop("position", None),
            values.pop("velocity", None),
            values.pop("effort", None),
            commands.get(name),
            values,
            _tracking(robot.joints.get(name)),
        )
        for name, values in joints.items()
    }


def _tracking(joint: JointDrive | None) -> TrackingReading | None:
    figures = None if joint is None else joint.tracking.figures()
    return None if joint is None or figures is None else TrackingReading(joint.tracking.interface, *figures)
