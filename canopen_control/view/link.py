"""The connection between the page and one robot.

The law of this file: STOP goes out at once on the connection that is open, from any thread, and never waits for an
answer or behind a question. What takes time is asked on a connection of its own, by a thread that may wait.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["SOURCE", "Link", "Welcome"]

Message = dict[str, Any]
SOURCE: Final = "view"
_TIMEOUT_S: Final = 2.0
_PATIENCE_S: Final = 20.0  # of an action, such as enabling


@dataclass(frozen=True, slots=True)
class Welcome:
    """What a robot says of itself when one comes: its URDF and where that is from, its nodes, and its state so far."""

    robot: str
    urdf: str
    path: str
    nodes: Message
    status: Message


class Link:
    """A connection to the robot `name`; `fileno` is readable when `messages` has something."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._client = RobotClient.connect(name, _TIMEOUT_S)

    def welcome(self) -> Welcome:
        """Ask for everything that stays as it is while the robot runs; RemoteError when it is gone."""
        call = self._client.call
        description = call("description")
        return Welcome(self.name, description["urdf"], str(description.get("path", "")), call("nodes"), call("status"))

    def subscribe(self, rate: float) -> None:
        """Ask for samples of the state, at `rate` in Hz, and for events."""
        self._client.call("subscribe", state_rate=rate, events=True)

    def controllers(self) -> list[Message]:
        """Return what the runtime tells of its controllers."""
        found: list[Message] = self._client.call("controllers")
        return found

    def messages(self) -> Iterator[Message]:
        """Yield what has come; RemoteError when the robot is gone."""
        return self._client.messages(0)

    def fileno(self) -> int:
        """Return the descriptor to watch."""
        return self._client.fileno()

    def stop(self) -> None:
        """STOP, latched; RemoteError if the robot cannot be reached. From any thread."""
        self._client.notify("stop", latch=True, source=SOURCE)

    def send(self, method: str, params: Message) -> None:
        """Send a command that nobody waits for; the robot forgets it when this process dies.

        A robot that is gone is told by `messages`.
        """
        with contextlib.suppress(RemoteError):
            self._client.notify(method, source=SOURCE, dead_man=True, **params)

    def ask(self, method: str, params: Message) -> str | None:
        """Ask on a connection of its own; returns the reason if it was not done. From a thread that may wait."""
        try:
            with RobotClient.connect(self.name, _TIMEOUT_S) as client:
                client.request(method, {"source": SOURCE, **params}, _PATIENCE_S)
        except CanopenError as error:
            return str(error)
        return None

    def close(self) -> None:
        """Leave; a second call does nothing."""
        self._client.close()
