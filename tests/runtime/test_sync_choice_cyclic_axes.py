"""Joints of a robot's files in a cyclic synchronous mode: by key, and by the modes in the EDS."""

import pytest
from support.arm6 import copy_arm
from support.robots import copy_robby

from canopen_control.cia402.modes import OperationMode
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.sync_choice import cyclic_axes, joint_words


def axes_of(config):
    setup = read_robot(find_robot(str(config)))
    return cyclic_axes(setup.bus, setup.description)


@pytest.mark.rest
def test_the_joints_of_an_arm_are_in_csp_by_the_key_or_where_the_eds_lists_it(tmp_path):
    config = copy_arm(tmp_path)
    axes = axes_of(config)
    assert [(axis.joint, axis.node.node_id, axis.mode, axis.target) for axis in axes[:2]] == [
        ("joint_1", 2, OperationMode.CSP, 0x607A),
        ("joint_2", 3, OperationMode.CSP, 0x607A),
    ]
    path = config / "bus.yml"
    text = path.read_text()
    path.write_text(text.replace("  position_mode: 8  ", "  #"))
    assert len(axes_of(config)) == 6, "it is the first of the modes that the EDS lists"
    path.write_text(text.replace("position_mode: 8", "position_mode: 1"))
    assert axes_of(config) == []


def test_wheels_in_profile_velocity_are_none(tmp_path):
    assert axes_of(copy_robby(tmp_path)) == []


@pytest.mark.parametrize(
    ("count", "words"),
    [(1, "joint_1"), (3, "joint_1, joint_2, joint_3"), (6, "joint_1, joint_2, joint_3 and 3 more"), (0, "")],
)
def test_many_joints_are_named_by_the_first(tmp_path, count, words):
    assert joint_words(axes_of(copy_arm(tmp_path))[:count]) == words
