"""Sources of commands in a campaign: a client that stays connected, a shell, a ROS publisher, or a one-shot request.

Each tells the observer what it asked for, when it was answered, and when its connection had ended; nothing more.
"""

from __future__ import annotations

import math
import signal
import threading
import time
from typing import TYPE_CHECKING, Final, TypeVar

from campaigner.observer import Command, Enable
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.robot import AxisRequest, CommandController

if TYPE_CHECKING:
    from collections.abc import Callable

    from campaigner.listen import Listener
    from campaigner.processes import Program
    from canopen_control.rpc.messages.declare import Request


A = TypeVar("A")
CONTROLLER: Final = "robby_forward_controller"
LIFE_S: Final = 2.0  # command_timeout of robby, which is also the default
_PERIOD_S: Final = 0.1
_LOOK_S: Final = 0.05
_TIMEOUT_S: Final = 5.0


def ask(robot: str, request: Request[A], timeout: float = _TIMEOUT_S) -> A:
    """Send one request to the robot over a new connection."""
    with RobotClient.connect(robot, timeout) as client:
        return client.ask(request)


def enable(listener: Listener, robot: str, *, counts: bool = True) -> bool:
    """Request an enable of all drives; return whether it succeeded. Requests that must be refused do not count."""
    fact = Enable(time.monotonic())
    if counts:
        listener.add(fact)
    try:
        ask(robot, AxisRequest(action="enable", node="all"), 10.0)
    except CanopenError:
        return False
    finally:
        fact.done = time.monotonic()
    return True


def command_once(listener: Listener, robot: str, values: list[float]) -> str:
    """Send one command and disconnect; return the robot's answer."""
    finite = all(abs(value) < 1e6 for value in values)
    speed = max(map(abs, values)) if finite else math.nan
    fact = Command("one line", speed, time.monotonic(), LIFE_S)
    listener.add(fact)
    try:
        ask(robot, CommandController(controller=CONTROLLER, values=values, source="campaign once"))
    except CanopenError as error:
        fact.refused = True
        return str(error)
    finally:
        fact.done = time.monotonic()
    return "taken"


class SocketStream(threading.Thread):
    """A client that repeats a command at 10 Hz, and then disconnects, which must end its target.

    `ends`: close (the connection), zeros (and then close), silence (stays connected, says nothing more).
    """

    def __init__(self, listener: Listener, robot: str, values: list[float], seconds: float, ends: str) -> None:
        super().__init__(daemon=True)
        self._listener, self._robot, self._values, self._ends = listener, robot, values, ends
        self._until = time.monotonic() + seconds
        self.source = f"a client that ends by {ends}"
        self._fact = Command(self.source, max(map(abs, values)), math.inf, LIFE_S)

    def hurry(self) -> None:
        """End it now."""
        self._until = 0.0

    def run(self) -> None:
        """Send commands until the time is over."""
        answered = time.monotonic()
        try:
            with RobotClient.connect(self._robot, _TIMEOUT_S) as client:
                self._fact.asked = answered
                self._listener.add(self._fact)
                answered = self._stream(client, answered)
                if self._ends == "silence":
                    self._fact.done = answered
                    time.sleep(LIFE_S + 1.0)
        except CanopenError:
            pass  # no robot is running, or it has ended
        finally:
            self._fact.gone = time.monotonic()
            self._fact.done = min(self._fact.done, self._fact.gone)

    def _stream(self, client: RobotClient, answered: float) -> float:
        while time.monotonic() < self._until:
            self._send(client, self._values)
            answered = time.monotonic()
            time.sleep(_PERIOD_S)
        if self._ends == "zeros":
            zeros = Command(self.source, 0.0, time.monotonic(), LIFE_S)
            self._fact.done = zeros.asked
            self._listener.add(zeros)
            zeros.refused = not self._send(client, [0.0] * len(self._values))
            zeros.done = time.monotonic()
        return answered

    def _send(self, client: RobotClient, values: list[float]) -> bool:
        """Send a command; return whether it was accepted. A refusal does not end the stream, as with a joystick."""
        try:
            client.ask(CommandController(controller=CONTROLLER, values=values, source=self.source, dead_man=True))
        except RemoteError as error:
            if error.kind in ("BusClosed", "Timeout", "RemoteProtocolError"):
                raise
            return False
        return True


class ShellStream(threading.Thread):
    """A program that sends commands until it is ended by a signal or with its robot.

    Its connection to the robot ends with it, and so does what it commanded; unless it speaks through the ROS bridge,
    which does not know, so that its last command lives out its time.
    """

    def __init__(
        self, listener: Listener, start: Callable[[], Program], speed: float, seconds: float, ends: str, *, ros: bool
    ) -> None:
        super().__init__(daemon=True)
        self.ros = ros
        self._listener, self._start, self._speed, self._ends = listener, start, speed, ends
        self._until = time.monotonic() + seconds
        self.source = f"a {'publisher' if ros else 'program'} that ends by {ends}"
        self._fact = self._new_fact()
        self._is_back: Callable[[], bool] | None = None

    def hurry(self) -> None:
        """End it now."""
        self._until = 0.0

    def interrupt(self, is_back: Callable[[], bool]) -> None:
        """Note that its bridge has died; `is_back` tells when a new one is running."""
        self._fact.done = self._fact.gone = time.monotonic()
        self._is_back = is_back

    def run(self) -> None:
        """Run the program for its time."""
        program = self._start()
        while time.monotonic() < self._until and program.code is None:
            time.sleep(_LOOK_S)
            if self._is_back is not None and self._is_back():
                self._fact, self._is_back = self._new_fact(), None
        program.send(signal.SIGKILL if self._ends == "kill" else signal.SIGTERM)
        if program.wait(_TIMEOUT_S) is None:
            program.send(signal.SIGKILL)
            program.process.wait()
        now = time.monotonic()
        self._fact.done = min(self._fact.done, now)
        if not self.ros:
            self._fact.gone = now

    def _new_fact(self) -> Command:
        fact = Command(self.source, self._speed, time.monotonic(), LIFE_S)
        self._listener.add(fact)
        return fact
