"""The robots that are measured: any number of robby's drives, at any cycle, with a base or a forward controller.

Every RPDO is cyclic (transmission type 1), so that each cycle has the same frames as the peers': SYNC, two RPDOs and
two TPDOs for every drive.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from canopen_control.data_files import data_path

if TYPE_CHECKING:
    from pathlib import Path


SCALE = 254.64790894703253  # microsteps per rad: 1600 per revolution
RADIUS_M, SEPARATION_M = 0.035, 0.24
FIRST_NODE = 2
CONTROLLER = "commands"
EVERY_CYCLE = 10_000  # Hz: faster than any cycle
_STALE_US = 500_000  # feedback is stale after this time; the drives share a busy machine with the benchmark

_SCALES = f"""
    scale_pos_from_dev: {1 / SCALE}
    scale_pos_to_dev: {SCALE}
    scale_vel_from_dev: {1 / SCALE}
    scale_vel_to_dev: {SCALE}
"""
_MANAGER = """
controller_manager:
  ros__parameters:
    update_rate: {rate}
    joint_state_broadcaster: {{type: joint_state_broadcaster/JointStateBroadcaster}}
    {name}: {{type: {kind}}}
"""
_BASE = """
{name}:
  ros__parameters:
    left_wheel_names: [{left}]
    right_wheel_names: [{right}]
    wheel_separation: {separation}
    wheel_radius: {radius}
    base_frame_id: base
    cmd_vel_timeout: 5.0
    publish_rate: 50.0
    linear.x.max_velocity: 1.0
    linear.x.max_acceleration: 1.0
    linear.x.max_deceleration: -1.0
"""
_FORWARD = """
{name}:
  ros__parameters:
    joints: [{joints}]
    interface_name: velocity
    command_timeout: 60.0  # the wheels turn on while something is measured
"""


def write_fleet(
    folder: Path, count: int, period_us: int, *, base: bool = False, rate: int | None = None, buses: int = 1
) -> Path:
    """Write a robot with `count` drives, with node-IDs from 2 on each bus, and return its folder.

    `base` has a diff drive controller on all of them, the first half left, the others a forward controller; `rate` is
    the controllers' (default: they run in every cycle, however fast it is); the drives are shared out among `buses`.
    """
    robot = folder / f"fleet{count}_{buses}_{period_us}"
    robot.mkdir(parents=True, exist_ok=True)
    names = [f"drive_{number}" for number in range(1, count + 1)]
    for bus in range(buses):
        name = "bus.yml" if bus == 0 else f"bus_b{bus}.yml"
        (robot / name).write_text(_bus(names[bus::buses], period_us))
    joints = [f"joint_{name}" for name in names]
    (robot / "ros2_controllers.yaml").write_text(_controllers(joints, rate or EVERY_CYCLE, base=base))
    (robot / "fleet.urdf").write_text(_description(robot.name, names, joints))
    return robot


def _bus(names: list[str], period_us: int) -> str:
    text = data_path("config", "robby").joinpath("bus.yml").read_text().partition("nodes:")[0]
    for pattern, value in (
        (r"sync_period: \d+", f"sync_period: {period_us}"),
        (r"missed_syncs: \d+", f"missed_syncs: {max(10, _STALE_US // period_us)}"),
        (r" *- \{index: 0x60C2, .*\n", ""),  # nothing is interpolated here
    ):
        text, changed = re.subn(pattern, value, text)
        assert changed, pattern
    head, rpdo, tail = text.partition("  rpdo:")
    tail = tail.replace("enabled: true", "enabled: true\n      transmission: 0x01")
    nodes = "".join(f"  {name}:\n    node_id: {number}{_SCALES}" for number, name in enumerate(names, FIRST_NODE))
    return f"{head}{rpdo}{tail}nodes:\n{nodes}"


def _controllers(joints: list[str], rate: int, *, base: bool) -> str:
    kind = (
        "diff_drive_controller/DiffDriveController" if base else "forward_command_controller/ForwardCommandController"
    )
    half = len(joints) // 2
    return (_MANAGER + (_BASE if base else _FORWARD)).format(
        rate=rate,
        name=CONTROLLER,
        kind=kind,
        joints=", ".join(joints),
        left=", ".join(joints[:half]),
        right=", ".join(joints[half:]),
        separation=SEPARATION_M,
        radius=RADIUS_M,
    )


def _description(name: str, drives: list[str], joints: list[str]) -> str:
    links = "<link name='base'/>" + "".join(f"<link name='link_{joint}'/>" for joint in joints)
    moving = "".join(
        f"<joint name='{joint}' type='continuous'><parent link='base'/><child link='link_{joint}'/>"
        f"<origin xyz='0 {0.12 if number < len(joints) // 2 else -0.12} 0'/><axis xyz='0 1 0'/></joint>"
        for number, joint in enumerate(joints)
    )
    control = "".join(
        f"<joint name='{joint}'><param name='device_name'>{drive}</param><command_interface name='velocity'/>"
        "<state_interface name='position'/><state_interface name='velocity'/></joint>"
        for drive, joint in zip(drives, joints, strict=True)
    )
    plugin = "<hardware><plugin>canopen_control/CanopenSystem</plugin></hardware>"
    system = f"<ros2_control name='fleet' type='system'>{plugin}{control}</ros2_control>"
    return f"<robot name='{name}'>{links}{moving}{system}</robot>"
