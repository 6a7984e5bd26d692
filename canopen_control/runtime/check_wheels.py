"""The classic mistakes of robots on wheels: sizes, sides, signs, frames, and limits that freeze.

REP 103: x is forward, y to the left, and a wheel that drives forward turns about +y. Sizes are
compared as they are written, before the multipliers, which are calibration.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.errors import nearest
from canopen_control.master.keys import SCALES
from canopen_control.runtime.check_data import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.controllers.base import WheelBase
    from canopen_control.controllers.controllers_file import ControllerConfig
    from canopen_control.master.config import NodeConfig
    from canopen_control.runtime.check_data import CheckedRobot
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.wheels import WheelGeometry

__all__ = ["WHEEL_RULES"]

_DIFF_DRIVE: Final = frozenset({"wheel_separation", "wheel_radius"})
"""The sizes that a diff drive takes from the description where they are not given; it has switches for its limits."""
SAME: Final = 0.01
"""Lengths that differ by less than one per cent are the same."""


def _bases(robot: CheckedRobot) -> Iterator[tuple[str, WheelBase, ControllerConfig]]:
    for name, controller in robot.configured.items():
        if (base := controller.wheel_base()) is not None:
            yield name, base, robot.config(name)


def _line(config: ControllerConfig, *names: str) -> int:
    return next((line for name in names if (line := config.params.line(name))), config.line)


def _jerk(robot: CheckedRobot) -> Iterator[Finding]:
    for name, base, config in _bases(robot):
        for axis in base.frozen:
            text = f"{name}: {axis}.max_jerk: 0 freezes the robot: it can neither start nor begin to brake"
            fix = f"remove it, or give {axis}.has_jerk_limits: false" if base.radius_key in _DIFF_DRIVE else "remove it"
            yield Finding(config.path, _line(config, f"{axis}.max_jerk"), Severity.ERROR, text, fix)


def _frames(robot: CheckedRobot) -> Iterator[Finding]:
    description = robot.description
    if description is None:
        return
    parents = {joint.child: joint for joint in description.joints.values()}
    for name, base, config in _bases(robot):
        odom, child = base.odom_frame, base.base_frame
        joint = parents.get(child)
        line = _line(config, "odom_frame_id", "base_frame_id")
        if child not in description.links:
            text = f"{name}: base_frame_id {child!r} is no link of {description.path}"
            hint = nearest(child, description.links)
            yield Finding(
                config.path, _line(config, "base_frame_id"), Severity.WARNING, text + hint, "use a link's name"
            )
        elif joint is not None and base.publishes_tf:
            text = (
                f"{name}: {child} gets two parents: {odom} by odometry, and {joint.parent} by the "
                f"{joint.type} joint {joint.name} ({description.path}:{joint.place.line})"
            )
            fix = f"remove that joint and its parent, or set base_frame_id: {_root(parents, child)}"
            yield Finding(config.path, line, Severity.WARNING, text, fix)
        elif odom in description.links:
            text = f"{name}: odom_frame_id {odom!r} is a link of {description.path} already"
            yield Finding(config.path, line, Severity.WARNING, text, "call it odom")


def _root(parents: dict[str, Joint], link: str) -> str:
    """Return the root of the tree a link hangs in."""
    seen: set[str] = set()
    while link in parents and link not in seen:
        seen.add(link)
        link = parents[link].parent
    return link


def _sizes(robot: CheckedRobot) -> Iterator[Finding]:
    geometry = robot.geometry
    if geometry is None:
        return
    for name, base, config in _bases(robot):
        separation, radius = geometry.separation(base.left, base.right), geometry.radius((*base.left, *base.right))
        if base.separation > 0.0:
            yield from _size(name, config, base.separation_key, base.separation, separation)
        yield from _size(name, config, base.radius_key, base.radius, radius)


def _size(name: str, config: ControllerConfig, key: str, used: float, urdf: float | None) -> Iterator[Finding]:
    line = config.params.line(key)
    if not line and not config.ros1 and key in _DIFF_DRIVE:
        text = f"{name}: {key} is missing; ROS 2 refuses that, here the description's {used:g} m is taken"
        yield Finding(config.path, config.line, Severity.WARNING, text, f"write {key}: {used:g}")
    elif line and urdf is not None and abs(used - urdf) > SAME * urdf:
        text = f"{name}: {key} is {used:g} m, the description's wheels have {urdf:g} m"
        yield Finding(config.path, line, Severity.WARNING, text, "measure the robot and correct the one that is wrong")


def _sides(robot: CheckedRobot) -> Iterator[Finding]:
    """Hold where the wheels are and about what they turn against what the controller makes of them."""
    geometry, description = robot.geometry, robot.description
    if geometry is None or description is None:
        return
    for name, base, config in _bases(robot):
        left, right = (_middle(geometry, side) for side in (base.left, base.right))
        if left is not None and right is not None and left < right:
            text = f"{name}: the left wheels are on the right of the robot ({left:g} m and {right:g} m along y)"
            line = _line(config, "left_wheel_names", "left_wheel")
            yield Finding(config.path, line, Severity.WARNING, text, "swap left and right wheel names")
        for wheel in (*base.left, *base.right):
            axis = geometry.axis(wheel)
            if axis is not None and axis[1] < -0.5:
                text = f"joint {wheel}: its axis points to the right, so a positive velocity drives backwards"
                joint = description.joints[wheel]
                yield Finding(description.path, joint.place.line, Severity.WARNING, text, "turn its <axis> round")


def _middle(geometry: WheelGeometry, joints: Sequence[str]) -> float | None:
    places = [geometry.place(name) for name in joints]
    known = [place[1][1] for place in places if place is not None]
    return sum(known) / len(known) if known and len(known) == len(places) else None


def _scales(robot: CheckedRobot) -> Iterator[Finding]:
    bus = robot.bus
    if bus is None:
        return
    for node in bus.nodes.values():
        signs = {key: math.copysign(1.0, getattr(node.units, key)) for key in SCALES}
        if len(set(signs.values())) > 1:
            negative = ", ".join(key for key, sign in signs.items() if sign < 0)
            text = f"node {node.node_id} ({node.name}): only {negative} is negative; position, velocity and both ways"
            fix = "give all four scales the same sign, or the drive runs away from its set-point"
            yield Finding(bus.path, node.line, Severity.ERROR, f"{text} turn the same way", fix)
    for _, base, _ in _bases(robot):
        yield from _mirrored(robot, base)


def _mirrored(robot: CheckedRobot, base: WheelBase) -> Iterator[Finding]:
    """Two drives that face each other turn opposite ways: one of the signs between motor and wheel is negative."""
    assert robot.bus is not None  # asked by `_scales`
    left = [each for name in base.left if (each := _drive(robot, name)) is not None]
    right = [each for name in base.right if (each := _drive(robot, name)) is not None]
    for (one, sign), (other, other_sign) in zip(left, right, strict=False):
        if sign == other_sign:
            text = (
                f"nodes {one.node_id} ({one.name}) and {other.node_id} ({other.name}) drive wheels of both sides with "
                "scales of the same sign; motors that face each other then turn the robot on the spot"
            )
            fix = f"if they do, make the scales of {one.name} negative"
            yield Finding(robot.bus.path, one.line, Severity.WARNING, text, fix)


def _drive(robot: CheckedRobot, joint: str) -> tuple[NodeConfig, bool] | None:
    """Return the node behind a joint, and whether it turns against the joint."""
    if robot.bus is None or robot.description is None:
        return None
    for tag in robot.description.hardware:
        ratios = {each.joint: each.reduction for each in tag.transmissions}
        for part in tag.joints:
            node = robot.bus.nodes.get(part.parameters.get("device_name", ""))
            if part.name == joint and node is not None:
                axis = part.parameters.get("axis", "0").strip()
                scale = node.units.of_axis(int(axis) if axis.isdigit() else 0)["vel_to_dev"]
                return node, scale * ratios.get(joint, 1.0) < 0.0
    return None


WHEEL_RULES: Final[tuple[Callable[[CheckedRobot], Iterator[Finding]], ...]] = (_jerk, _frames, _sizes, _sides, _scales)
