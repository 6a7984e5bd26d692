"""The connection between the page and one robot.

STOP goes out at once on the connection that is open, and never waits for an answer or behind a question. What takes
time is asked on a connection of its own, by a thread that may wait.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Final

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.robot import GetDescription, GetNodes, GetStatus, ListControllers, Stop, Subscribe
from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
from canopen_control.view.model import Welcome, read_welcome
from canopen_control.view.teleop import SOURCE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.declare import Request

__all__ = ["Link"]

_TIMEOUT_S: Final = 2.0
_ACTION_TIMEOUT_S: Final = 20.0  # of an action, such as enabling


class Link:
    """A connection to the robot `name`; `fileno` is readable when `messages` has something."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._client = RobotClient.connect(name, _TIMEOUT_S)

    def welcome(self) -> Welcome:
        """Ask for everything that stays as it is while the robot runs; waits. RemoteError when it is gone."""
        ask = self._client.ask
        return read_welcome(self.name, ask(GetDescription()), ask(GetNodes()), ask(GetStatus()))

    def subscribe(self, rate: float) -> None:
        """Ask for samples of the state, at `rate` in Hz, and for events; does not wait. RemoteError when it is gone."""
        self._client.notify(Subscribe(state_rate=rate, events=True))

    def messages(self) -> Iterator[StateSample | RobotEvent]:
        """Yield what has come, of several samples the last one; RemoteError when the robot is gone."""
        newest: StateSample | None = None
        for message in self._client.messages(0):
            if isinstance(message, StateSample):
                newest = message
            elif isinstance(message, RobotEvent):
                yield message
        if newest is not None:
            yield newest

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self._client.fileno()

    def stop(self) -> None:
        """STOP, latched; RemoteError if the robot cannot be reached."""
        self._client.notify(Stop(latch=True, source=SOURCE))

    def send(self, request: Request[Any]) -> None:
        """Send a command that nobody waits for.

        A robot that is gone is told by `messages`.
        """
        with contextlib.suppress(RemoteError):
            self._client.notify(request)

    def ask(self, request: Request[Any]) -> str | None:
        """Ask on a connection of its own; returns the reason if it was not done. From a thread that may wait."""
        try:
            with RobotClient.connect(self.name, _TIMEOUT_S) as client:
                client.ask(request, _ACTION_TIMEOUT_S)
        except CanopenError as error:
            return str(error)
        return None

    def controllers(self) -> tuple[ControllerReading, ...]:
        """Ask for the controllers, on a connection of its own; waits. CanopenError when the robot is gone."""
        with RobotClient.connect(self.name, _TIMEOUT_S) as client:
            return client.ask(ListControllers())

    def close(self) -> None:
        """Leave; a second call does nothing."""
        self._client.close()
