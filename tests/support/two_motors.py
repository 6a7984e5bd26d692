"""A robot with two wheels on one drive, whose motors share one set of objects as those of ZLTECH's ZLAC8015D do."""

import re

from canopen_control.data_files import data_path
from canopen_control.od.eds import parse_eds
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot

COUNTS = 4096 / 6.283185307179586  # per radian
NODE = 2

_BOTH = (0x60FF, 0x606C)
_MOTORS = {
    **dict.fromkeys((0x607A, 0x60FF), ("rww", "0x0004")),
    **dict.fromkeys((0x6064, 0x606C), ("ro", "0x0004")),
    0x6077: ("ro", "0x0003"),
    **dict.fromkeys((0x6081, 0x6083, 0x6084, 0x6085), ("rw", "0x0007")),
}

_URDF = """<robot name="cart">
  <link name="base"/><link name="left_wheel"/><link name="right_wheel"/>
  <joint name="left" type="continuous"><parent link="base"/><child link="left_wheel"/><axis xyz="0 1 0"/>
    <limit velocity="20" effort="10"/></joint>
  <joint name="right" type="continuous"><parent link="base"/><child link="right_wheel"/><axis xyz="0 1 0"/>
    <limit velocity="20" effort="10"/></joint>
{systems}
</robot>
"""
_SYSTEM = """
  <ros2_control name="{name}" type="system">
    <hardware><plugin>canopen_ros2_control/RobotSystem</plugin></hardware>{joints}
  </ros2_control>"""
_JOINT = """
    <joint name="{joint}"><param name="device_name">wheels</param><param name="axis">{axis}</param>{more}
      <command_interface name="velocity"/>
      <state_interface name="position"/><state_interface name="velocity"/></joint>"""
_BUS = """master:
  node_id: 1
  channel: local:wheels
  baudrate: 1000
  sync_period: 10000
  heartbeat_producer: 100
nodes:
  wheels:
    node_id: 2
    dcf: device.eds
    {key}
    {mode}
    heartbeat_producer: 100
    heartbeat_consumer: true
    counts_per_revolution: 4096
    sdo:
      - {{index: 0x6083, sub_index: 1, value: 20000}}
      - {{index: 0x6083, sub_index: 2, value: 20000}}
      - {{index: 0x6084, sub_index: 1, value: 20000}}
      - {{index: 0x6084, sub_index: 2, value: 20000}}
      - {{index: 0x6007, sub_index: 0, value: 3}}
    tpdo:
{tpdos}
    rpdo:
{rpdos}
"""
_PDO = "      {}: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{}]}}"
_OFF = "      {}: {{enabled: false}}"
_SEPARATE = (
    ("0x6041:0, 0x6061:0", "0x6064:1, 0x606C:1", "0x6064:2, 0x606C:2"),
    ("0x6040:0, 0x6060:0", "0x60FF:1, 0x60FF:2"),
)
_TOGETHER = (("0x6041:0, 0x606C:3", "0x6061:0, 0x603F:0", "0x6064:1, 0x6064:2"), ("0x6040:0, 0x60FF:3",))


def two_motors(text: str) -> str:
    """Return the generic EDS with the objects of two motors in subindices, and a statusword of 32 bits."""
    for index, (access, kind) in _MOTORS.items():
        motors = [(1, "Left motor", kind), (2, "Right motor", kind)]
        motors += [(3, "Both motors", "0x0007")] if index in _BOTH else []
        record = f"[{index:X}]\nParameterName=Object\nObjectType=0x8\nSubNumber={len(motors) + 1}\n\n[{index:X}sub0]\n"
        record += "ParameterName=Number of entries\nObjectType=0x7\nDataType=0x0005\nAccessType=ro\n"
        record += f"DefaultValue={len(motors)}\nPDOMapping=0\n"
        for motor, name, data_type in motors:
            record += f"\n[{index:X}sub{motor}]\nParameterName={name}\nObjectType=0x7\nDataType={data_type}\n"
            record += f"AccessType={access}\nDefaultValue=0\nPDOMapping=1\n"
        text = re.sub(rf"\[{index:X}\].*?(?=\n\[)", lambda _: record, text, count=1, flags=re.DOTALL)  # noqa: B023
    return re.sub(r"(\[60(?:41|3F)\][^[]*DataType=)0x0006", r"\g<1>0x0007", text)


def eds_text() -> str:
    """Return the EDS of the drive."""
    return two_motors(data_path("eds", "generic_cia402.eds").read_text())


def dictionary(edit=str):
    """Return the dictionary of the drive; `edit` changes its EDS."""
    return parse_eds(edit(eds_text()).encode()).od


def _pdos(mappings, count=4):
    lines = []
    for number in range(1, count + 1):
        entries = mappings[number - 1].split(", ") if number <= len(mappings) else []
        pairs = (entry.split(":") for entry in entries)
        mapping = ", ".join(f"{{index: {index}, sub_index: {subindex}}}" for index, subindex in pairs)
        lines.append(_PDO.format(number, mapping) if mapping else _OFF.format(number))
    return "\n".join(lines)


def folder(
    path,
    *,
    together=False,
    key="motor_subindices: [1, 2]",
    mode="velocity_mode: 3",
    axes="01",
    more=("", ""),
    edit=str,
    apart=False,
):
    """Write the robot; `together`: targets and velocities are mapped as both in one object, `edit` changes the EDS.

    `axes` are those of the joints left and right, None for no joint; `apart`: each in a hardware component of its own.
    """
    (path / "device.eds").write_text(edit(eds_text()))
    joints = zip(("left", "right"), axes, more, strict=True)
    tags = [_JOINT.format(joint=joint, axis=axis, more=extra) for joint, axis, extra in joints if axis]
    systems = tags if apart else ["".join(tags)]
    text = "".join(_SYSTEM.format(name=f"cart_{number}", joints=joints) for number, joints in enumerate(systems))
    (path / "cart.urdf").write_text(_URDF.format(systems=text))
    text = "controller_manager:\n  ros__parameters:\n    update_rate: 100\n"
    text += "    joint_state_broadcaster: {type: joint_state_broadcaster/JointStateBroadcaster}\n"
    text += "    vel: {type: forward_command_controller/ForwardCommandController}\n"
    names = ", ".join(joint for joint, axis in zip(("left", "right"), axes, strict=True) if axis)
    text += f"vel:\n  ros__parameters:\n    joints: [{names}]\n    interface_name: velocity\n"
    (path / "ros2_controllers.yaml").write_text(text)
    tpdos, rpdos = map(_pdos, _TOGETHER if together else _SEPARATE)
    (path / "bus.yml").write_text(_BUS.format(key=key, mode=mode, tpdos=tpdos, rpdos=rpdos))
    return path


def robot(path, **options):
    """Return the robot, running."""
    return TestedRobot(read_robot(find_robot(str(folder(path, **options)))))


def wheels(robot):
    """Return the two axes of the virtual drive."""
    return robot.simulated.drives[NODE].device.drives


def speeds(robot):
    """Return the velocities of both motors in rad/s."""
    return [axis.mover.plant.velocity / COUNTS for axis in wheels(robot).values()]
