"""The URDF of a new robot: a tree of links, and the tag that ties joints to nodes of bus.yml."""

from pathlib import Path

import pytest
from support.drive_shapes import shape

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.scaffold import bases
from canopen_control.scaffold.new_robot import Device, plan_robot
from canopen_control.scaffold.robot_folder import RADIUS, SEPARATION, WHEELBASE, description_text
from canopen_control.urdf.description import parse_description


def described(*ods, **how):
    devices = [Device(number, Path("d.eds"), od) for number, od in enumerate(ods, 2)]
    return parse_description(description_text(plan_robot("r", devices, **how)))


def test_the_wheels_of_a_base_stand_where_the_controllers_file_specifies():
    places = {
        name: tuple(joint.origin.position) for name, joint in described(*[shape()] * 4, base="diff").joints.items()
    }
    x, y = WHEELBASE / 2, SEPARATION / 2
    assert places["front_left_wheel_joint"] == (x, y, 0.0)
    assert places["rear_right_wheel_joint"] == (-x, -y, 0.0)
    assert places["base_joint"] == (0.0, 0.0, RADIUS)


@pytest.mark.parametrize(
    ("name", "tag", "commands", "states"),
    [
        ("generic_cia401.eds", "gpio", "do0", "di0"),
        ("generic_cia404.eds", "gpio", "ao0", "ai0"),
        ("generic_cia410.eds", "sensor", None, "longitudinal"),
        ("generic_cia418.eds", "sensor", None, "battery_voltage"),
        ("generic_cia419.eds", "gpio", "charge_current_requested", "charger_status"),
    ],
)
def test_a_device_that_is_not_a_drive_has_its_signals(name, tag, commands, states):
    path = data_path("eds", name)
    devices = [Device(2, Path("d.eds"), shape()), Device(9, path, read_eds(path, 9).od)]
    robot = plan_robot("r", devices)
    system = parse_description(description_text(robot)).hardware[0]
    (part,) = system.gpios if tag == "gpio" else system.sensors
    assert part.name == robot.nodes[1].name
    assert states in part.state_interfaces
    assert (commands in part.command_interfaces) if commands else not part.command_interfaces


def test_an_encoder_measures_a_joint_that_nothing_commands():
    path = data_path("eds", "generic_cia406.eds")
    description = parse_description(description_text(plan_robot("r", [Device(9, path, read_eds(path, 9).od)])))
    (joint,) = description.hardware[0].joints
    assert (joint.name, joint.parameters) == ("encoder_9_joint", {"device_name": "encoder_9"})
    assert (list(joint.command_interfaces), list(joint.state_interfaces)) == ([], ["position", "velocity"])
    assert description.joints["encoder_9_joint"].type == "continuous"


def test_a_steered_wheel_is_in_front_and_turns_about_the_vertical(monkeypatch):
    monkeypatch.setattr(bases, "TYPES", {base.type_name for base in bases.BASES.values()})
    steering = described(*[shape()] * 3, base="tricycle").joints["steering_joint"]
    assert (tuple(steering.origin.position), tuple(steering.axis)) == ((WHEELBASE, 0.0, 0.0), (0.0, 0.0, 1.0))
