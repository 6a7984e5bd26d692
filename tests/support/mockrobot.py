"""A robot on mock hardware in this process: real sockets and real time, no bus; for the verbs that talk to one."""

import contextlib

from canopen_control import Robot


@contextlib.contextmanager
def running(name="mock", **how):
    robot = Robot.from_config("robby", mock=True, name=name, **how)
    robot.start()
    try:
        yield robot
    finally:
        robot.shutdown()
