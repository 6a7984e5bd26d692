import pytest

from canopen_control.controllers.params import Params
from canopen_control.controllers.standard_params import (
    RENAMES,
    BroadcasterParams,
    ForwardParams,
    MultiParams,
    SingleParams,
)
from canopen_control.errors import RobotConfigError


def test_joints_and_one_interface():
    given = Params.of({"joints": ["a", "b"], "interface_name": "velocity", "command_timeout": 0.5}).read(ForwardParams)
    assert (given.joints, given.interface_name, given.command_timeout) == (("a", "b"), "velocity", 0.5)


def test_one_joint_and_its_interfaces():
    assert Params.of({"joint": "a", "interface_names": ["position"]}).read(MultiParams).interface_names == ("position",)
    assert Params.of({"joint": "a"}).read(SingleParams) == SingleParams(joint="a")


def test_a_timeout_below_zero_is_refused():
    with pytest.raises(RobotConfigError, match="command_timeout"):
        Params.of({"command_timeout": -0.1}).read(ForwardParams)


def test_a_value_is_read_from_the_interface_that_the_map_names():
    given = Params.of({"map_interface_to_joint_state": {"position": "kf_position"}}).read(BroadcasterParams)
    assert (given.position, given.velocity, given.effort) == ("kf_position", "velocity", "effort")


def test_the_key_of_ros_1_is_the_rate():
    assert Params.of({"publish_rate": 50}).read(BroadcasterParams, RENAMES).update_rate == 50
