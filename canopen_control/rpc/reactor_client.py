"""The client of a socket in a reactor: nobody waits, the answer comes to a function on the reactor's thread.

Any number of requests are on their way at once, so that a stop never waits behind something slow; each gets one answer,
be it an error: refused, too late, or the other side is gone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.errors import CanopenError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.rpc import wire
from canopen_control.rpc.client import read_error

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.host.reactor import Reactor, Timer
    from canopen_control.rpc.messages.declare import Api, Request

__all__ = ["ENDLESS", "ReactorClient"]

ENDLESS: Final = 0
"""A time-out for what may be answered at any time."""

A = TypeVar("A")
_TIMEOUT_NS: Final = 30_000_000_000  # longer than anything the robot may take by itself
_SEND_S: Final = 1.0
_GARBAGE: Final = "the answer cannot be read: "


class ReactorClient:
    """A connection to the server of an `Api`; RemoteError when there is none. Everything on the reactor's thread."""

    def __init__(
        self, api: Api[Any, Any], path: Path, reactor: Reactor, *, label: str = "", timeout_ns: int = _TIMEOUT_NS
    ) -> None:
        self._api, self._reactor, self._timeout_ns = api, reactor, timeout_ns
        self._stream = LineClient(path, label=label)
        self._number = 0
        self._waiting: dict[int, tuple[Any, Callable[[Any, str | None], object], Timer | None]] = {}
        self._gone: str | None = None
        self._saying: Timer | None = None
        reactor.add_reader(self._stream.fileno(), self._on_readable)

    def ask(
        self,
        request: Request[A],
        answer: Callable[[A | None, str | None], object],
        timeout_ns: int | None = None,
    ) -> None:
        """Ask, and have `answer(result, None)` or `answer(None, why not)` called once, within `timeout_ns`."""
        if self._gone is not None:
            answer(None, self._gone)
            return
        self._number += 1
        number, method = self._number, self._api.of(type(request))
        self._waiting[number] = (method.answer, answer, self._timer(number, timeout_ns))
        try:
            self._stream.send(wire.request_line(number, method.name, request), _SEND_S)
        except RemoteError as error:
            self._leave(str(error))
        except CanopenError as error:
            self._settle(number, error=str(error))

    def keep_saying(self, request: Request[Any], every_ns: int) -> None:
        """Send a request that wants no answer again and again, from now on until this is left."""
        if self._gone is not None:
            return
        self._saying = self._reactor.call_later(every_ns, lambda: self.keep_saying(request, every_ns))
        try:
            self._stream.send(wire.request_line(None, self._api.of(type(request)).name, request), _SEND_S)
        except RemoteError as error:
            self._leave(str(error))

    def _timer(self, number: int, timeout_ns: int | None) -> Timer | None:
        wait_ns = self._timeout_ns if timeout_ns is None else timeout_ns
        if wait_ns == ENDLESS:
            return None
        too_late = f"{self._stream.label} has not answered"
        return self._reactor.call_later(wait_ns, lambda: self._settle(number, error=too_late))

    def close(self) -> None:
        """Leave; who still waits is told. A second call does nothing."""
        self._leave(f"{self._stream.label} was left")

    def _on_readable(self) -> None:
        try:
            while self._gone is None and (line := self._stream.receive(0)) is not None:
                self._on_line(wire.read_line(line))
        except (RemoteError, ValueError) as error:
            self._leave(str(error))

    def _on_line(self, line: dict[str, wire.Raw]) -> None:
        if "id" not in line:
            return
        number = wire.decode(line["id"], Any)
        if "error" in line:
            self._settle(number, error=str(read_error(line["error"])))
        else:
            self._settle(number, line.get("result"))

    def _settle(self, number: int, result: wire.Raw | None = None, *, error: str | None = None) -> None:
        kind, answer, timer = self._waiting.pop(number, (None, None, None))
        if answer is None:
            return
        if timer is not None:
            timer.cancel()
        try:
            read = None if result is None else wire.decode(result, kind)
        except ValueError as garbage:
            read, error = None, f"{_GARBAGE}{garbage}"
        answer(read, error)

    def _leave(self, why: str) -> None:
        if self._gone is None:
            self._gone = why
            if self._saying is not None:
                self._saying.cancel()
            self._reactor.remove_reader(self._stream.fileno())
            self._stream.close()
            for number in list(self._waiting):
                self._settle(number, error=why)
