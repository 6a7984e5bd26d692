"""arm6 with a joint trajectory controller, and trajectories as planners make them."""

import shutil

from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.data_files import data_path

JOINTS = [f"joint_{index}" for index in range(1, 7)]
ENDS = [0.8, -0.6, 0.9, 1.2, -0.5, 1.5]
CONTROLLER = """
    arm_controller:
      type: joint_trajectory_controller/JointTrajectoryController

arm_controller:
  ros__parameters:
    joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
    command_interfaces: [position]
    state_interfaces: [position, velocity]
    constraints:
      goal_time: 0.5
      decelerate_on_cancel: true
"""


def copy_arm(folder):
    """Copy arm6's files, with a trajectory controller in the place of the one that takes positions."""
    target = folder / "arm6"
    shutil.copytree(data_path("config", "arm6"), target)
    path = target / "ros2_controllers.yaml"
    text = path.read_text()
    begin = text.index("    arm_position_controller:\n")
    joints = "".join(
        f"      {each}: {{trajectory: 0.1, goal: 0.005, max_deceleration_on_cancel: 4.0}}\n" for each in JOINTS
    )
    path.write_text(text[:begin].rstrip() + "\n" + CONTROLLER + joints)
    return target


LOOPS = """
    loops:
      type: pid_controller/PidController

loops:
  ros__parameters:
    dof_names: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
    command_interface: KIND
    reference_and_state_interfaces: [position, velocity]
    enable_feedforward: true
    gains:
"""
CYCLIC = {"velocity": ("0x60FF", 9), "effort": ("0x6071", 10)}
"""Target object and mode of operation of what is commanded."""


def copy_looped_arm(folder, kind, **gains):
    """Copy arm6's files: velocities or efforts are commanded, by PIDs under a trajectory controller."""
    target = copy_arm(folder)
    index, mode = CYCLIC[kind]
    bus, urdf, control = (target / name for name in ("bus.yml", "arm6.urdf", "ros2_controllers.yaml"))
    text = bus.read_text().replace("index: 0x607A", f"index: {index}")
    bus.write_text(text.replace("position_mode: 8", f"{kind}_mode: {mode}"))
    text = urdf.read_text()
    urdf.write_text(text.replace('<command_interface name="position"/>', f'<command_interface name="{kind}"/>'))
    loops = LOOPS.replace("KIND", kind) + "".join(f"      {each}: {gains}\n" for each in JOINTS).replace("'", "")
    text = control.read_text().replace("\narm_controller:\n", loops + "\narm_controller:\n", 1)
    names = ", ".join(f"loops/{each}" for each in JOINTS)
    control.write_text(
        text.replace(
            "command_interfaces: [position]", f"command_joints: [{names}]\n    command_interfaces: [position, velocity]"
        )
    )
    return target


def planned(begin, end, seconds=2.0, count=50):
    """A time-parametrised path with velocities and accelerations, at rest at both ends: a minimum-jerk profile."""
    points = []
    for index in range(count):
        s = index / (count - 1)
        rest = 10 * s**3 - 15 * s**4 + 6 * s**5
        speed = (30 * s**2 - 60 * s**3 + 30 * s**4) / seconds
        gain = (60 * s - 180 * s**2 + 120 * s**3) / seconds**2
        ways = [b - a for a, b in zip(begin, end, strict=True)]
        points.append(
            Point(
                [a + rest * way for a, way in zip(begin, ways, strict=True)],
                [speed * way for way in ways],
                [gain * way for way in ways],
                time=round(s * seconds * 1e9),
            )
        )
    return JointTrajectory(JOINTS, points)
