"""A robot of servo drives with every mode of CiA 402, all their targets mapped: files for any number of them."""

from __future__ import annotations

import re

from canopen_control.data_files import data_path

JOINTS = ("one", "two")
MODES = {"PP": 1, "VL": 2, "PV": 3, "TQ": 4, "HM": 6, "IP": 7, "CSP": 8, "CSV": 9, "CST": 10}
_BUS = """
master: {{node_id: 1, sync_period: {period}, heartbeat_producer: 100, baudrate: 1000}}
defaults:
  dcf: generic_cia402.eds
  heartbeat_producer: 100
  heartbeat_multiplier: 5
  heartbeat_consumer: true
  {extra}
  sdo:
    - {{index: 0x6081, sub_index: 0, value: 65536}}
    - {{index: 0x6083, sub_index: 0, value: 262144}}
    - {{index: 0x6084, sub_index: 0, value: 262144}}
    - {{index: 0x6085, sub_index: 0, value: 524288}}
    {sdo}
  tpdo:
    1:
      enabled: true
      cob_id: auto
      transmission: 1
      mapping: [{{index: 0x6041}}, {{index: 0x6061}}, {{index: 0x60FD}}]
    2: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6064}}, {{index: 0x606C}}]}}
    3: {{enabled: true, cob_id: auto, transmission: 1, mapping: [{{index: 0x6077}}, {{index: 0x603F}}]}}
    4: {{enabled: false}}
  rpdo:
    1: {{enabled: true, cob_id: auto, transmission: {rpdo}, mapping: [{{index: 0x6040}}, {{index: 0x6060}}]}}
    2: {{enabled: true, cob_id: auto, transmission: {rpdo}, mapping: [{{index: 0x607A}}, {{index: 0x60FF}}]}}
    3:
      enabled: true
      cob_id: auto
      transmission: {rpdo}
      mapping: [{{index: 0x6071}}, {{index: 0x6042}}, {{index: 0x60C1, sub_index: 1}}]
    4: {{enabled: true, cob_id: auto, mapping: [{{index: 0x60FE, sub_index: 1}}]}}
nodes:
{nodes}
"""
_TWO_AXES = """
  tpdo:
    1:
      enabled: true
      cob_id: auto
      transmission: 1
      mapping: [{index: 0x6041}, {index: 0x6061}, {index: 0x6841}, {index: 0x6861}]
    2: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6064}, {index: 0x606C}]}
    3: {enabled: true, cob_id: auto, transmission: 1, mapping: [{index: 0x6864}, {index: 0x686C}]}
    4: {enabled: false}
  rpdo:
    1: {enabled: true, cob_id: auto, mapping: [{index: 0x6040}, {index: 0x6060}, {index: 0x60FE, sub_index: 1}]}
    2: {enabled: true, cob_id: auto, mapping: [{index: 0x607A}, {index: 0x60FF}]}
    3: {enabled: true, cob_id: auto, mapping: [{index: 0x6840}, {index: 0x6860}]}
    4: {enabled: true, cob_id: auto, mapping: [{index: 0x687A}, {index: 0x68FF}]}
nodes:
  drive_one: {node_id: 2}
"""
_EXTRAS = ("nmt_state", "statusword", "error_code", "age", "digital_inputs")


def write_generic(
    folder, *, joints=JOINTS, extra="", sdo="", rpdo=255, period=10_000, modes="", groups=False, named="", velocity=None
):
    """Write a robot to `folder`/generic; `modes` are lines such as ``velocity_mode: 9``. Returns the folder.

    `velocity` is the velocity limit of its joints in the URDF.
    """
    target = folder / "generic"
    target.mkdir()
    nodes = "\n".join(
        f"  drive_{name}:\n    node_id: {number}\n" + "".join(f"    {line}\n" for line in modes.splitlines())
        for number, name in enumerate(joints, 2)
    )
    bus = _BUS.format(period=period, extra=extra, sdo=sdo, rpdo=rpdo, nodes=nodes)
    (target / "bus.yml").write_text(bus)
    controllers = "".join(
        f"    {kind}: {{type: forward_command_controller/ForwardCommandController}}\n"
        for kind in ("velocity", "position", "effort")
    )
    params = "".join(
        f"{kind}:\n  ros__parameters: {{joints: [{', '.join(joints)}], interface_name: {kind}}}\n"
        for kind in ("velocity", "position", "effort")
    )
    (target / "ros2_controllers.yaml").write_text(
        "controller_manager:\n  ros__parameters:\n    update_rate: 100\n"
        f"    broadcaster: {{type: joint_state_broadcaster/JointStateBroadcaster}}\n{controllers}{params}"
    )
    (target / "generic.urdf").write_text(_urdf(joints, groups=groups, velocity=velocity))
    return target


def _urdf(joints, *, groups, velocity):
    limit = "" if velocity is None else f"<limit effort='100' velocity='{velocity}'/>"
    links = "<link name='base'/>" + "".join(f"<link name='link_{name}'/>" for name in joints)
    tree = "".join(
        f"<joint name='{name}' type='continuous'><parent link='base'/><child link='link_{name}'/><axis xyz='0 0 1'/>"
        f"{limit}</joint>"
        for name in joints
    )
    commands = "".join(
        f"<command_interface name='{kind}'/>" for kind in ("position", "velocity", "effort", "digital_outputs")
    )
    states = "".join(f"<state_interface name='{kind}'/>" for kind in ("position", "velocity", "effort", *_EXTRAS))
    control = "".join(
        f"<joint name='{name}'><param name='device_name'>drive_{name}</param>"
        + (f"<param name='stop_group'>{name}</param>" if groups else "")
        + f"{commands}{states}</joint>"
        for name in joints
    )
    plugin = "<hardware><plugin>canopen_control/CanopenSystem</plugin></hardware>"
    system = f"<ros2_control name='generic' type='system'>{plugin}{control}</ros2_control>"
    return f"<robot name='generic'>{links}{tree}{system}</robot>"


def write_two_axes(folder):
    """Write a robot whose one device has two axes: the generic drive, its profile again 0x800 higher."""
    config = write_generic(folder)
    text = data_path("eds", "generic_cia402.eds").read_text()
    sections = re.split(r"(?m)^(?=\[)", text)
    profile = [section for section in sections if re.match(r"\[6[0-7]", section)]
    second = [re.sub(r"^\[6(.)", lambda result: f"[6{int(result[1], 16) + 8:X}", line) for line in profile]
    count = int(re.search(r"\[OptionalObjects\]\s+SupportedObjects=(\d+)", text)[1])
    indices = sorted({int(line[1:5], 16) for line in second})
    listed = "".join(f"{count + number}=0x{index:04X}\n" for number, index in enumerate(indices, 1))
    text = re.sub(
        r"(\[OptionalObjects\]\s+)SupportedObjects=\d+\n",
        rf"\g<1>SupportedObjects={count + len(indices)}\n{listed}",
        text,
    )
    (config / "two.eds").write_text(text + "".join(second))
    bus = (config / "bus.yml").read_text().replace("generic_cia402.eds", "two.eds")
    (config / "bus.yml").write_text(bus.partition("  tpdo:\n")[0] + _TWO_AXES.lstrip("\n"))
    urdf = (
        (config / "generic.urdf")
        .read_text()
        .replace("drive_two</param>", "drive_one</param><param name='axis'>1</param>")
    )
    for kind in ("effort", "digital_outputs"):
        urdf = urdf.replace(f"<command_interface name='{kind}'/>", "")
    (config / "generic.urdf").write_text(urdf)
    return config
