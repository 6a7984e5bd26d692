"""A joint whose drive shows no velocity, or neither velocity nor position."""

import pytest
from support.makers import COUNTS, drive, unmapped

from canopen_control.errors import UnknownName
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot


@pytest.fixture
def robot(tmp_path):
    made = []

    def make(mapping, **how):
        made.append(TestedRobot(read_robot(find_robot(str(unmapped(tmp_path, mapping, **how))))))
        return made[-1]

    yield make
    for each in made:
        each.close()


def test_a_velocity_that_the_drive_does_not_show_is_made_of_its_positions(robot):
    made = robot("mapping: [{index: 0x6064}]")
    made.command("vel", 0.5, 0.0, seconds=1)
    made.run(0.9)
    assert made.velocity("pan") == pytest.approx(drive(made, 2).mover.plant.velocity / COUNTS, rel=0.05)
    assert made.velocity("pan") == pytest.approx(0.5, rel=0.05)
    made.run(3)
    assert made.velocity("pan") == pytest.approx(0.0, abs=0.01)
    assert made.velocity("tilt") == pytest.approx(0.0, abs=0.01)


def test_a_quantity_that_no_tpdo_brings_is_named_when_it_is_asked_for(robot):
    made = robot("mapping: [{index: 0x606C}]")
    with pytest.raises(UnknownName, match="joint 'pan' has no position: no TPDO of pan_drive carries it"):
        made.position("pan")


def test_a_robot_without_any_feedback_moves_and_reports_this(robot):
    made = robot("", broadcast=False)
    made.command("vel", 0.5, 0.0, seconds=1)
    made.run(0.8)
    assert made.drives[2].moving
    assert made.state == "running"
    with pytest.raises(UnknownName, match="has no velocity"):
        made.velocity("pan")
