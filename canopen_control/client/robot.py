"""The client of the runtime's API: requests with answers, and what was subscribed to.

One connection carries both. Any number of threads may use it: whoever waits first reads the socket for all of them, and
hands over when it has what it wanted. Nothing here starts a thread.

Errors are RemoteError: what the robot refused has the class name of its error as `kind`; "BusClosed" means that the
robot is gone, "Timeout" that it did not answer in time, "RemoteProtocolError" that it talks another language.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import check_name, list_sockets, socket_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import TracebackType

    from canopen_control.host.lines import Message

__all__ = ["PROTOCOL", "RobotClient", "find_robots", "select_robot"]

PROTOCOL: Final = 1
_KEPT_MESSAGES: Final = 10_000  # of what was subscribed to and nobody has fetched


def find_robots() -> list[str]:
    """Return the names of this user's running robots, sorted."""
    return list_sockets("robot")


def select_robot(name: str | None = None) -> str:
    """Return the robot that is meant: `name`, or without one the only robot there is; ConfigError otherwise."""
    running = find_robots()
    if name is not None:
        if check_name(name) in running:
            return name
        raise ConfigError(f"no robot {name!r} is running" + (f"; running: {', '.join(running)}" if running else ""))
    if not running:
        raise ConfigError("no robot is running; start one: canopen-control run robby")
    if len(running) > 1:
        raise ConfigError(f"several robots are running: {', '.join(running)}; choose one with --name")
    return running[0]


class RobotClient:
    """A connection to a running robot.

    `robot` is its name, `hello` what it said of itself, `timeout` the seconds that a request may take, `dropped` the
    number of subscribed messages that nobody fetched in time.
    """

    def __init__(self, stream: LineClient, timeout: float = 10.0) -> None:
        self.timeout = timeout
        self.dropped = 0
        self._stream = stream
        self._changed = threading.Condition()
        self._sending = threading.Lock()
        self._reading = False  # one of the threads is in `receive`
        self._closed = False
        self._failure: RemoteError | None = None
        self._request_id = 0
        self._awaited: dict[int, Message | None] = {}
        self._messages: deque[Message] = deque()
        self.hello: Message = self._read_hello()
        self.robot = str(self.hello.get("robot", ""))

    @classmethod
    def connect(cls, name: str | None = None, timeout: float = 10.0) -> RobotClient:
        """Connect to the robot `name`, or to the only one; ConfigError when there is none or a choice."""
        robot = select_robot(name)
        stream = LineClient(socket_path("robot", robot), timeout, label=f"robot {robot}")
        try:
            return cls(stream, timeout)
        except BaseException:
            stream.close()
            raise

    def __enter__(self) -> RobotClient:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.close()

    def fileno(self) -> int:
        """Return the descriptor; when it is readable, `messages(0)` takes what has come."""
        return self._stream.fileno()

    def call(self, method: str, /, **params: object) -> Any:  # noqa: ANN401 - what JSON holds
        """Ask for `method` and return its result; waits up to `timeout`. RemoteError when the robot refuses."""
        return self.request(method, params)

    def request(self, method: str, params: Message, timeout: float | None = None) -> Any:  # noqa: ANN401 - as above
        """Do what `call` does, with the parameters in a dict and a timeout in seconds of its own."""
        seconds = self.timeout if timeout is None else timeout
        with self._changed:
            self._request_id += 1
            number = self._request_id
            self._awaited[number] = None
        try:
            self._send({"id": number, "method": method, "params": params})
            if not self._wait(lambda: self._awaited[number] is not None, seconds):
                raise RemoteError("Timeout", f"{self._stream.label} has not answered {method!r} within {seconds:g} s")
            return _result_of(self._awaited[number] or {})
        finally:
            del self._awaited[number]  # an answer that comes later is nobody's

    def notify(self, method: str, /, **params: object) -> None:
        """Ask for `method` and do not wait; the robot answers nothing, not even a refusal."""
        self._send({"method": method, "params": params})

    def messages(self, timeout: float | None = None) -> Iterator[Message]:
        """Yield what was subscribed to, as it comes, until nothing has come for `timeout` seconds (None: for ever).

        `messages(0)` yields what is here already. RemoteError when the robot is gone.
        """
        while self._wait(lambda: bool(self._messages), timeout):
            try:
                message = self._messages.popleft()
            except IndexError:  # another thread has fetched it
                continue
            yield message

    def close(self) -> None:
        """Close the connection, also under a waiting thread; a second close is a no-op."""
        with self._changed:
            self._closed = True
            self._failure = self._failure or RemoteError(
                "BusClosed", f"the connection to {self._stream.label} is closed"
            )
            self._stream.hang_up()
            self._changed.wait_for(lambda: not self._reading, 1.0)
            self._stream.close()

    def _send(self, message: Message) -> None:
        with self._sending:
            self._stream.send(message, self.timeout)

    def _read_hello(self) -> Message:
        first = self._stream.receive(self.timeout)
        if first is None:
            raise RemoteError("Timeout", f"{self._stream.label} does not answer; does it hang?")
        _raise_error(first)
        hello = first.get("hello")
        if not isinstance(hello, dict) or hello.get("protocol") != PROTOCOL:
            spoken = hello.get("protocol") if isinstance(hello, dict) else None
            raise RemoteError(
                "RemoteProtocolError",
                f"{self._stream.label} speaks protocol {spoken}, this client {PROTOCOL}; use the same version for both",
            )
        return hello

    def _wait(self, ready: Callable[[], bool], timeout: float | None) -> bool:
        """Read, or let another thread read, until `ready`; False when the time is over. Looks at least once."""
        deadline = None if timeout is None else time.monotonic() + timeout
        last_look = False
        with self._changed:
            while not ready():
                if self._failure is not None:
                    raise RemoteError(self._failure.kind, str(self._failure))  # one for each thread that learns it
                if last_look:
                    return False
                left = None if deadline is None else max(deadline - time.monotonic(), 0)
                last_look = left == 0
                if self._reading:
                    self._changed.wait(left)
                else:
                    self._read(left)
        return True

    def _read(self, timeout: float | None) -> None:
        """Read one message without holding the lock, then sort it in."""
        self._reading = True
        self._changed.release()
        message, failure = None, None
        try:
            message = self._stream.receive(timeout)
        except RemoteError as error:
            failure = error
        finally:
            self._changed.acquire()
            self._reading = False
            self._changed.notify_all()  # also for those who only waited for somebody to read
        self._failure = self._failure or failure
        if message is not None:
            self._sort_in(message)

    def _sort_in(self, message: Message) -> None:
        number = message.get("id")
        if number is not None:
            if number in self._awaited:
                self._awaited[number] = message
        elif "error" in message:
            self._failure = _error_of(message)  # the robot ends the connection after this
        else:
            self._messages.append(message)
            if len(self._messages) > _KEPT_MESSAGES:
                self._messages.popleft()
                self.dropped += 1


def _result_of(answer: Message) -> Any:  # noqa: ANN401 - what JSON holds
    _raise_error(answer)
    return answer.get("result")


def _raise_error(answer: Message) -> None:
    if answer.get("error") is not None:
        raise _error_of(answer)


def _error_of(answer: Message) -> RemoteError:
    error = answer["error"]
    if not isinstance(error, dict):
        return RemoteError("RemoteError", str(error))
    return RemoteError(str(error.get("kind", "RemoteError")), str(error.get("message", "refused without a reason")))
