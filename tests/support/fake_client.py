"""A robot's client without a robot, which refuses and answers what a test says."""

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.declare import Done


class FakeClient:
    """Refuses the first requests with `refusals`, answers the others by type."""

    def __init__(self, *refusals, answers=()):
        self.refusals, self.asked, self.answers = list(refusals), [], dict(answers)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def ask(self, request, timeout=None):
        self.asked.append(request)
        if self.refusals:
            raise RemoteError(*self.refusals.pop(0))
        return self.answers.get(type(request), Done())
