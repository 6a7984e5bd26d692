"""Join a `local:` bus with python-can, like its logger, its viewer and programs built on it."""

import can

from canopen_control import Robot

with (
    Robot.from_config("robby", can="local:python_can"),
    can.Bus(interface="canopen_control", channel="python_can", label="my listener") as bus,
):
    for _ in range(5):
        message = bus.recv(timeout=1.0)
        if message is not None:
            print(f"{message.arbitration_id:03X} {message.data.hex(' ')}")
