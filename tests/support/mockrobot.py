"""A robot on mock hardware in this process: real sockets and real time, no bus; for the verbs that talk to one."""

import contextlib

from support import host

from canopen_control.runtime.robot import Robot


def eventually(condition, seconds=5.0):
    """Wait for a condition of a running robot and leave it the processor; fails by itself when it does not come."""
    assert host.eventually(condition, seconds), "not within the time"


@contextlib.contextmanager
def running(name="mock", **how):
    robot = Robot.from_config("robby", mock=True, name=name, **how)
    robot.start()
    try:
        yield robot
    finally:
        robot.shutdown()
