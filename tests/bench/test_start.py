"""The start bench: robots are started and ended, and what they take is told beside its limit."""

import pytest
from canopen_control_bench import start
from canopen_control_bench.clients import has_ros
from canopen_control_bench.runner import Options
from canopen_control_bench.stage import stage

from canopen_control.host.sockets import list_sockets

pytestmark = pytest.mark.process


def test_a_robot_is_started_and_gone_again():
    with stage() as played:
        assert 0.1 < start.until_commanded(played, "started") < 20
        assert list_sockets("robot") == []


def test_without_ros_that_alone_is_measured(monkeypatch):
    seconds = iter([9.0, 0.5, 0.7, 0.65])  # the first one warms up
    monkeypatch.setattr(start, "until_commanded", lambda _stage, _name: next(seconds))
    monkeypatch.setattr(start, "has_ros", lambda: False)
    (figure,) = start.measure(Options(quick=True))
    assert (figure.ours, figure.limit, figure.good) == (0.65, 0.6, False)
    assert figure.absolutes == {"least s": 0.5, "most s": 0.7}


@pytest.mark.ros
@pytest.mark.skipif(not has_ros(), reason="no ROS installation")
def test_joint_states_are_heard_by_another_program():
    with stage() as played:
        listener = played.start("canopen_control_bench.peers.rclpy_topics", "listen", ros=True)
        listener.line()
        assert 0.1 < start.until_joint_states(played, "heard", listener) < 20
