"""The parameters of the joint state broadcaster."""

from canopen_control.controllers.joint_state_params import RENAMES, BroadcasterParams
from canopen_control.controllers.params import Params


def test_a_value_is_read_from_the_interface_that_the_map_names():
    given = Params.of({"map_interface_to_joint_state": {"position": "kf_position"}}).read(BroadcasterParams)
    assert (given.position, given.velocity, given.effort) == ("kf_position", "velocity", "effort")


def test_the_key_of_ros_1_is_the_rate():
    assert Params.of({"publish_rate": 50}).read(BroadcasterParams, RENAMES).update_rate == 50
