"""The six parameter services of a controller's node, and of `/controller_manager`.

The law of the file (rcl_interfaces; rclcpp): names, order and answers are upstream's. A name that is not declared
leaves the answer to `get`, `get_parameter_types` and `describe` empty; of `set_parameters` each is set on its own, of
`set_parameters_atomically` all or none. The robot decides: what is refused is answered with its sentence. What was set
is told on `/parameter_events`.
"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.endpoint import Answer, Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.parameter_values import TYPES, descriptor_of, matches, value_of, wanted_by
from canopen_control.ros.participants import client_of, folder_of
from canopen_control.ros.qos import EVENTS
from canopen_control.rpc.messages.parameters import GetParameters, ParameterValue, SetParameters

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.ros.endpoint import Reply, Ros, RosMessage
    from canopen_control.rpc.messages.declare import Done
    from canopen_control.rpc.messages.parameters import ParameterReading

    Readings = Sequence[ParameterReading]

__all__ = ["ParameterServices"]

_OF_NAMES: Final = (
    ("get_parameters", "GetParameters", "values", value_of),
    ("get_parameter_types", "GetParameterTypes", "types", lambda reading: TYPES[reading.kind]),
    ("describe_parameters", "DescribeParameters", "descriptors", descriptor_of),
)
"""Services that are asked by names: the field of the answer, and what it has of each."""


class ParameterServices(Endpoint):
    """The services below `name`, relative to the namespace; the robot knows the node by that name."""

    def __init__(self, ros: Ros, name: str) -> None:
        self._ros, self._name = ros, name
        self._result = interface("rcl_interfaces/msg/SetParametersResult")
        self._events: Any = None  # a publisher, from the first change on
        table = (
            *((service, kind, self._by_names(field, make)) for service, kind, field, make in _OF_NAMES),
            ("list_parameters", "ListParameters", self._list),
            ("set_parameters", "SetParameters", self._set),
            ("set_parameters_atomically", "SetParametersAtomically", self._set_together),
        )
        self._services = [
            ros.serve(f"rcl_interfaces/srv/{kind}", f"{name}/{service}", handler) for service, kind, handler in table
        ]

    def close(self) -> None:
        """Leave the graph."""
        for service in self._services:
            self._ros.unserve(service)
        if self._events is not None:
            self._ros.node.destroy_publisher(self._events)

    # ----------------------------------------------------------------------------------------------------- reading

    def _list(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(readings: Readings) -> None:
            names = [each.name for each in readings if matches(each.name, request.prefixes, request.depth)]
            response.result.names = names
            response.result.prefixes = sorted({name.rpartition(".")[0] for name in names} - {""})

        self._read(fill, response, reply)

    def _by_names(
        self, field: str, make: Callable[[ParameterReading], object]
    ) -> Callable[[RosMessage, RosMessage, Reply], None]:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def fill(readings: Readings) -> None:
                known = {each.name: each for each in readings}
                if all(name in known for name in request.names):
                    setattr(response, field, [make(known[name]) for name in request.names])

            self._read(fill, response, reply)

        return handler

    def _read(self, fill: Callable[[Readings], None], response: RosMessage, reply: Reply) -> None:
        """Ask for all parameters; what is refused leaves the answer empty, and is told."""

        def answer(readings: Readings | None, error: str | None) -> None:
            if readings is not None:
                fill(readings)
            if error is not None:
                self._ros.warn(f"{self._name}/parameters", f"{self._name}: {error}")
            reply(response)

        self._ros.ask(GetParameters(controller=self._name), answer)

    # ----------------------------------------------------------------------------------------------------- setting

    def _set(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        """Set one after the other, in the order of the request."""
        results: list[RosMessage] = []
        wanted = list(request.parameters)

        def go_on(result: RosMessage | None = None) -> None:
            if result is not None:
                results.append(result)
            if len(results) < len(wanted):
                self._change(wanted[len(results) : len(results) + 1], reply, go_on)
            else:
                response.results = results
                reply(response)

        go_on()

    def _set_together(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def done(result: RosMessage) -> None:
            response.result = result
            reply(response)

        self._change(list(request.parameters), reply, done)

    def _change(self, parameters: list[RosMessage], reply: Reply, done: Callable[[RosMessage], None]) -> None:
        def answer(_result: Done | None, error: str | None) -> None:
            if error is None:
                self._tell(parameters)
            else:
                self._ros.warn(f"{self._name}/set_parameters", error)
            done(self._result(successful=error is None, reason=error or ""))

        values = tuple(self._of_caller(wanted_by(each), reply) for each in parameters)
        self._ros.ask(SetParameters(controller=self._name, values=values), answer)

    def _of_caller(self, wanted: ParameterValue, reply: Reply) -> ParameterValue:
        """Return a `params_file` with whole paths: a relative one is the caller's, where the caller has such a file."""
        if not wanted.name.endswith(".params_file") or not isinstance(reply, Answer):
            return wanted
        folder, value = folder_of(self._ros.node, client_of(reply.request_id)), wanted.value

        def whole(text: str) -> str:
            return str(folder / text) if folder is not None and (folder / text).is_file() else text

        if isinstance(value, list):
            return ParameterValue(name=wanted.name, kind=wanted.kind, value=[whole(str(each)) for each in value])
        return ParameterValue(name=wanted.name, kind=wanted.kind, value=whole(str(value)))

    def _tell(self, parameters: list[RosMessage]) -> None:
        """Publish what has changed, for those who show parameters."""
        event = interface("rcl_interfaces/msg/ParameterEvent")
        if self._events is None:
            self._events = self._ros.node.create_publisher(event, "/parameter_events", EVENTS)
        node = self._ros.node
        message = event(node=f"{node.get_namespace().rstrip('/')}/{self._name}", changed_parameters=parameters)
        message.stamp = time_message(time.time())
        self._events.publish(message)
