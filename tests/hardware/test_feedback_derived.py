"""A joint whose drive shows no velocity, or neither velocity nor position."""

import re

import pytest
from support.makers import COUNTS, drive, folder

from canopen_control.check.checker import CheckOptions, check_robot
from canopen_control.errors import UnknownName
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.testing.tested_robot import TestedRobot

BOTH = "mapping: [{index: 0x6064}, {index: 0x606C}]"


def unmapped(path, mapping, *, broadcast=True):
    """Write a robot whose TPDO 2 carries another mapping, "" for none."""
    bus, controllers = folder(path, "csv") / "bus.yml", path / "ros2_controllers.yaml"
    text = bus.read_text()
    without = re.sub(r"2: \{[^}]*0x6064.*", "2: {enabled: false}", text)
    bus.write_text(text.replace(BOTH, mapping) if mapping else without)
    if not broadcast:
        controllers.write_text(re.sub("    joint_state_broadcaster.*\n", "", controllers.read_text()))
    return path


def findings(path):
    return [str(each) for each in check_robot(find_robot(str(path)), CheckOptions()).findings]


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


def test_check_refuses_a_broadcaster_that_has_nothing_to_publish(tmp_path):
    found = findings(unmapped(tmp_path, ""))
    assert any("joint_state_broadcaster would have nothing to publish" in each for each in found)


def test_a_robot_without_any_feedback_moves_and_says_so(robot):
    made = robot("", broadcast=False)
    made.command("vel", 0.5, 0.0, seconds=1)
    made.run(0.8)
    assert made.drives[2].moving
    assert made.state == "running"
    with pytest.raises(UnknownName, match="has no velocity"):
        made.velocity("pan")


@pytest.mark.parametrize(
    ("mapping", "words"),
    [
        (
            "mapping: [{index: 0x6064}]",
            "asks for its velocity, .*0x606C: it is made of its positions, later and coarser",
        ),
        ("mapping: [{index: 0x606C}]", "asks for its position, .*0x6064: it has none"),
        ("", "asks for its velocity, .*0x606C: it has none"),
    ],
)
def test_check_names_what_the_description_asks_for_and_no_tpdo_brings(tmp_path, mapping, words):
    found = findings(unmapped(tmp_path, mapping))
    assert any(re.search(f"joint pan {words}; map 0x60", each) for each in found)


def test_check_says_nothing_of_a_robot_that_is_measured(tmp_path):
    assert not [each for each in findings(folder(tmp_path, "csv")) if "asks for its" in each]
