"""`EventStream`: what a robot tells from now on, one event after the other, on a connection of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import Subscribe
from canopen_control.rpc.messages.state import RobotEvent

if TYPE_CHECKING:
    from types import TracebackType

    from canopen_control.client.robot import RobotClient

__all__ = ["EventStream"]

_ENDED: Final = "stopped"  # the last event of a robot that was ended


class EventStream:
    """Iterates over events until none has come for `timeout` seconds (None: for ever), or the robot was ended.

    RemoteError when the robot has died instead. It closes itself at its end; who leaves earlier calls `close`, or
    uses it in a `with` block.
    """

    def __init__(self, client: RobotClient, timeout: float | None = None) -> None:
        self._client = client
        self._messages = client.messages(timeout)
        self._over = False
        client.ask(Subscribe(events=True))

    def __enter__(self) -> EventStream:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def __iter__(self) -> EventStream:
        return self

    def __next__(self) -> RobotEvent:
        """Wait for the next event."""
        if self._over:
            raise StopIteration
        try:
            for message in self._messages:
                if isinstance(message, RobotEvent):
                    self._over = message.kind == _ENDED
                    return message
        except RemoteError:
            self.close()
            raise
        self.close()
        raise StopIteration

    def close(self) -> None:
        """End it; a second call does nothing."""
        self._over = True
        self._client.close()
