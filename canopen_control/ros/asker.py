"""Requests to the robot that nobody waits for: the answer comes to a function, on the reactor's thread.

The law of the file: any number of requests are on their way at once, so that a stop never waits behind something slow;
each gets one answer, be it an error: refused, too late, or the robot is gone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import CanopenError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import socket_path

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.host.reactor import Reactor, Timer

    #: the result and None, or None and why there is none
    Answer = Callable[[Any, str | None], object]

__all__ = ["Asker"]

_TIMEOUT_NS: Final = 30_000_000_000  # longer than anything the robot may take by itself
_SEND_S: Final = 1.0


class Asker:
    """A connection to the API of a robot; RemoteError when there is none. Everything on the reactor's thread."""

    def __init__(self, robot: str, reactor: Reactor, timeout_ns: int = _TIMEOUT_NS) -> None:
        self._reactor, self._timeout_ns = reactor, timeout_ns
        self._stream = LineClient(socket_path("robot", robot), label=f"robot {robot}")
        self._number = 0
        self._waiting: dict[int, tuple[Answer, Timer]] = {}
        self._gone: str | None = None
        reactor.add_reader(self._stream.fileno(), self._on_readable)

    def ask(self, method: str, params: dict[str, Any], answer: Answer) -> None:
        """Ask, and have `answer(result, error)` called once."""
        if self._gone is not None:
            answer(None, self._gone)
            return
        self._number += 1
        number = self._number
        timer = self._reactor.call_later(
            self._timeout_ns, lambda: self._settle(number, None, "the robot has not answered")
        )
        self._waiting[number] = (answer, timer)
        try:
            self._stream.send({"id": number, "method": method, "params": params}, _SEND_S)
        except RemoteError as error:
            self._leave(str(error))
        except CanopenError as error:
            self._settle(number, None, str(error))

    def close(self) -> None:
        """Leave; who still waits is told. A second call does nothing."""
        self._leave("the bridge has left the robot")

    def _on_readable(self) -> None:
        try:
            while self._gone is None and (message := self._stream.receive(0)) is not None:
                self._on_message(message)
        except RemoteError as error:
            self._leave(str(error))

    def _on_message(self, message: dict[str, Any]) -> None:
        number = message.get("id")
        if isinstance(number, int):
            error = message.get("error")
            self._settle(number, message.get("result"), None if error is None else str(error.get("message", error)))

    def _settle(self, number: int, result: object, error: str | None) -> None:
        answer, timer = self._waiting.pop(number, (None, None))
        if answer is not None and timer is not None:
            timer.cancel()
            answer(result, error)

    def _leave(self, why: str) -> None:
        if self._gone is None:
            self._gone = why
            self._reactor.remove_reader(self._stream.fileno())
            self._stream.close()
            for number in list(self._waiting):
                self._settle(number, None, why)
