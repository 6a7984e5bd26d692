"""A robot on mock hardware in this process: real sockets and real time, no bus; for the verbs that talk to one."""

import contextlib
import time

from canopen_control.runtime.robot import Robot


def eventually(condition, seconds=5.0):
    """Wait for a condition of a running robot; a bounded wait, no guess at how long it takes."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "not within the time"


@contextlib.contextmanager
def running(name="mock", **how):
    robot = Robot.from_config("robby", mock=True, name=name, **how)
    robot.start()
    try:
        yield robot
    finally:
        robot.shutdown()
