"""How a command ends, and what is said of drives that are not enabled."""

import pytest
from support.host import eventually

from canopen_control.cli.commanded import not_enabled, positions_of
from canopen_control.cli.main import main
from canopen_control.runtime.robot import Robot

ARM = "arm_position_controller"
TARGETS = [0.3, 0.4, -0.5, 0.2, 0.3, 0.1]
MIXED = [{"name": "mixed", "required_command_interfaces": ["a/position", "a/velocity"]}]


@pytest.fixture
def arm(private_folders):
    with Robot.from_config("arm6", mock=True, name="arm") as robot:
        yield robot


def values(robot, what):
    joints = robot.status()["joints"]
    return [joints[f"joint_{number}"][what] for number in range(1, 7)]


@pytest.mark.parametrize("end", [["--for", "1.5"], ["--once"]])
def test_a_position_is_no_motion_back_to_zero_when_the_command_ends(arm, end):
    """Zeros are positions too: an arm that is sent them falls back to where it began."""
    assert main(["command", ARM, *map(str, TARGETS), *end]) == 0
    assert eventually(lambda: values(arm, "position") == pytest.approx(TARGETS))
    cycle = arm.status()["cycle"]["count"]
    assert eventually(lambda: arm.status()["cycle"]["count"] > cycle + 25)
    assert values(arm, "position") == pytest.approx(TARGETS)


def test_the_end_of_the_command_ends_the_motion_to_a_far_position(arm):
    assert main(["command", ARM, "1.5", "0", "0", "0", "0", "0", "--for", "0.2"]) == 0
    assert eventually(lambda: values(arm, "command")[0] is None)
    assert values(arm, "position")[0] < 1.4


def test_each_value_is_known_for_what_it_is():
    assert positions_of(MIXED, "mixed") == [True, False]
    assert positions_of(MIXED, "other") == []


def status(**states):
    axes = {name: [{"joint": f"{name}_joint", "cia402_state": state}] for name, state in states.items()}
    return {"nodes": {name: {"axes": each} for name, each in axes.items()}}


@pytest.mark.parametrize(
    ("states", "joints", "words"),
    [
        ({"left": "OPERATION_ENABLED"}, None, []),
        ({"left": "SWITCH_ON_DISABLED"}, None, ["left is not enabled and will not move"]),
        ({"left": "FAULT", "right": None}, None, ["left, right are not enabled and will not move"]),
        ({"left": "OPERATION_ENABLED", "right": "FAULT"}, {"left_joint"}, []),
    ],
)
def test_drives_that_will_not_move_are_named(states, joints, words):
    found = not_enabled(status(**states), joints)
    assert [line.partition(":")[0] for line in found] == words
    assert all(line.endswith("canopen-control axis enable all") for line in found)


def test_a_fault_has_to_be_reset_before():
    (told,) = not_enabled(status(left="FAULT"))
    assert told.endswith("not move: canopen-control axis fault-reset all, then canopen-control axis enable all")
