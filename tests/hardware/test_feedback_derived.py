"""A joint whose drive shows no velocity, or neither velocity nor position."""

import pytest
from support.makers import COUNTS, drive, unmapped

from canopen_control.errors import UnknownName
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot


@pytest.fixture
def robot(tmp_path):
    created = []

    def make(mapping, **how):
        created.append(TestedRobot(read_robot(find_robot(str(unmapped(tmp_path, mapping, **how))))))
        return created[-1]

    yield make
    for item in created:
        item.close()


def test_a_velocity_that_the_drive_does_not_show_is_made_of_its_positions(robot):
    created = robot("mapping: [{index: 0x6064}]")
    created.command("vel", 0.5, 0.0, seconds=1)
    created.run(0.9)
    assert created.velocity("pan") == pytest.approx(drive(created, 2).mover.plant.velocity / COUNTS, rel=0.05)
    assert created.velocity("pan") == pytest.approx(0.5, rel=0.05)
    created.run(3)
    assert created.velocity("pan") == pytest.approx(0.0, abs=0.01)
    assert created.velocity("tilt") == pytest.approx(0.0, abs=0.01)


def test_a_quantity_that_no_tpdo_brings_is_named_when_it_is_asked_for(robot):
    created = robot("mapping: [{index: 0x606C}]")
    with pytest.raises(UnknownName, match="joint 'pan' has no position: no TPDO of pan_drive carries it"):
        created.position("pan")


def test_a_robot_without_any_feedback_moves_and_reports_this(robot):
    created = robot("", broadcast=False)
    created.command("vel", 0.5, 0.0, seconds=1)
    created.run(0.8)
    assert created.drives[2].moving
    assert created.state == "running"
    with pytest.raises(UnknownName, match="has no velocity"):
        created.velocity("pan")
