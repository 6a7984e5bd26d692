"""A robot on mock hardware in this process: real sockets, no bus; for the verbs and screens that talk to one."""

import contextlib

from support.lockstep import lockstep

from canopen_control import Robot


@contextlib.contextmanager
def running(name="mock", *, real_time=False, **how):
    """Run it in virtual time, as verbs can; screens with threads of their own need `real_time`."""
    with contextlib.nullcontext() if real_time else lockstep():
        robot = Robot.from_config("robby", mock=True, name=name, **how)
        robot.start()
        try:
            yield robot
        finally:
            robot.shutdown()
