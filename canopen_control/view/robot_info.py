"""What a page begins with: what stays as it is while a robot runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.rpc.messages.state import StateSample

if TYPE_CHECKING:
    from canopen_control.rpc.messages.robot import Description, NodeListing, NodePlace
    from canopen_control.rpc.messages.state import RobotEvent, Status
    from canopen_control.rpc.messages.world_shape import WorldShape

__all__ = ["Pose", "RobotInfo", "VirtualNode", "pose_of", "read_robot_info", "true_pose_of"]

Pose = tuple[float, float, float]
"""x and y in m, heading in rad."""


@dataclass(frozen=True, slots=True)
class VirtualNode:
    """Where a node would be if it were virtual: a bus's channel and a node id."""

    name: str
    channel: str
    node_id: int


@dataclass(frozen=True, slots=True)
class RobotInfo:
    """What stays as it is while a robot runs, and its state when one came."""

    robot: str
    urdf: str
    path: str
    nodes: tuple[VirtualNode, ...]
    buses: tuple[str, ...]
    joints: tuple[str, ...]
    state: StateSample
    events: tuple[RobotEvent, ...] = field(default=(), compare=False)
    places: tuple[NodePlace, ...] = ()
    world: tuple[WorldShape, ...] = field(default=(), compare=False)

    @property
    def shape(self) -> object:
        """What a page was built for; a robot with another one needs another page."""
        return self.urdf, self.nodes, self.buses, self.joints


def read_robot_info(robot: str, description: Description, listing: NodeListing, status: Status) -> RobotInfo:
    """Gather the answers to `description`, `nodes` and `status`."""
    state = StateSample(
        state=status.state,
        hint=status.hint,
        latched=status.latched,
        latched_by=status.latched_by,
        cycle=status.cycle,
        nodes=status.nodes,
        joints=status.joints,
        controllers=status.controllers,
        load={name: bus.load for name, bus in status.buses.items()},
    )
    return RobotInfo(
        robot,
        description.urdf,
        description.path,
        tuple(VirtualNode(each.name, listing.buses[each.bus].channel, each.node_id) for each in listing.nodes),
        tuple(status.buses),
        tuple(sorted(status.joints)),
        state,
        tuple(status.events),
        tuple(sorted(listing.nodes, key=lambda each: each.node_id)),
        description.world,
    )


def true_pose_of(state: StateSample) -> Pose | None:
    """Return where a simulated base truly is, in the frame of its odometry; None where that is not known."""
    return None if state.true_pose is None else state.true_pose.in_odometry


def pose_of(state: StateSample) -> Pose | None:
    """Return where the first base controller believes to be."""
    for each in state.told(OdometrySample).values():
        return each.x, each.y, each.heading
    return None
