"""Clients of a socket, blocking or on a reactor: requests with typed replies, and pushed messages.

One connection carries both requests and pushed messages. Any number of threads may use a `Client`: one waiting thread
reads the socket for all waiting threads. No thread is started.

Errors are raised as RemoteError: `kind` is the class name of the server's error; "BusClosed" means that the connection
is closed, "Timeout" that the server has not answered in time, "RemoteProtocolError" that the server uses another
protocol version or sent invalid data.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar, cast

from canopen_control.errors import CanopenError, RemoteError, UnreadableMessage
from canopen_control.host.lineclient import LineClient
from canopen_control.rpc import wire
from canopen_control.rpc.messages.declare import PROTOCOL, Api, Refusal, Request

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from types import TracebackType
    from typing import Self

    from canopen_control.host.reactor import Reactor
    from canopen_control.host.timer import Timer


A = TypeVar("A")
H = TypeVar("H")
P = TypeVar("P")
Line = dict[str, wire.Raw]
_MAX_PUSHED: Final = 10_000  # pushed messages that are kept until they are fetched


def read_error(raw: wire.Raw) -> RemoteError:
    """Return the error of a refused request; if it cannot be decoded, the raw text becomes the message."""
    try:
        refusal: Refusal = wire.decode(raw, Refusal)
    except ValueError:
        return RemoteError("RemoteError", bytes(raw).decode(errors="replace"))
    return RemoteError(refusal.kind, refusal.message)


def read_hello(api: Api[H, P], line: Line, label: str) -> H:
    """Return the server's greeting in a line; raise RemoteError for an error line or a different protocol version."""
    if "error" in line:
        raise read_error(line["error"])
    hello = wire.decode(line.get("hello", wire.Raw(b"null")), Any)
    spoken = hello.get("protocol") if isinstance(hello, dict) else None
    if spoken != PROTOCOL:
        sentence = f"{label} speaks protocol {spoken}, this client {PROTOCOL}; use the same version for both"
        raise RemoteError("RemoteProtocolError", sentence)
    try:
        return cast("H", wire.decode(line["hello"], api.hello))
    except ValueError as error:
        raise RemoteError("RemoteProtocolError", f"{label} sent an unexpected greeting: {error}") from None


class Client(Generic[H, P]):
    """Blocking connection to the server of an `Api`; `stream` is closed if the greeting is invalid.

    `hello` is the server's greeting, `timeout` the default timeout of a request in s, `dropped` the number of pushed
    messages that were dropped because they were not fetched in time.
    """

    def __init__(self, api: Api[H, P], stream: LineClient, timeout: float = 10.0) -> None:
        self.timeout = timeout
        self.dropped = 0
        self.api, self._stream = api, stream
        self._changed = threading.Condition()
        self._sending = threading.Lock()
        self._reading = False  # a thread is in `receive`
        self._failure: RemoteError | None = None
        self._last_number = 0
        self._awaited: dict[int, Line | None] = {}
        self._pushed: deque[Line] = deque()
        try:
            self.hello = self._read_hello()
        except BaseException:
            stream.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def fileno(self) -> int:
        """Return the file descriptor of the socket, which becomes readable when a message arrives."""
        return self._stream.fileno()

    def ask(self, request: Request[A], timeout: float | None = None) -> A:
        """Send a request and return the reply.

        Raise RemoteError if it is refused, or not answered within `timeout` s.
        """
        method = self.api.of(type(request))
        answer = self._exchange(method.name, request, self.timeout if timeout is None else timeout)
        if "error" in answer:
            raise read_error(answer["error"])
        return cast("A", self._decoded(answer.get("result", wire.Raw(b"null")), method.answer))

    def notify(self, request: Request[Any]) -> None:
        """Send a request that the server does not answer, even if it refuses the request."""
        self._send(wire.request_line(None, self.api.of(type(request)).name, request))

    def messages(self, timeout: float | None = None) -> Iterator[P]:
        """Yield pushed messages until none is received for `timeout` s (None: no timeout).

        `messages(0)` yields the messages that have been received already. Raise RemoteError if the connection is lost;
        raise UnreadableMessage for a message that cannot be decoded, after which the iteration can be restarted.
        """
        while self._wait(lambda: bool(self._pushed), timeout):
            try:
                line = self._pushed.popleft()
            except IndexError:  # another thread has fetched the message
                continue
            for key, kind in self.api.pushes.items():
                if key in line:
                    yield self._pushed_message(line[key], kind)

    def close(self) -> None:
        """Close the connection, even while a thread waits for a reply."""
        with self._changed:
            self._failure = self._failure or RemoteError(
                "BusClosed", f"the connection to {self._stream.label} is closed"
            )
            self._stream.hang_up()
            self._changed.wait_for(lambda: not self._reading, 1.0)
            self._stream.close()

    def _exchange(self, method: str, params: object, seconds: float) -> Line:
        with self._changed:
            self._last_number += 1
            number = self._last_number
            self._awaited[number] = None
        try:
            self._send(wire.request_line(number, method, params))
            if not self._wait(lambda: self._awaited[number] is not None, seconds):
                raise RemoteError("Timeout", f"{self._stream.label} has not answered {method!r} within {seconds:g} s")
            return self._awaited[number] or {}
        finally:
            del self._awaited[number]  # a later answer is ignored

    def _pushed_message(self, raw: wire.Raw, kind: Any) -> P:  # noqa: ANN401 - one of the types in P
        try:
            return cast("P", wire.decode(raw, kind))
        except ValueError as error:
            raise UnreadableMessage(f"{self._stream.label} sent an invalid message: {error}") from None

    def _decoded(self, raw: wire.Raw, kind: Any) -> Any:  # noqa: ANN401 - the type that `kind` names
        try:
            return wire.decode(raw, kind)
        except ValueError as error:
            raise RemoteError("RemoteProtocolError", f"{self._stream.label} sent an invalid message: {error}") from None

    def _send(self, line: bytes) -> None:
        with self._sending:
            self._stream.send(line, self.timeout)

    def _receive(self, timeout: float | None) -> Line | None:
        line = self._stream.receive(timeout)
        try:
            return None if line is None else wire.read_line(line)
        except ValueError as error:
            raise RemoteError("RemoteProtocolError", f"{self._stream.label} sent an invalid message: {error}") from None

    def _read_hello(self) -> H:
        first = self._receive(self.timeout)
        if first is None:
            raise RemoteError("Timeout", f"{self._stream.label} does not answer; its process may be stopped or blocked")
        return read_hello(self.api, first, self._stream.label)

    def _wait(self, ready: Callable[[], bool], timeout: float | None) -> bool:
        """Read, or wait while another thread reads, until `ready()` is true; return False on a timeout.

        The condition is checked at least once.
        """
        deadline = None if timeout is None else time.monotonic() + timeout
        last_look = False
        with self._changed:
            while not ready():
                if self._failure is not None:
                    raise RemoteError(self._failure.kind, str(self._failure))  # a new exception for each thread
                if last_look:
                    return False
                remaining = None if deadline is None else max(deadline - time.monotonic(), 0)
                last_look = remaining == 0
                if self._reading:
                    self._changed.wait(remaining)
                else:
                    self._read(remaining)
        return True

    def _read(self, timeout: float | None) -> None:
        """Read one message with the lock released, then store it for the waiting thread."""
        self._reading = True
        self._changed.release()
        line, failure = None, None
        try:
            line = self._receive(timeout)
        except RemoteError as error:
            failure = error
        finally:
            self._changed.acquire()
            self._reading = False
            self._changed.notify_all()  # also for callers that waited for another reading thread
        self._failure = self._failure or failure
        if line is not None:
            self._sort_in(line)

    def _sort_in(self, line: Line) -> None:
        if "id" in line:
            number = wire.decode(line["id"], Any)
            if number in self._awaited:
                self._awaited[number] = line
        elif "error" in line:
            self._failure = read_error(line["error"])  # the server closes the connection after this message
        else:
            self._pushed.append(line)
            if len(self._pushed) > _MAX_PUSHED:
                self._pushed.popleft()
                self.dropped += 1


# Client of a socket on a reactor: no call blocks, and answers are passed to functions on the reactor's thread.
#
# Any number of requests may be pending, so that a stop never waits for a slow request; every request gets one answer,
# or an error if it was refused, timed out, or the connection is lost.


ENDLESS: Final = 0
"""Timeout of a request that may be answered at any time."""

_TIMEOUT_NS: Final = 30_000_000_000  # longer than any request takes in the robot
_SEND_S: Final = 1.0
_GARBAGE: Final = "the answer cannot be read: "


class ReactorClient:
    """Non-blocking connection to the server of an `Api` on a reactor; raise RemoteError if no server is running.

    All methods must be called on the reactor's thread.
    """

    def __init__(
        self, api: Api[Any, Any], path: Path, reactor: Reactor, *, label: str = "", timeout_ns: int = _TIMEOUT_NS
    ) -> None:
        self._api, self._reactor, self._timeout_ns = api, reactor, timeout_ns
        self._stream = LineClient(path, label=label)
        self._number = 0
        self._waiting: dict[int, tuple[Any, Callable[[Any, str | None], object], Timer | None]] = {}
        self._closed_reason: str | None = None
        self._repetition: Timer | None = None
        reactor.add_reader(self._stream.fileno(), self._on_readable)

    def ask(
        self,
        request: Request[A],
        answer: Callable[[A | None, str | None], object],
        timeout_ns: int | None = None,
    ) -> None:
        """Send a request; `answer(result, None)` or `answer(None, reason)` is called once, later.

        After `timeout_ns` (None: the default; `ENDLESS`: no timeout) the answer is an error.
        """
        if self._closed_reason is not None:
            answer(None, self._closed_reason)
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

    def send_periodically(self, request: Request[Any], every_ns: int) -> None:
        """Send a request every `every_ns`, without a reply, until the connection is closed."""
        if self._closed_reason is not None:
            return
        self._repetition = self._reactor.call_later(every_ns, lambda: self.send_periodically(request, every_ns))
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
        """Close the connection; pending requests are answered with an error."""
        self._leave(f"the connection to {self._stream.label} was closed")

    def _on_readable(self) -> None:
        try:
            while self._closed_reason is None and (line := self._stream.receive(0)) is not None:
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
        if self._closed_reason is None:
            self._closed_reason = why
            if self._repetition is not None:
                self._repetition.cancel()
            self._reactor.remove_reader(self._stream.fileno())
            self._stream.close()
            for number in list(self._waiting):
                self._settle(number, error=why)
