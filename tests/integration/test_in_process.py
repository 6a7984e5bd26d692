"""Everything in one process: python-can's virtual bus, the memory bus, and the robot as a library."""

import threading

import pytest
from support.host import eventually
from support.processes import processes_of

from canopen_control import Robot
from canopen_control.errors import CanopenError, ControlError, RobotConfigError

FORWARD = "robby_forward_controller"


@pytest.mark.parametrize("channel", ["virtual:alone", "memory:alone"])
def test_robby_in_one_process(stage, channel):
    robot = stage.start("run", "robby", "--can", channel, "--for", 2, "--no-flight-recorder")
    robot.until("robby runs")
    assert list(stage.survivors()) == [robot.pid]
    assert stage.call("command", FORWARD, 10, 10, "--for", 0.6).wait() == 0
    assert robot.wait() == 0, robot
    assert robot.err == ""
    assert "robby has stopped, its drives are disabled" in robot.out


def velocities(robot):
    return [joint.velocity for joint in robot.status().joints.values()]


@pytest.mark.parametrize("channel", ["local:library", "virtual:library", "memory:library"])
def test_the_library_runs_a_robot_while_the_block_lasts(stage, private_folders, channel):
    threads = threading.active_count()
    with Robot.from_config("robby", can=channel) as robot:
        assert robot.status().state == "running"
        robot.command(FORWARD, [10.0, 5.0])
        assert eventually(lambda: velocities(robot) == pytest.approx([10.0, 5.0], rel=0.01))
        with pytest.raises(ControlError, match="expects 2 values"):
            robot.command(FORWARD, [1.0])
        with pytest.raises(ControlError, match="no controller 'nobody'"):
            robot.command("nobody", [1.0])
        robot.stop()
        assert velocities(robot) == [0.0, 0.0]
        robot.axis("enable")
        robot.axis("disable", "left_drive")
        with pytest.raises(ControlError, match="no node 'middle_drive'"):
            robot.axis("enable", "middle_drive")
    assert threading.active_count() == threads
    assert not any("drive --node-id" in line for line in processes_of(private_folders).values())
    with pytest.raises(CanopenError):
        robot.status()
    robot.shutdown()  # once more is not an error


def test_an_exception_in_the_block_stops_the_robot_and_is_not_swallowed(stage, private_folders):
    def work():
        with Robot.from_config("robby", can="local:raises") as robot:
            robot.command(FORWARD, [10.0, 10.0])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert not any("drive --node-id" in line for line in processes_of(private_folders).values())


def test_the_library_reports_what_is_wrong(stage):
    with pytest.raises(RobotConfigError, match="no robot 'robbie'"):
        Robot.from_config("robbie")
    with pytest.raises(RobotConfigError, match="no controller 'nobody'"):
        Robot.from_config("robby", controllers=["nobody"])
    with (
        Robot.from_config("robby", can="local:once"),
        pytest.raises(RobotConfigError, match="local:once is busy"),
        Robot.from_config("robby", can="local:once", name="again"),
    ):
        pass
