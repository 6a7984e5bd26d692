"""Socket server: passes the requests of an `Api` to handlers, and pushes messages to clients.

Unknown methods, missing fields and fields of a wrong type are refused before a handler is called.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import msgspec

from canopen_control.errors import CanopenError, ControlError, LocalProtocolError
from canopen_control.host.lineserver import Connection, LineServer
from canopen_control.rpc import wire
from canopen_control.rpc.messages.declare import Api, Done, Effect, Refusal, Request

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Iterable
    from pathlib import Path

    from canopen_control.host.reactor import Reactor


A = TypeVar("A")
H = TypeVar("H")
P = TypeVar("P")
R = TypeVar("R", bound=Request[Any])
R_co = TypeVar("R_co", bound=Request[Any], covariant=True)


class Call(Generic[R_co]):
    """Request of a client; answer it with `reply`, `refuse` or `settle`. A request without an id gets no answer."""

    __slots__ = ("_number", "connection", "request")

    def __init__(self, connection: Connection, number: wire.Id, request: R_co) -> None:
        self.connection, self._number, self.request = connection, number, request

    @property
    def client(self) -> str:
        """Name and process id of the client, for events and errors."""
        return f"client {self.connection.name} (pid {self.connection.pid})"

    @property
    def holder(self) -> Connection | None:
        """Connection of a client that waits for the answer, or None."""
        return None if self._number is None else self.connection

    def sender(self, source: str | None) -> str:
        """Return the name and process id of a command's sender; `source` is the name given in the request, or None."""
        return f"{source} (pid {self.connection.pid})" if source else self.client

    def reply(self: Call[Request[A]], answer: A) -> None:
        """Answer the request with a result of the declared type."""
        if self._number is not None:
            self.connection.answer(wire.answer_line(self._number, answer))

    def refuse(self, error: CanopenError) -> None:
        """Answer the request with an error."""
        if self._number is not None:
            self.connection.answer(wire.error_line(self._number, type(error).__name__, str(error)))

    def settle(self: Call[Request[Done]], error: str | None) -> None:
        """Answer an executed request: with Done if `error` is None, else with a ControlError."""
        if error is None:
            self.reply(Done())
        else:
            self.refuse(ControlError(error))


class ServerObserver(Protocol):
    """Observer of a server's accepted requests, except read-only ones."""

    def done(self, method: str, params: msgspec.Raw) -> None:
        """Handle an accepted request; `params` are the undecoded parameters."""


class Server(Generic[H, P]):
    """Server of an `Api` on a Unix socket in a reactor; `hello()` returns the greeting.

    `may_idle(connection)` returns whether a connection may stay open while it is idle; `listener` is a socket that is
    already listening. `observer` receives the method and the parameters of each accepted request, except read-only
    ones. Raise SocketInUse if another process serves the path.
    """

    def __init__(
        self,
        api: Api[H, P],
        reactor: Reactor,
        path: Path,
        hello: Callable[[], H],
        *,
        on_close: Callable[[Connection], object] = lambda _connection: None,
        may_idle: Callable[[Connection], bool] = lambda _connection: False,
        listener: socket.socket | None = None,
    ) -> None:
        self._api, self._hello = api, hello
        self.observer: ServerObserver | None = None
        self._handlers: dict[str, tuple[msgspec.json.Decoder[Any], Callable[[Call[Any]], object]]] = {}
        self._server = LineServer(
            reactor,
            path,
            self._greet,
            self._on_line,
            on_close,
            error_line=_error_line,
            may_idle=may_idle,
            listener=listener,
        )

    def register(self, kind: type[R], handler: Callable[[Call[R]], object]) -> None:
        """Register the handler for a request type; a CanopenError raised by the handler becomes the reply."""
        self._handlers[self._api.of(kind).name] = (msgspec.json.Decoder(kind), handler)

    def check(self) -> None:
        """Raise LookupError if a declared method has no handler."""
        missing = [name for name in self._api.methods if name not in self._handlers]
        if missing:
            raise LookupError(f"no handler answers {', '.join(missing)} of the {self._api.name} socket")

    @property
    def connections(self) -> list[Connection]:
        """Open connections, except those being closed."""
        return self._server.connections

    def line_of(self, push: P) -> bytes:
        """Encode a pushed message as a line for `Connection.send`."""
        return wire.push_line(self._api.key_of(type(push)), push)

    def push(self, push: P, to: Iterable[Connection] | None = None) -> None:
        """Send a message to the connections `to` (None: all connections)."""
        line = self.line_of(push)
        for connection in self.connections if to is None else to:
            connection.send(line)

    def close(self) -> None:
        """Close all connections and remove the socket."""
        self._server.close()

    def _greet(self, connection: Connection) -> None:
        connection.send(wire.push_line("hello", self._hello()))

    def _on_line(self, connection: Connection, line: bytes) -> None:
        try:
            incoming = wire.read_request(line)
        except ValueError as error:
            connection.refuse("RemoteProtocolError", f"not a JSON object on a line: {error}")
            return
        if incoming.number is not None:
            connection.expect_answer()
        self._handle(connection, incoming)

    def _handle(self, connection: Connection, incoming: wire.Incoming) -> None:
        call: Call[Any] = Call(connection, incoming.number, None)  # `request` is set below, when it is decoded
        name = incoming.method
        try:
            if name not in self._handlers:
                raise LocalProtocolError(f"no method {name!r}; available: {', '.join(self._handlers)}")
            decoder, handler = self._handlers[name]
            call.request = decoder.decode(incoming.params)
            handler(call)
            if self.observer is not None and self._api.methods[name].effect is not Effect.READS:
                self.observer.done(name, incoming.params)
        except CanopenError as error:
            call.refuse(error)
        except (msgspec.DecodeError, ValueError, OverflowError, RecursionError) as error:
            call.refuse(LocalProtocolError(f"{name}: {wire.mistake(error)}"))


def _error_line(kind: str, message: str) -> bytes:
    return wire.push_line("error", Refusal(kind, message))
