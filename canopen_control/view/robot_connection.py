"""The connection between the page and one robot.

STOP goes out at once on the connection that is open, and never waits for an answer or behind a question. What takes
time is asked on a connection of its own, by a thread that may wait.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.robot import GetDescription, GetNodes, GetStatus, ListControllers, Stop, Subscribe
from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
from canopen_control.view.dead_man import SOURCE
from canopen_control.view.robot_info import RobotInfo, read_robot_info

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.rpc.messages.declare import Request

__all__ = ["RobotConnection", "in_thread"]

_TIMEOUT_S: Final = 2.0
_ACTION_TIMEOUT_S: Final = 20.0  # of an action, such as enabling


class RobotConnection:
    """A connection to the robot `name`; `fileno` is readable when `messages` has something."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._client = RobotClient.connect(name, _TIMEOUT_S)

    def robot_info(self) -> RobotInfo:
        """Ask for everything that stays as it is while the robot runs; waits. RemoteError when it is gone."""
        ask = self._client.ask
        return read_robot_info(self.name, ask(GetDescription()), ask(GetNodes()), ask(GetStatus()))

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


T = TypeVar("T")


async def in_thread(function: Callable[[], T]) -> T:
    """Return what `function` returns, or raise what it raises.

    The loop's own executor is waited for when a program ends; a robot or a drive that hangs would hold that up.
    """
    loop = asyncio.get_running_loop()
    future: asyncio.Future[T] = loop.create_future()

    def tell(result: T | None, error: BaseException | None) -> None:
        if future.done():
            return
        if error is not None:
            future.set_exception(error)
        else:
            future.set_result(result)  # type: ignore[arg-type] # a T where there was no error

    def work() -> None:
        result, error = None, None
        try:
            result = function()
        except Exception as raised:  # noqa: BLE001 - handed on
            error = raised
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(tell, result, error)

    threading.Thread(target=work, name="page", daemon=True).start()
    return await future
