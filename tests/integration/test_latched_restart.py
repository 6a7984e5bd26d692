"""STOP that is latched stays latched when the robot's process ends, however it ends."""

import signal

import pytest
from support.channel import channel_of
from support.host import eventually
from support.processes import GONE_S

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.robot import AxisRequest, GetStatus


@pytest.mark.embedded
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_a_latched_robot_returns_latched_and_moves_after_release_enable_and_command(stage, end):
    robot = stage.robby("held")
    assert stage.call("stop", "--latch", "--name", "held").wait() == 0
    robot.end(end)
    stage.nobody_is_left(GONE_S)
    again = stage.start("run", "robby", "--as", "held", "--can", channel_of("held"))
    again.until("STOP is latched since an earlier run (by canopen-control stop)")
    with RobotClient.connect("held") as client:
        assert client.ask(GetStatus()).latched
        assert eventually(lambda: all(node.ready for node in client.ask(GetStatus()).nodes.values()))
        with pytest.raises(CanopenError, match="STOP is latched"):
            client.ask(AxisRequest(action="enable", node="all"))
        assert stage.call("stop", "--release", "--name", "held").wait() == 0
        assert eventually(lambda: client.ask(GetStatus()).state != "starting")
        states = [item.axes[0].state for item in client.ask(GetStatus()).nodes.values()]
        assert "OPERATION_ENABLED" not in states
        client.ask(AxisRequest(action="enable", node="all"))
    again.end()
    third = stage.robby("held")
    assert "latched" not in third.out
