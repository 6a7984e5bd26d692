import pytest

from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError, RobotConfigError
from canopen_control.rpc.messages.robot import GetStatus
from canopen_control.runtime.background import BackgroundRobot
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.run_session import RunOptions
from canopen_control.runtime.setup import read_robot

pytestmark = pytest.mark.robot


def mock(name="background"):
    return BackgroundRobot(read_robot(find_robot("robby"), name=name, mock=True), RunOptions(drives=False))


def test_it_serves_its_api_from_start_to_shutdown():
    robot = mock()
    assert not robot.running
    robot.start()
    robot.start()
    assert robot.running
    with RobotClient.connect("background") as client:
        assert client.ask(GetStatus()).state == "running"
    robot.shutdown()
    robot.shutdown()
    assert not robot.running
    assert find_robots() == []


@pytest.mark.rest
def test_what_keeps_it_from_running_is_raised():
    robot = mock()
    robot.start()
    with pytest.raises(RobotConfigError, match="runs already"):
        mock().start()
    robot.shutdown()
    setup = read_robot(find_robot("robby"), can=["memory:nobody"])
    with pytest.raises(CanopenError, match="left_drive"):
        BackgroundRobot(setup, RunOptions(drives=False)).start()
