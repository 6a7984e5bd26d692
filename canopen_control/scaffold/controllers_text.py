"""Writes the ros2_controllers.yaml of a new robot: what commands the joints, commented.

The first controller that is no broadcaster is the one that `run` and `demo` activate: that of the base, else the one
for the joints of the better interface.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.scaffold.bus_text import remark
from canopen_control.scaffold.description_text import RADIUS, SEPARATION, WHEELBASE
from canopen_control.scaffold.device_controllers import device_controller
from canopen_control.scaffold.drive_choice import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.scaffold.new_robot import NewJoint, NewRobot

__all__ = ["controllers_text"]

BASE_CONTROLLER: Final = "base_controller"
_TYPES: Final = {
    VELOCITY: "velocity_controllers/JointGroupVelocityController",
    POSITION: "position_controllers/JointGroupPositionController",
}
_UNITS: Final = {VELOCITY: "rad/s", POSITION: "rad"}


def controllers_text(robot: NewRobot) -> str:
    """Return the whole file."""
    joints = {
        interface: [joint.name for joint in robot.joints if joint.axis.interface == interface] for interface in _TYPES
    }
    groups = {interface: names for interface, names in joints.items() if names}
    rate = round(1_000_000 / robot.sync_us)
    lines = [
        f"# The controllers of {robot.name}: those that move no joint and the first that does are activated;",
        f"# another one by canopen-control run {robot.name} --controller NAME.",
        "",
        "controller_manager:",
        "  ros__parameters:",
        remark(f"    update_rate: {rate}", "Hz: the SYNC period of bus.yml"),
    ]
    if POSITION in groups:
        lines.append(remark("    enforce_command_limits: true", "positions change as fast as the URDF allows, at most"))
    if _feedback(robot.joints) or any(node.measured for node in robot.nodes):
        lines += ["", "    joint_state_broadcaster:", "      type: joint_state_broadcaster/JointStateBroadcaster"]
    if robot.base.type_name:
        lines += ["", f"    {BASE_CONTROLLER}:", f"      type: {robot.base.type_name}"]
    for interface in groups:
        lines += ["", f"    {interface}_controller:", f"      type: {_TYPES[interface]}"]
    told = [(node, *device_controller(node)) for node in robot.nodes if node.signals and not node.measured]
    for node, each, _ in told:
        lines += ["", f"    {node.name}_{each.suffix}:", f"      type: {each.type_name}"]
    if robot.base.type_name:
        lines += ["", f"{BASE_CONTROLLER}:", "  ros__parameters:"]
        lines += [f"    {line}" if line else "" for line in _PARAMETERS[robot.base.name](robot)]
    for interface, names in groups.items():
        lines += ["", f"{interface}_controller:", "  ros__parameters:"]
        lines.append(
            remark(f"    joints: [{', '.join(names)}]", f"a command has a value for each, in {_UNITS[interface]}")
        )
        if interface == VELOCITY:
            lines.append(remark("    command_timeout: 1.0", "s without a command, then the motors stop"))
    for node, each, parameters in told:
        lines += ["", f"{node.name}_{each.suffix}:", "  ros__parameters:", *(f"    {line}" for line in parameters)]
    return "\n".join(lines) + "\n"


def _feedback(joints: Sequence[NewJoint]) -> set[str]:
    """Return what is measured of some joints."""
    return {name for joint in joints for name in joint.axis.feedback}


def _diff(robot: NewRobot) -> list[str]:
    joints = [joint.name for joint in robot.joints]
    feedback = _feedback(robot.joints)
    return [
        f"left_wheel_names: [{', '.join(joints[0::2])}]",
        f"right_wheel_names: [{', '.join(joints[1::2])}]",
        "",
        remark(f"wheel_separation: {SEPARATION}", "m, between the middles of the wheels; measure it"),
        remark(f"wheel_radius: {RADIUS}", "m; measure it"),
        "",
        *_odometry(feedback, "cmd_vel_timeout"),
        "",
        remark("linear.x.max_velocity: 0.5", "m/s"),
        "linear.x.min_velocity: -0.5",
        remark("linear.x.max_acceleration: 0.5", "m/s^2"),
        "linear.x.max_deceleration: -0.5",
        remark("angular.z.max_velocity: 1.0", "rad/s"),
        "angular.z.min_velocity: -1.0",
        remark("angular.z.max_acceleration: 1.0", "rad/s^2"),
        "angular.z.max_deceleration: -1.0",
    ]


def _odometry(feedback: set[str], timeout: str) -> list[str]:
    """Return what says where odometry comes from: positions, else velocities, else commands; and when a base stops."""
    source = POSITION if POSITION in feedback else VELOCITY if VELOCITY in feedback else "the commands"
    return [
        "odom_frame_id: odom",
        remark("base_frame_id: base_footprint", "the root of the URDF"),
        "enable_odom_tf: true",
        remark(f"open_loop: {'false' if feedback else 'true'}", f"odometry of {source}"),
        f"position_feedback: {'true' if POSITION in feedback else 'false'}",
        remark(f"{timeout}: 0.5", "s without a command, then the base stops"),
    ]


def _tricycle(robot: NewRobot) -> list[str]:
    left, right, steering = (joint.name for joint in robot.joints)
    traction = _feedback(robot.joints[:2])
    return [
        remark(f"traction_joints_names: [{right}, {left}]", "right, then left"),
        f"steering_joints_names: [{steering}]",
        "",
        remark(f"wheelbase: {WHEELBASE}", "m, from the driven axle to the steered wheel; measure it"),
        remark(f"traction_track_width: {SEPARATION}", "m, between the driven wheels; measure it"),
        remark(f"traction_wheels_radius: {RADIUS}", "m; measure it"),
        "",
        *_odometry(traction, "reference_timeout"),
        remark("reduce_wheel_speed_until_steering_reached: true", "slow while the steering is on its way"),
    ]


def _mecanum(robot: NewRobot) -> list[str]:
    places = ("front_left", "front_right", "rear_left", "rear_right")
    feedback = _feedback(robot.joints)
    return [
        *(f"{place}_wheel_command_joint_name: {joint.name}" for place, joint in zip(places, robot.joints, strict=True)),
        "",
        remark(f"kinematics.wheels_radius: {RADIUS}", "m; measure it"),
        remark(
            f"kinematics.sum_of_robot_center_projection_on_X_Y_axis: {(WHEELBASE + SEPARATION) / 2:g}",
            "m, how far ahead and how far aside of the middle a wheel is, summed; measure it",
        ),
        "",
        *(line for line in _odometry(feedback, "reference_timeout") if not line.startswith(_NOT_MECANUM)),
        "",
        remark("linear.x.max_velocity: 0.5", "m/s"),
        remark("linear.x.max_acceleration: 0.5", "m/s^2"),
        "linear.y.max_velocity: 0.5",
        "linear.y.max_acceleration: 0.5",
        remark("angular.z.max_velocity: 1.0", "rad/s"),
        remark("angular.z.max_acceleration: 1.0", "rad/s^2"),
    ]


_NOT_MECANUM: Final = ("open_loop", "position_feedback")
_PARAMETERS: Final[dict[str, Callable[[NewRobot], list[str]]]] = {
    "diff": _diff,
    "tricycle": _tricycle,
    "mecanum": _mecanum,
}
"""What makes the parameters of a base's controller, by the base's name."""
