"""ROS nodes of the loaded controllers and of `/controller_manager`, with their parameters.

Rules (controller_manager, Jazzy): the node of a controller has the controller's name and the manager's namespace, and
owns the controller's topics, services and actions. All nodes share the bridge's participant and callback thread.
"""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.endpoint import Answer, Endpoint, NodeContext, client_of, folder_of
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import EVENTS, further_node
from canopen_control.ros.sample_publisher import time_message
from canopen_control.rpc.messages.parameters import KINDS, GetParameters, ParameterValue, SetParameters, plain_value

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from canopen_control.ros.endpoint import Reply, RosMessage, SessionPort
    from canopen_control.ros.rcl import Context, Node, Spinner
    from canopen_control.rpc.messages.declare import Done
    from canopen_control.rpc.messages.parameters import ParameterReading

    Readings = Sequence[ParameterReading]


# Conversion between parameters of ROS 2 (rcl_interfaces) and those of the robot's socket.


#: rcl_interfaces/msg/ParameterType
TYPES: Final = {
    "not_set": 0, "bool": 1, "integer": 2, "double": 3, "string": 4, "bool_array": 6, "integer_array": 7,
    "double_array": 8, "string_array": 9,
}  # fmt: skip
_KIND_OF: Final = {number: kind for kind, number in TYPES.items()}
_INTEGERS: Final = (-(1 << 63), (1 << 63) - 1)


def value_of(reading: ParameterReading) -> RosMessage:
    """Convert a parameter to rcl_interfaces/msg/ParameterValue; type 0 if the parameter is not set."""
    message = interface("rcl_interfaces/msg/ParameterValue")()
    value = reading.plain
    if value is not None and reading.kind != "not_set":
        message.type = TYPES[reading.kind]
        setattr(message, f"{reading.kind}_value", value)
    return message


def descriptor_of(reading: ParameterReading) -> RosMessage:
    """Return a parameter's rcl_interfaces/msg/ParameterDescriptor, with its range or its choices."""
    message = interface("rcl_interfaces/msg/ParameterDescriptor")()
    message.name, message.type, message.read_only = reading.name, TYPES[reading.kind], reading.read_only
    message.description = reading.text
    if reading.choices:
        message.additional_constraints = f"one of: {', '.join(reading.choices)}"
    element = KINDS[reading.kind] or reading.kind
    if reading.low is None and reading.high is None:
        return message
    if element == "double":
        limits = interface("rcl_interfaces/msg/FloatingPointRange")
        message.floating_point_range = [
            limits(
                from_value=-math.inf if reading.low is None else float(reading.low),
                to_value=math.inf if reading.high is None else float(reading.high),
            )
        ]
    elif element == "integer":
        limits, (lowest, highest) = interface("rcl_interfaces/msg/IntegerRange"), _INTEGERS
        low, high = reading.low, reading.high
        message.integer_range = [
            limits(
                from_value=lowest if low is None else math.ceil(low),
                to_value=highest if high is None else math.floor(high),
                step=1,
            )
        ]
    return message


def requested_value(parameter: RosMessage) -> ParameterValue:
    """Return the value in an rcl_interfaces/msg/Parameter; a type unknown to the API is treated as not set."""
    kind = _KIND_OF.get(parameter.value.type, "not_set")
    value = None if kind == "not_set" else getattr(parameter.value, f"{kind}_value")
    plain = value if isinstance(value, bool | int | float | str | None) else list(value)
    return ParameterValue(name=parameter.name, kind=kind, value=plain_value(plain))


def matches(name: str, prefixes: Iterable[str], depth: int) -> bool:
    """Whether list_parameters with `prefixes` and `depth` includes a parameter name, as in rclcpp.

    Without prefixes every name matches; a `depth` of 0 is unlimited.
    """
    names = list(prefixes)
    if not names:
        return not depth or name.count(".") < depth
    return any(
        name == prefix or (name.startswith(f"{prefix}.") and (not depth or name[len(prefix) + 1 :].count(".") < depth))
        for prefix in names
    )


# The six parameter services of a controller's node, and of `/controller_manager`.
#
# Rules (rcl_interfaces; rclcpp): names, order and answers are the same as upstream. The answer to `get_parameters`,
# `get_parameter_types` and `describe_parameters` is empty if a name is not declared; `set_parameters` sets the
# parameters one by one, `set_parameters_atomically` sets all or none. The robot decides: the answer to a refused change
# contains the robot's reason. Changed parameters are published on `/parameter_events`.


_OF_NAMES: Final = (
    ("get_parameters", "GetParameters", "values", value_of),
    ("get_parameter_types", "GetParameterTypes", "types", lambda reading: TYPES[reading.kind]),
    ("describe_parameters", "DescribeParameters", "descriptors", descriptor_of),
)
"""Services with parameter names as request: name, type, field of the response, and function for an element."""


class ParameterServices(Endpoint):
    """Parameter services of the node `name`, which is a controller or "controller_manager"."""

    def __init__(self, ros: NodeContext, name: str) -> None:
        super().__init__(ros)
        self._name = name
        self._result = interface("rcl_interfaces/msg/SetParametersResult")
        self._events: Any = None  # a publisher, from the first change on
        table = (
            *((service, kind, self._by_names(field, make)) for service, kind, field, make in _OF_NAMES),
            ("list_parameters", "ListParameters", self._list),
            ("set_parameters", "SetParameters", self._set),
            ("set_parameters_atomically", "SetParametersAtomically", self._set_together),
        )
        for service, kind, handler in table:
            self.serve(f"rcl_interfaces/srv/{kind}", f"{name}/{service}", handler)

    # ----------------------------------------------------------------------------------------------------- reading

    def _list(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def fill(readings: Readings) -> None:
            names = [reading.name for reading in readings if matches(reading.name, request.prefixes, request.depth)]
            response.result.names = names
            response.result.prefixes = sorted({name.rpartition(".")[0] for name in names} - {""})

        self._read(fill, response, reply)

    def _by_names(
        self, field: str, make: Callable[[ParameterReading], object]
    ) -> Callable[[RosMessage, RosMessage, Reply], None]:
        def handler(request: RosMessage, response: RosMessage, reply: Reply) -> None:
            def fill(readings: Readings) -> None:
                by_name = {reading.name: reading for reading in readings}
                if all(name in by_name for name in request.names):
                    setattr(response, field, [make(by_name[name]) for name in request.names])

            self._read(fill, response, reply)

        return handler

    def _read(self, fill: Callable[[Readings], None], response: RosMessage, reply: Reply) -> None:
        """Read all parameters of the controller; a refusal leaves the response empty and is logged."""

        def answer(readings: Readings | None, error: str | None) -> None:
            if readings is not None:
                fill(readings)
            if error is not None:
                self._ros.warn(f"{self._name}/parameters", f"{self._name}: {error}")
            reply(response)

        self._ros.ask(GetParameters(controller=self._name), answer)

    # ----------------------------------------------------------------------------------------------------- setting

    def _set(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        """Set the parameters one by one, in the order of the request."""
        results: list[RosMessage] = []
        parameters = list(request.parameters)

        def set_next(result: RosMessage | None = None) -> None:
            if result is not None:
                results.append(result)
            if len(results) < len(parameters):
                self._change(parameters[len(results) : len(results) + 1], reply, set_next)
            else:
                response.results = results
                reply(response)

        set_next()

    def _set_together(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        def done(result: RosMessage) -> None:
            response.result = result
            reply(response)

        self._change(list(request.parameters), reply, done)

    def _change(self, parameters: list[RosMessage], reply: Reply, done: Callable[[RosMessage], None]) -> None:
        def answer(_result: Done | None, error: str | None) -> None:
            if error is None:
                self._report(parameters)
            else:
                self._ros.warn(f"{self._name}/set_parameters", error)
            done(self._result(successful=error is None, reason=error or ""))

        values = tuple(self._of_caller(requested_value(parameter), reply) for parameter in parameters)
        self._ros.ask(SetParameters(controller=self._name, values=values), answer)

    def _of_caller(self, parameter: ParameterValue, reply: Reply) -> ParameterValue:
        """Make paths in a `params_file` parameter absolute if the file exists in the client's working directory."""
        if not parameter.name.endswith(".params_file") or not isinstance(reply, Answer):
            return parameter
        folder, value = folder_of(self._ros.node, client_of(reply.request_id)), parameter.value

        def absolute(text: str) -> str:
            return str(folder / text) if folder is not None and (folder / text).is_file() else text

        if isinstance(value, list):
            return ParameterValue(
                name=parameter.name, kind=parameter.kind, value=[absolute(str(element)) for element in value]
            )
        return ParameterValue(name=parameter.name, kind=parameter.kind, value=absolute(str(value)))

    def _report(self, parameters: list[RosMessage]) -> None:
        """Publish changed parameters on `/parameter_events`."""
        event = interface("rcl_interfaces/msg/ParameterEvent")
        if self._events is None:
            self._events = self.publisher(event, "/parameter_events", EVENTS)
        node = self._ros.node
        message = event(node=f"{node.get_namespace().rstrip('/')}/{self._name}", changed_parameters=parameters)
        message.stamp = time_message(time.time())
        self._events.publish(message)


class ControllerNodes:
    """ROS nodes of the loaded controllers; `first` is the bridge's own node."""

    def __init__(self, session: SessionPort, first: Node, context: Context, spinner: Spinner) -> None:
        self._session, self._first, self._context, self._spinner = session, first, context, spinner
        self._nodes: dict[str, tuple[NodeContext, ParameterServices]] = {}

    def of(self, name: str, arguments: Sequence[str] = ()) -> NodeContext:
        """Return the context of the node `name`, created on first use; may raise any exception of rclpy."""
        if name not in self._nodes:
            node = further_node(name, self._context, str(self._first.get_namespace()), arguments)
            self._spinner.add(node)
            ros = NodeContext(self._session, node)
            self._nodes[name] = (ros, ParameterServices(ros, name))
        return self._nodes[name][0]

    def forget(self, name: str) -> None:
        """Destroy the node `name`, if it exists; the caller must have closed its endpoints."""
        node = self._nodes.pop(name, None)
        if node is not None:
            ros, parameters = node
            parameters.close()
            self._spinner.remove(ros.node)

    def close(self) -> None:
        for name in list(self._nodes):
            self.forget(name)
