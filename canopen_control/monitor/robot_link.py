"""A connection to a running robot that comes back: its newest state and what happened, fetched by a thread of its own.

The law of the file: nobody who draws ever waits for the robot. Whatever fails is kept as a sentence, and it is tried
again once a second; the robot that was found first is the one that is looked for later.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Final, TypeVar

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.robot import ROBOT, GetLayout, GetNodes, GetStatus, Subscribe
from canopen_control.rpc.messages.state import RobotEvent, StateSample

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.layout import BusLayout
    from canopen_control.rpc.messages.robot import NodePlace

__all__ = ["RobotLink"]

A = TypeVar("A")
RATE: Final = 5.0  # Hz
AGAIN_S: Final = 1.0
_TIMEOUT_S: Final = 2.0  # of what the robot answers at once
_SILENCE_S: Final = 1.0  # without a sample: it hangs, or its machine does
_KEPT_EVENTS: Final = 1000
_REPEATED: Final = 200  # newest events that are looked through, so that none is told twice


class RobotLink:
    """The robot `name`, or the only one; `start` and `close` it. `why` says what keeps it from the robot, or is "".

    `on_sample` is called on the connection's thread when a sample has come.
    """

    def __init__(self, name: str | None = None) -> None:
        self.name = name
        self.why = "not connected yet"
        self.layouts: Mapping[str, BusLayout] = {}
        self.places: Mapping[str, NodePlace] = {}
        self.state: StateSample | None = None
        self.on_sample: Callable[[], None] = lambda: None
        self._events: deque[RobotEvent] = deque(maxlen=_KEPT_EVENTS)
        self._told: deque[RobotEvent] = deque(maxlen=_REPEATED)
        self._heard = 0.0
        self._robot: RobotClient | None = None
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="robot link", daemon=True)

    def start(self) -> None:
        """Begin to look for the robot."""
        self._thread.start()

    def close(self) -> None:
        """Leave it."""
        self._closed.set()
        robot = self._robot
        if robot is not None:
            robot.close()
        if self._thread.is_alive():
            self._thread.join(AGAIN_S)

    @property
    def connected(self) -> bool:
        """Whether the state is that of now."""
        return self.state is not None and time.monotonic() - self._heard < _SILENCE_S

    def events(self) -> list[RobotEvent]:
        """Return what happened since the last call."""
        found = []
        while self._events:
            found.append(self._events.popleft())
        return found

    def ask(self, request: Request[A], timeout: float) -> A:
        """Ask the robot and wait up to `timeout` seconds; RemoteError. For threads that may wait."""
        robot = self._robot
        if robot is None:
            raise RemoteError("BusClosed", f"{ROBOT.of(type(request)).name} does not reach the robot: {self.why}")
        return robot.ask(request, timeout)

    def _run(self) -> None:
        while not self._closed.is_set():
            try:
                with RobotClient.connect(self.name, timeout=_TIMEOUT_S) as robot:
                    self._begin(robot)
                    self._follow(robot)
            except CanopenError as error:
                self.why = str(error)
            self._robot, self.state = None, None
            self._closed.wait(AGAIN_S)

    def _begin(self, robot: RobotClient) -> None:
        self.name = robot.robot
        robot.ask(Subscribe(state_rate=RATE, events=True))
        self.layouts = robot.ask(GetLayout()).buses
        self.places = {place.name: place for place in robot.ask(GetNodes()).nodes}
        for event in robot.ask(GetStatus()).events:
            self._keep(event)
        self._robot, self.why = robot, ""

    def _follow(self, robot: RobotClient) -> None:
        while not self._closed.is_set():
            for message in robot.messages(_SILENCE_S):
                if isinstance(message, RobotEvent):
                    self._keep(message)
                elif isinstance(message, StateSample):
                    self.state, self._heard, self.why = message, time.monotonic(), ""
                    self.on_sample()
            self.why = f"robot {self.name} has been silent for more than {_SILENCE_S:g} s; does it hang?"

    def _keep(self, event: RobotEvent) -> None:
        """Keep an event unless it was told before: the stream repeats what the status had."""
        if event not in self._told:
            self._told.append(event)
            self._events.append(event)
