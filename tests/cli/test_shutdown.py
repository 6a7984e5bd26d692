import pytest

from canopen_control.cli.main import main
from canopen_control.client import find_robots
from canopen_control.errors import BusError


def test_it_returns_when_the_robot_has_ended(mock_robot):
    assert main(["shutdown"]) == 0
    mock_robot.shutdown()
    assert find_robots() == []
    with pytest.raises(BusError):
        mock_robot.status()
