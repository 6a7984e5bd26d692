"""A robot's client without a robot, which refuses and answers what a test says."""

from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.declare import Done


class FakeClient:
    """Refuses the first requests with `refusals`, answers the others by type."""

    robot = "robby"
    sdo_write = RobotClient.sdo_write

    def __init__(self, *refusals, answers=()):
        self.refusals, self.asked, self.answers, self.closed = list(refusals), [], dict(answers), False

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def close(self):
        self.closed = True

    def ask(self, request, timeout=None):
        self.asked.append(request)
        if self.refusals:
            raise RemoteError(*self.refusals.pop(0))
        return self.answers.get(type(request), Done())
