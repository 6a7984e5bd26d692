"""A program that is suspended, as by Ctrl-Z, while it commands a robot of the same process."""

from __future__ import annotations

import signal
import time

from canopen_control.client import RobotClient


def suspend_after(monkeypatch, kind, count, seconds=3.0, number=signal.SIGCONT):
    """Let this program stand still for `seconds` after `count` requests of `kind`, then get a signal.

    Return the list of all requests of that kind, to which later ones are added.
    """
    requested, ask = [], RobotClient.ask

    def spy(self, request, *timeout):
        answer = ask(self, request, *timeout)
        if isinstance(request, kind):
            requested.append(request)
            if len(requested) == count:
                time.sleep(seconds)
                signal.raise_signal(number)
        return answer

    monkeypatch.setattr(RobotClient, "ask", spy)
    return requested
