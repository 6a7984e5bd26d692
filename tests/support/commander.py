"""A commander that never rests, as a publisher: whatever is refused, the next command is sent."""

import contextlib
import threading

from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import CommandController


class Commander(threading.Thread):
    """Commands the wheels 10 rad/s ten times a second, from its making to `end`; `sent` is how often it did."""

    def __init__(self, name):
        super().__init__(daemon=True)
        self._robot, self._ended, self.sent = RobotClient.connect(name), threading.Event(), 0
        self.start()

    def run(self):
        with contextlib.suppress(RemoteError):
            while not self._ended.wait(0.1):
                command = CommandController(controller="robby_forward_controller", values=[10, 10], source="test")
                self._robot.notify(command)
                self.sent += 1

    def has_sent(self, count):
        return self.sent >= count

    def end(self):
        self._ended.set()
        self.join()
        self._robot.close()
