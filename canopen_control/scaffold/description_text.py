"""Writes the URDF of a new robot: links and joints to look at, and the <ros2_control> tag that ties joints to drives.

A base has wheels on the ground; joints without a base are discs in a row, each turning about y. All turn without end:
a joint with an end is `revolute`, with its limits, once they are known.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import quoteattr

from canopen_control.profiles.device_type import Profile
from canopen_control.scaffold.drive_choice import POSITION, VELOCITY
from canopen_control.scaffold.new_robot import FASTEST_MEASURED

if TYPE_CHECKING:
    from canopen_control.scaffold.new_robot import NewJoint, NewNode, NewRobot


RADIUS: Final = 0.05  # m, of a wheel
SEPARATION: Final = 0.3  # m, between left and right
WHEELBASE: Final = 0.3  # m, between front and rear
_WIDTH: Final = 0.02
_FASTEST: Final = {VELOCITY: 30.0, POSITION: 1.0}  # rad/s


def description_text(robot: NewRobot) -> str:
    """Return the whole file."""
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {robot.name}: what the robot looks like, in m and rad; at the end which drive of bus.yml moves which",
        "     joint. All measures are examples; put in those of your robot. -->",
        f"<robot name={quoteattr(robot.name)}>",
        *(_chassis() if robot.base.type_name else ['  <link name="base_link"/>', ""]),
    ]
    for number, joint in enumerate(robot.joints):
        axis = "0 0 1" if robot.base.steers(len(robot.joints), number) else "0 1 0"
        lines += _joint(joint.name, _place(robot, number), axis, _FASTEST[joint.axis.interface])
    for number, node in enumerate(node for node in robot.nodes if node.measured):
        lines += _joint(node.measured, (0.0, -0.1 * (number + 1), RADIUS), "0 1 0", FASTEST_MEASURED)
    lines += [
        f'  <ros2_control name={quoteattr(robot.name)} type="system">',
        "    <hardware>",
        "      <!-- the nodes of bus.yml, virtual or real -->",
        "      <plugin>canopen_ros2_control/RobotSystem</plugin>",
        "    </hardware>",
    ]
    for node in robot.nodes:
        for joint in node.joints:
            lines += _control(joint)
        lines += _measured(node) if node.measured else _signals(node)
    return "\n".join([*lines, "  </ros2_control>", "</robot>"]) + "\n"


def _chassis() -> list[str]:
    return [
        "  <!-- on the ground; odometry moves it -->",
        '  <link name="base_footprint"/>',
        '  <joint name="base_joint" type="fixed">',
        '    <parent link="base_footprint"/>',
        '    <child link="base_link"/>',
        f'    <origin xyz="0 0 {RADIUS}"/>',
        "  </joint>",
        '  <link name="base_link">',
        "    <visual>",
        '      <origin xyz="0 0 0.03"/>',
        f'      <geometry><box size="{WHEELBASE + 0.1:g} {SEPARATION - 0.04:g} 0.05"/></geometry>',
        "    </visual>",
        "  </link>",
        "",
    ]


def _joint(joint: str, place: tuple[float, float, float], axis: str, fastest: float) -> list[str]:
    link, size = f"{joint.removesuffix('_joint')}_link", f'radius="{RADIUS}" length="{_WIDTH}"'
    x, y, z = place
    return [
        f'  <joint name="{joint}" type="continuous">',
        '    <parent link="base_link"/>',
        f'    <child link="{link}"/>',
        f'    <origin xyz="{x:g} {y:g} {z:g}"/>',
        f'    <axis xyz="{axis}"/>',
        f'    <limit effort="10" velocity="{fastest:g}"/>  <!-- N m, rad/s -->',
        "  </joint>",
        f'  <link name="{link}">',
        "    <visual>",
        '      <origin rpy="1.5707963 0 0"/>',
        f"      <geometry><cylinder {size}/></geometry>",
        "    </visual>",
        "    <visual>  <!-- a mark, to see it turn -->",
        f'      <origin xyz="{RADIUS / 2:g} {_WIDTH / 2:g} 0"/>',
        f'      <geometry><box size="{RADIUS * 0.8:g} 0.004 0.008"/></geometry>',
        "    </visual>",
        "  </link>",
        "",
    ]


def _place(robot: NewRobot, number: int) -> tuple[float, float, float]:
    """Return where on base_link a joint is: left and right in turn, the front pair first; or in a row.

    A steered wheel is in front of the one pair.
    """
    if not robot.base.type_name:
        return 0.0, 0.1 * number, RADIUS
    if robot.base.steers(len(robot.joints), number):
        return WHEELBASE, 0.0, 0.0
    pairs = len(robot.joints) // 2
    side = SEPARATION / 2 if number % 2 == 0 else -SEPARATION / 2
    return (0.0 if pairs == 1 else WHEELBASE / 2 if number < 2 else -WHEELBASE / 2), side, 0.0


def _measured(node: NewNode) -> list[str]:
    """Return the joint that an encoder measures; nothing commands it."""
    return [
        f'    <joint name="{node.measured}">',
        f'      <param name="device_name">{node.name}</param>  <!-- an encoder of bus.yml -->',
        '      <state_interface name="position"/>',
        '      <state_interface name="velocity"/>',
        "    </joint>",
    ]


def _signals(node: NewNode) -> list[str]:
    """Return the inputs and outputs of a device that is no drive, none of a device whose profile is not known."""
    if not node.signals:
        return []
    tag = "gpio" if node.profile is Profile.IO or node.outputs else "sensor"
    return [
        f'    <{tag} name="{node.name}">  <!-- the node of bus.yml of this name -->',
        *(f'      <command_interface name="{each.name}"/>' for each in node.outputs),
        *(f'      <state_interface name="{each.name}"/>{_unit(each.unit)}' for each in node.signals),
        f"    </{tag}>",
    ]


def _unit(unit: str) -> str:
    return f"  <!-- {unit} -->" if unit else ""


def _control(joint: NewJoint) -> list[str]:
    axis = joint.axis
    more = [f'      <param name="axis">{axis.number}</param>  <!-- of that device -->'] if axis.number else []
    return [
        f'    <joint name="{joint.name}">',
        f'      <param name="device_name">{joint.node}</param>  <!-- a node of bus.yml -->',
        *more,
        f'      <command_interface name="{axis.interface}"/>',
        *(f'      <state_interface name="{name}"/>' for name in axis.feedback),
        "    </joint>",
    ]
