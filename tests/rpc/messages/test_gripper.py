import pytest

from canopen_control.rpc.messages.gripper import GRIPPER_METHODS, MoveGripper, SendGripper
from canopen_control.rpc.messages.robot import ROBOT
from canopen_control.rpc.wire import convert


def test_the_methods_are_those_of_the_robots_socket():
    assert [ROBOT.of(request).name for _, _, request in GRIPPER_METHODS] == [name for name, _, _ in GRIPPER_METHODS]


@pytest.mark.parametrize("kind", [MoveGripper, SendGripper])
def test_a_goal_ends_with_its_connection_unless_it_reports_otherwise(kind):
    request = convert({"controller": "gripper", "position": 0.04}, kind)
    assert (request.max_effort, request.max_velocity, request.dead_man) == (None, None, True)
    with pytest.raises(ValueError, match="position"):
        convert({"controller": "gripper", "position": None}, kind)
