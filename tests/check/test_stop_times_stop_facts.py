"""Facts about the stop of each axis, from a robot's files."""

import pytest
from support.arm6 import copy_arm
from support.robots import copy_robby

from canopen_control.check.stop_times import axis_facts, command_timeouts
from canopen_control.host.reactor import MarkedSelector, Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot


def facts_of(config):
    return axis_facts(read_robot(find_robot(str(config))))


def test_an_arm_has_its_limits_its_times_and_what_bus_yml_writes(tmp_path):
    config = copy_arm(tmp_path)
    first = facts_of(config)[0]
    assert (first.joint, first.node, first.node_id, first.cycle_s) == ("joint_1", "joint_1_drive", 2, 0.02)
    assert (first.silence_s, first.master_s) == (0.5, 0.5)
    assert first.speed == pytest.approx(2.0 * 1043037.8350470454)
    assert first.objects[0x6007] == 3
    path = config / "bus.yml"
    path.write_text(path.read_text().replace("sdo:\n", "sdo:\n    - {index: 0x6084, sub_index: 0, value: 1234}\n", 1))
    assert facts_of(config)[0].objects[0x6084] == 1234


def test_the_drives_own_limit_counts_where_it_is_smaller(tmp_path):
    config = copy_arm(tmp_path)
    path = config / "bus.yml"
    path.write_text(path.read_text().replace("sdo:\n", "sdo:\n    - {index: 0x607F, sub_index: 0, value: 5000}\n", 1))
    assert facts_of(config)[0].speed == 5000


def test_the_lives_of_commands_are_those_of_the_loaded_controllers():
    setup = read_robot(find_robot("robby"))
    with Reactor(ManualClock(), MarkedSelector()) as reactor:
        core = RobotCore(setup, reactor)
        lives = command_timeouts(core.manager)
        core.close()
    assert lives == {joint: {"robby_forward_controller": 2.0} for joint in ("left_wheel_joint", "right_wheel_joint")}


def test_the_brake_of_a_base_is_that_of_its_deceleration_limits(tmp_path):
    """1 m/s and 1 rad/s at 1 m/s^2 and 1 rad/s^2, and half of that."""
    for value, brake in (("-1.0", 1.0), ("-0.5", 2.0)):
        folder = tmp_path / value
        folder.mkdir()
        edit = {"linear.x.max_deceleration: -1.0": f"linear.x.max_deceleration: {value}"}
        setup = read_robot(find_robot(str(copy_robby(folder, controllers=edit))), controllers=["robby_base_controller"])
        with Reactor(ManualClock(), MarkedSelector()) as reactor:
            core = RobotCore(setup, reactor)
            facts = axis_facts(setup, core.manager)
            core.close()
        assert [fact.brakes for fact in facts] == [{"robby_base_controller": brake}] * 2
