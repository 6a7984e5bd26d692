"""Services whose answers may come later, from another thread.

rclpy answers a service when its callback returns, and its EventsExecutor takes no coroutine. So the callback here only
collects the request, and what the executor then sends through the service's `send_response` starts the work.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.rcl import Node

    Reply = Callable[[Any], object]
    #: takes a request, a response to be filled, and what sends it; once
    Handler = Callable[[Any, Any, Reply], object]

__all__ = ["RosMessage", "serve"]

RosMessage = Any
"""A message or what else rclpy hands over: classes of somebody's generator, without types."""


class _Taken(NamedTuple):
    request: RosMessage
    response: RosMessage


def serve(node: Node, kind: type, name: str, handler: Handler) -> RosMessage:
    """Make a service; `handler(request, response, reply)` is called on the executor's thread and must not block."""
    service = node.create_service(kind, name, _Taken)
    send = service.send_response

    def start(taken: _Taken, header: object) -> None:
        handler(taken.request, taken.response, lambda response: send(response, header))

    service.send_response = start
    return service
