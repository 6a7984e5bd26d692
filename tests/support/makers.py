"""A robot of two generic CiA 402 axes in virtual time, whose drives a test makes deviate as real makers' drives do."""

import re
from pathlib import Path
from types import MappingProxyType

from canopen_control.data_files import data_path
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot

COUNTS = 65536 * 50 / 6.283185307179586  # per radian

_URDF = """<robot name="two_axes">
  <link name="base"/><link name="yoke"/><link name="head"/>
  <joint name="pan" type="revolute"><parent link="base"/><child link="yoke"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="10"/></joint>
  <joint name="tilt" type="revolute"><parent link="yoke"/><child link="head"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" velocity="2" effort="10"/></joint>
  <ros2_control name="two_axes" type="system">
    <hardware><plugin>canopen_ros2_control/RobotSystem</plugin></hardware>{joints}
  </ros2_control>
</robot>
"""
_JOINT = """
    <joint name="{joint}"><param name="device_name">{joint}_drive</param>{commands}
      <state_interface name="position"/><state_interface name="velocity"/></joint>"""
_BUS = """master:
  node_id: 1
  channel: local:makers
  baudrate: 1000
  sync_period: 10000
  heartbeat_producer: 100
defaults:
  dcf: {eds}
  heartbeat_producer: 100
  heartbeat_consumer: true
  counts_per_revolution: 65536
  gear_ratio: 50
{keys}
  sdo:
    - {{index: 0x6081, sub_index: 0, value: 500000}}
    - {{index: 0x6083, sub_index: 0, value: 900000}}
    - {{index: 0x6084, sub_index: 0, value: 900000}}
    - {{index: 0x6007, sub_index: 0, value: 3}}
    - {{index: 0x60C2, sub_index: 1, value: 10}}
    - {{index: 0x60C2, sub_index: 2, value: -3}}
  tpdo:
    1: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6041}}, {{index: 0x6061}}]}}
    2: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6064}}, {{index: 0x606C}}]}}
    3: {{enabled: false}}
    4: {{enabled: false}}
  rpdo:
    1: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6040}}, {{index: 0x6060}}]}}
    2: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{targets}]}}
    3: {{enabled: false}}
    4: {{enabled: false}}
nodes:
  pan_drive: {{node_id: 2}}
  tilt_drive: {{node_id: 3}}
"""
_MODES = MappingProxyType(
    {
        "pv": ("velocity", 3, "0x60FF"),
        "csv": ("velocity", 9, "0x60FF"),
        "pp": ("position", 1, "0x607A"),
        "csp": ("position", 8, "0x607A"),
        "ip": ("position", 7, "0x60C1, sub_index: 1"),
        "vl": ("velocity", 2, "0x6042"),
        "v-3": ("velocity", -3, "0x60FF"),  # Kinco's immediate velocity
        "cst": ("effort", 10, "0x6071"),
        "tq": ("effort", 4, "0x60F6, sub_index: 8"),  # Kinco's target torque object
    }
)


def folder(path: Path, *modes: str, keys: str = "", edit=None) -> Path:
    """Write the robot: its joints are commanded in `modes`, the first at start; `keys` are more lines of `defaults`."""
    eds = "generic_cia402.eds"
    if edit is not None:
        (path / "device.eds").write_text(edit(data_path("eds", eds).read_text()))
        eds = "device.eds"
    kinds = [_MODES[mode] for mode in modes]
    commands = "".join(f'<command_interface name="{kind}"/>' for kind, _, _ in kinds)
    joints = "".join(_JOINT.format(joint=joint, commands=commands) for joint in ("pan", "tilt"))
    (path / "two_axes.urdf").write_text(_URDF.format(joints=joints))
    controllers = {"velocity": "vel", "position": "pos", "effort": "eff"}
    text = "controller_manager:\n  ros__parameters:\n    update_rate: 100\n"
    text += "    joint_state_broadcaster: {type: joint_state_broadcaster/JointStateBroadcaster}\n"
    for kind, _, _ in kinds:
        text += f"    {controllers[kind]}: {{type: forward_command_controller/ForwardCommandController}}\n"
    for kind, _, _ in kinds:
        text += f"{controllers[kind]}:\n  ros__parameters:\n    joints: [pan, tilt]\n    interface_name: {kind}\n"
    (path / "ros2_controllers.yaml").write_text(text)
    lines = [f"  {kind}_mode: {number}" for kind, number, _ in kinds] + [f"  {key}" for key in keys.splitlines()]
    targets = ", ".join(f"{{index: {target}}}" for _, _, target in kinds)
    (path / "bus.yml").write_text(_BUS.format(eds=eds, keys="\n".join(lines), targets=targets))
    return path


_BOTH = "mapping: [{index: 0x6064}, {index: 0x606C}]"


def unmapped(path: Path, mapping: str, *, broadcast: bool = True) -> Path:
    """Write a robot whose TPDO 2 carries another mapping, "" for none."""
    bus, controllers = folder(path, "csv") / "bus.yml", path / "ros2_controllers.yaml"
    text = bus.read_text()
    without = re.sub(r"2: \{[^}]*0x6064.*", "2: {enabled: false}", text)
    bus.write_text(text.replace(_BOTH, mapping) if mapping else without)
    if not broadcast:
        controllers.write_text(re.sub("    joint_state_broadcaster.*\n", "", controllers.read_text()))
    return path


def robot(path: Path, *modes: str, keys: str = "", edit=None) -> TestedRobot:
    """Return the robot, running."""
    return TestedRobot(read_robot(find_robot(str(folder(path, *modes, keys=keys, edit=edit)))))


def drive(robot: TestedRobot, node_id: int):
    """Return the virtual drive of a node."""
    return robot.simulated.drives[node_id].device.drives[0]


def sentences(robot: TestedRobot) -> list[str]:
    """Return what the robot has reported."""
    return [event.sentence for event in robot.events]
