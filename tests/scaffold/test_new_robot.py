"""Creation of a new robot, and all errors in its options."""

import dataclasses
from pathlib import Path

import pytest
from support.drive_shapes import shape

from canopen_control.cia402.modes import OperationMode
from canopen_control.data_files import data_path
from canopen_control.errors import RobotConfigError
from canopen_control.od.eds import read_eds
from canopen_control.personality import read_personality
from canopen_control.scaffold.new_robot import Device, plan_robot


def device(node_id, **how):
    return Device(node_id, Path("drive.eds"), shape(**how))


def module(node_id):
    return Device(node_id, Path("module.eds"), shape(drop=(0x6040, 0x6041)))


@pytest.mark.parametrize(
    ("name", "better"),
    [
        ("my robot", "my_robot"),
        ("../robot", "robot"),
        ("/tmp/a-b", "a_b"),
        ("9lives", "my_robot"),
        ("", "my_robot"),
        ("r" * 33, "r" * 32),
    ],
)
def test_a_name_that_cannot_be_one_comes_with_one_that_can(name, better):
    with pytest.raises(RobotConfigError, match=f"not a valid robot name.*such as '{better}'"):
        plan_robot(name, [device(2)])


def test_names_follow_the_joints_and_joints_may_be_named_in_part():
    robot = plan_robot("arm", [device(2), device(3)], joints=["shoulder_joint"])
    assert [(joint.node, joint.name) for joint in robot.joints] == [
        ("shoulder_drive", "shoulder_joint"),
        ("joint_2_drive", "joint_2"),
    ]


def test_everything_wrong_is_reported_at_once():
    with pytest.raises(RobotConfigError) as refused:
        plan_robot("arm", [device(2), device(2)], joints=["a", "b", "b", "c d"], base="tricycle")
    message = str(refused.value)
    for part in (
        "node-ID 2 is given twice",
        "--joint c d: a joint name",
        "--joint b is given twice",
        "4 joints for 2 drives; give a node-ID for each, or fewer --joint",
        "--base tricycle",
    ):
        assert part in message


def test_a_device_that_is_not_a_drive_has_no_joint():
    robot = plan_robot("cell", [module(4), device(5)])
    assert [(node.name, [joint.name for joint in node.joints]) for node in robot.nodes] == [
        ("device_4", []),
        ("joint_1_drive", ["joint_1"]),
    ]
    with pytest.raises(RobotConfigError, match=r"1 joints for 0 drives \(1 of the 1 nodes are not drives\)"):
        plan_robot("cell", [module(4)], joints=["lamp"])


@pytest.mark.parametrize(
    ("number", "name"), [(401, "io_9"), (404, "sensor_9"), (406, "encoder_9"), (418, "battery_9"), (419, "charger_9")]
)
def test_a_device_is_called_by_its_profile(number, name):
    path = data_path("eds", f"generic_cia{number}.eds")
    assert plan_robot("cell", [Device(9, path, read_eds(path, 9).od)]).nodes[0].name == name


@pytest.mark.rest
def test_the_master_takes_an_id_that_is_free():
    assert plan_robot("r", [device(2)]).master_id == 1
    assert plan_robot("r", [device(1)]).master_id == 127
    assert plan_robot("r", [module(1), module(127)]).master_id == 126
    with pytest.raises(RobotConfigError, match="all 127 node-IDs are used"):
        plan_robot("r", [module(node_id) for node_id in range(1, 128)])


def test_a_drive_that_can_neither_reports_what_it_has_and_moves_no_joint():
    robot = plan_robot("r", [device(2, s6502_00={"default": 0x08}), device(3)], base="diff")
    (problem,) = robot.problems
    assert problem.startswith("drive.eds: its modes are TQ (0x6502), and no RPDO can carry")
    assert problem.endswith("map the objects in bus.yml by hand, or leave node 2 out")
    assert [(joint.name, joint.node) for joint in robot.joints] == [("right_wheel_joint", "right_wheel_drive")]
    assert robot.base.name == "none"
    assert not robot.is_bus_alone
    assert plan_robot("r", [device(2, s6502_00={"default": 0x08})]).is_bus_alone


def test_a_drive_whose_targets_no_pdo_may_carry_is_for_sdo_only():  # as Faulhaber's EDS of MCBL and MCDC
    od = shape(drop=(0x6042, 0x60C1))
    for index in (0x607A, 0x60FF, 0x6071):
        if (entry := od.get(index)) is not None:
            od.entries[entry.address] = dataclasses.replace(entry, pdo_mappable=False)
    (problem,) = plan_robot("r", [Device(2, Path("drive.eds"), od)]).problems
    assert "no RPDO can carry the controlword (0x6040) and a target" in problem
    assert problem.endswith("the EDS allows no target in an RPDO: use the drive by SDO only, or leave node 2 out")


def test_a_drive_of_a_manufacturer_has_its_objects_and_its_modes():
    path = data_path("eds", "generic_cia402.eds")
    device = Device(2, path, read_eds(path).od)
    kinco, vfd = (device.of_manufacturer(read_personality(name)) for name in ("kinco", "vfd"))
    assert (0x603F, 0) not in kinco.od
    assert 0x603F not in kinco.od.objects
    assert kinco.od[0x6502, 0] == device.od[0x6502, 0]
    assert vfd.od[0x6502, 0].default == 1 << 1  # VL
    (joint,) = plan_robot("r", [vfd]).joints
    assert joint.axis.mode is OperationMode.VL


@pytest.mark.parametrize(("count", "more"), [(253, True), (254, False)])
def test_a_bus_coupler_has_the_signals_of_its_default_pdos(count, more):
    """Its file has all 254 subindices, and mapping those that no module has ends the boot with an error."""
    path = data_path("eds", "generic_cia401.eds")
    od = read_eds(path, 9).od
    before = plan_robot("cell", [Device(9, path, od)]).nodes[0].signals
    for subindex in range(1, count + 1):
        od.add(dataclasses.replace(od[0x6000, 1], subindex=subindex, name=f"Inputs {subindex}"))
    signals = plan_robot("cell", [Device(9, path, od)]).nodes[0].signals
    assert (len(signals) > len(before)) == more
    assert more or set(signals) == set(before)
