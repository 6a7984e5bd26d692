"""The parts of a joint: what they say before anything is there, and what of the description is refused."""

import pytest
from support.arm6 import copy_arm
from support.robots import LEFT, Bench

from canopen_control.errors import RobotConfigError


def test_before_its_node_is_there_nothing_is_known_and_nothing_enabled():
    bench = Bench("parts1", drives=())
    joint = bench.joint(LEFT)
    assert (joint.state, joint.statusword, joint.claimed) == (None, None, None)
    assert (joint.enabled, joint.following, joint.wanted, joint.homed) == (False, False, False, False)
    assert joint.age_ns(0) is None
    assert joint.has_come_to_rest(0)
    assert joint.tracking.figures() is None
    bench.close()


def test_holds_load_is_true_or_false(tmp_path):
    config = copy_arm(tmp_path)
    path, old = config / "arm6.urdf", '<param name="device_name">joint_1_drive</param>'
    path.write_text(path.read_text().replace(old, old + '<param name="holds_load">perhaps</param>'))
    with pytest.raises(RobotConfigError, match="holds_load is 'perhaps'; it is true or false"):
        Bench("parts2", config=config)
