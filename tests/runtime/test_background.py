import threading

import pytest
from support.host import eventually

from canopen_control.client import RobotClient, find_robots
from canopen_control.errors import CanopenError, RobotConfigError
from canopen_control.rpc.messages.robot import GetStatus
from canopen_control.runtime import background
from canopen_control.runtime.background import BackgroundRobot
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.run_session import RunOptions, RunSession
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


def test_a_shutdown_before_the_robot_exists_boots_nothing(monkeypatch):
    """An interrupt may come while the session waits for a channel that a former run has not released yet."""
    waiting, released, started = threading.Event(), threading.Event(), []

    def slow_session(*arguments):
        waiting.set()
        assert released.wait(30)
        session = RunSession(*arguments)
        start = session.start
        session.start = lambda: (started.append(session), start())
        return session

    monkeypatch.setattr(background, "RunSession", slow_session)
    robot = mock("early")
    starting = threading.Thread(target=robot.start)
    starting.start()
    assert waiting.wait(30)
    ending = threading.Thread(target=robot.shutdown)
    ending.start()
    assert eventually(lambda: robot._ended)
    released.set()
    ending.join(30)
    starting.join(30)
    assert not ending.is_alive()
    assert started == []
    assert find_robots() == []


def test_a_ctrl_c_during_the_shutdown_does_not_interrupt_the_stop():
    robot = mock("twice")
    robot.start()
    thread, joined = robot._thread, []

    class Interrupted:
        def is_alive(self):
            return thread.is_alive()

        def join(self, seconds):
            joined.append(seconds)
            if len(joined) == 1:
                raise KeyboardInterrupt
            thread.join(seconds)

    robot._thread = Interrupted()
    with pytest.raises(KeyboardInterrupt):
        robot.shutdown()
    assert not thread.is_alive()
    assert find_robots() == []


def test_it_can_be_started_again():
    robot = mock("again")
    for _ in range(2):
        robot.start()
        with RobotClient.connect("again") as client:
            assert client.ask(GetStatus()).state == "running"
        robot.shutdown()
