import pytest

from canopen_control.controllers.params import (
    RENAMES,
    BroadcasterParams,
    ForwardParams,
    LoopGains,
    MultiParams,
    Params,
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


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"i": 1.0, "antiwindup_strategy": "back_calculation"}, "give tracking_time_constant"),
        ({"p": 1.0, "i": 1.0, "d": -1.0, "antiwindup_strategy": "back_calculation"}, "give tracking_time_constant"),
        ({"p": float("nan")}, "p is nan; give a finite number"),
        ({"u_clamp_max": -1.0, "u_clamp_min": 1.0}, "give u_min < u_max"),
    ],
)
def test_gains_that_make_a_command_of_no_number_are_refused(given, text):
    with pytest.raises(RobotConfigError, match=text):
        Params.of(given).read(LoopGains)
    assert Params.of({"p": 1.0, "i": 1.0, "antiwindup_strategy": "back_calculation"}).read(LoopGains).p == 1.0
