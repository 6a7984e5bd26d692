"""An action server whose goals are judged by somebody else, later, and that says which client sent one.

rclpy's own answers a goal when its callback returns, and waits for the end of one in a coroutine, in which its
EventsExecutor spins without a pause. Here what comes is handed over, and what is to be answered is called in the
executor's thread, by `answer`, `finish`. Besides: who asks for the result of a goal that was refused is told why,
where rclpy's says that it knows no such goal.
"""

from __future__ import annotations

import contextlib
import importlib
from collections import OrderedDict
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.ros.participants import client_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.endpoint import RosMessage
    from canopen_control.ros.rcl import Node

__all__ = ["GoalRequest", "JudgedActionServer"]

_rclpy = importlib.import_module("rclpy.action.server")
_ActionServer: Any = _rclpy.ActionServer
_ACCEPTED: Final = 1  # action_msgs/msg/GoalStatus
_ABORTED: Final = 6
_KEPT: Final = 64
"""How many refusals are kept, for who asks."""


class GoalRequest(NamedTuple):
    """A goal that is to be judged; `client` is the DDS participant that has sent it, None where it cannot be seen."""

    uuid: bytes
    goal: RosMessage
    client: bytes | None


class JudgedActionServer(_ActionServer):  # type: ignore[misc] # rclpy's, without types
    """Serves an action; callbacks are called in the executor's thread.

    `on_goal(request)` is answered by `answer`, `on_cancel(uuid)` is followed by `finish`. `on_lost(uuid)` tells of a
    goal that was accepted whose client was gone before it could be told.
    """

    def __init__(
        self,
        node: Node,
        action: type,
        name: str,
        on_goal: Callable[[GoalRequest], object],
        on_cancel: Callable[[bytes], object],
        on_lost: Callable[[bytes], object],
    ) -> None:
        self._on_goal, self._on_lost = on_goal, on_lost
        self._taken: dict[bytes, Any] = {}
        self._accepts = False
        self._refused: OrderedDict[bytes, RosMessage] = OrderedDict()

        def cancel(handle: RosMessage) -> RosMessage:
            on_cancel(bytes(handle.goal_id.uuid))
            return _rclpy.CancelResponse.ACCEPT

        super().__init__(
            node,
            action,
            name,
            lambda _handle: None,
            goal_callback=lambda _goal: _rclpy.GoalResponse.ACCEPT if self._accepts else _rclpy.GoalResponse.REJECT,
            handle_accepted_callback=_is_executing,
            cancel_callback=cancel,
        )

    def known(self, uuid: bytes) -> RosMessage | None:
        """Return the handle of a goal that was accepted, while rclpy keeps it; None else."""
        return self._goal_handles.get(uuid)

    def answer(self, uuid: bytes, refusal: RosMessage | None) -> None:
        """Accept a goal, or refuse it with the result that says why."""
        taken = self._taken.pop(uuid, None)
        if taken is None:
            return
        self._accepts = refusal is None
        if refusal is not None:
            self._refused[uuid] = refusal
            while len(self._refused) > _KEPT:
                self._refused.popitem(last=False)
        with contextlib.suppress(StopIteration):
            super()._execute_goal_request(taken).send(None)  # it waits for nothing: its callbacks are no coroutines
        handle = self.known(uuid)
        if handle is not None and handle.status == _ACCEPTED:  # nobody could be told
            _is_executing(handle)
            self._on_lost(uuid)

    def finish(self, uuid: bytes, state: str, result: RosMessage) -> None:
        """End a goal as "succeeded", "aborted" or "canceled", and tell those who wait for its result.

        Who did not ask for it to be cancelled is told that it was aborted.
        """
        handle = self.known(uuid)
        if handle is None or not handle.is_active:
            return
        if state == "succeeded":
            handle.succeed()
        elif state == "canceled" and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        future = self._result_futures[uuid]
        future._set_executor(None)  # noqa: SLF001 - else it is sent in a turn of the executor, which may have ended
        future.set_result(self._response(handle.status, result))

    def _response(self, status: int, result: RosMessage) -> RosMessage:
        response = self._action_type.Impl.GetResultService.Response()
        response.status, response.result = status, result
        return response

    async def _execute_goal_request(self, taken: Any) -> None:  # noqa: ANN401 - rclpy's
        header, request = taken
        uuid = bytes(request.goal_id.uuid)
        if uuid in self._taken:
            return  # the same request once more, and it is being judged
        if uuid in self._goal_handles:
            await super()._execute_goal_request(taken)  # refused, whatever its callback would say
            return
        self._taken[uuid] = taken
        self._on_goal(GoalRequest(uuid, request.goal, client_of(header)))

    async def _execute_get_result_request(self, taken: Any) -> None:  # noqa: ANN401 - rclpy's
        header, request = taken
        refused = self._refused.get(bytes(request.goal_id.uuid))
        if refused is None:
            await super()._execute_get_result_request(taken)
        else:
            self._handle.send_result_response(header, self._response(_ABORTED, refused))


def _is_executing(handle: RosMessage) -> None:
    """Do what a handle's `execute` does first: the state that clients see."""
    handle._update_state(_rclpy.GoalEvent.EXECUTE)  # noqa: SLF001 - else rclpy would wait for the end in a coroutine
