"""Publishers of `/diagnostics`, `~/events` and `/rosout`.

`/diagnostics` is published once per second, and at once when a level changes; its name is absolute, and it has one
status per node, per controller, per status of a diagnostics broadcaster, and for the cycle. Events are
rcl_interfaces/msg/Log, the message of `/rosout`, with the name of the node or the robot; they include the EMCY messages
of the drives.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from canopen_control.ros.diagnosis import Diagnosis, diagnose
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.nodes import ros_name
from canopen_control.ros.rcl import EVENTS, ROSOUT
from canopen_control.ros.sample_publisher import time_message

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.ros.endpoint import NodeContext
    from canopen_control.ros.nodes import RosNode
    from canopen_control.rpc.messages.state import RobotEvent, StateSample


_PERIOD_S: Final = 1.0
_LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}  # of rcl_interfaces/msg/Log


class Diagnostics(Endpoint):
    """Publisher of `/diagnostics`, once per second and when a level changes."""

    def __init__(self, ros: NodeContext) -> None:
        self._ros = ros
        self._publisher = ros.node.create_publisher(DiagnosticArray, "/diagnostics", EVENTS)
        self._next, self._missed = 0.0, 0
        self._levels: dict[str, int] = {}

    def on_state(self, state: StateSample) -> None:
        diagnoses = diagnose(self._ros.robot, state, self._ros.controllers, self._missed)
        levels = {diagnosis.name: int(diagnosis.level) for diagnosis in diagnoses}
        time = state.time
        # publishing continues after the clock was set back
        if levels == self._levels and time < self._next <= time + _PERIOD_S:
            return
        self._next, self._levels = time + _PERIOD_S, levels
        self._missed = state.cycle.missed
        message = DiagnosticArray(status=[_status(diagnosis) for diagnosis in diagnoses])
        message.header.stamp = time_message(time)
        self._publisher.publish(message)

    def close(self) -> None:
        self._ros.node.destroy_publisher(self._publisher)


class Events(Endpoint):
    """Publisher of the robot's events on `~/events`."""

    def __init__(self, ros: NodeContext) -> None:
        self._ros, self._log = ros, interface("rcl_interfaces/msg/Log")
        self._publisher = ros.node.create_publisher(self._log, "~/events", EVENTS)

    def on_event(self, event: RobotEvent) -> None:
        self._publisher.publish(log_message(self._log, event, self._ros.robot))

    def close(self) -> None:
        self._ros.node.destroy_publisher(self._publisher)


def log_message(log: Any, event: RobotEvent, robot: str) -> Any:  # noqa: ANN401 - a generated class
    """Convert an API event to a message of the class `log`, which is rcl_interfaces/msg/Log."""
    message = log()
    message.stamp = time_message(event.time)
    message.level = _LEVELS.get(event.level, _LEVELS["info"])
    message.name = event.node or robot
    message.msg, message.function = event.text, event.kind
    return message


def _status(diagnosis: Diagnosis) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=bytes([diagnosis.level]),
        name=diagnosis.name,
        message=diagnosis.message,
        hardware_id=diagnosis.hardware_id,
        values=[KeyValue(key=key, value=value) for key, value in diagnosis.values.items()],
    )


# `/rosout`: the events of a robot with their severity and the name of the node that they concern, for rqt_console.
#
# Rules (rcl): the name of a message is the logger name of its node, `NAMESPACE.NODE`; the quality of service is the
# same as for the log of every ROS node. The name is the node of the drive, the controller, or for the robot itself the
# bridge. The robot reports repeated events once, and then as a summary; an event that only repeats the reason of the
# previous event of the same node is omitted here, unless it is more severe. The bridge does not print these events to
# its standard error, because the robot's log contains them.


_SAME_S: Final = 1.0  # within this time an event may be a consequence of the previous one


class _Cause(NamedTuple):
    """Last published event of a node: time, level, and text without the node's name."""

    time: float
    level: int
    text: str


class Rosout(Endpoint):
    """Publisher of `/rosout`; `nodes` are the nodes of the bus, with their namespaces."""

    def __init__(self, ros: NodeContext, nodes: Iterable[RosNode]) -> None:
        self._ros, self._log = ros, interface("rcl_interfaces/msg/Log")
        self._namespace = str(ros.node.get_namespace())
        self._of_nodes = {node.name: _logger(node.namespace, ros_name(node.name)) for node in nodes}
        self._own = _logger(self._namespace, str(ros.node.get_name()))
        self._publisher = ros.node.create_publisher(self._log, "/rosout", ROSOUT)
        self._causes: dict[str, _Cause] = {}

    def on_event(self, event: RobotEvent) -> None:
        message = log_message(self._log, event, self._ros.robot)
        if event.controller is not None:
            message.name = _logger(self._namespace, event.controller)
        elif event.node is not None:
            message.name = self._of_nodes.get(event.node) or _logger(self._namespace, ros_name(event.node))
        else:
            message.name = self._own
        if not self._repeats_cause(event, message.name, int(message.level)):
            self._publisher.publish(message)

    def _repeats_cause(self, event: RobotEvent, name: str, level: int) -> bool:
        """Whether an event only repeats the cause of the node's previous event; if not, record it as that event."""
        last = self._causes.get(name)
        same = last is not None and abs(event.time - last.time) <= _SAME_S and level <= last.level
        if last is not None and same and event.kind != "stop" and event.text.endswith(last.text):
            return True
        self._causes[name] = _Cause(event.time, level, event.text.partition(": ")[2] or event.text)
        return False

    def close(self) -> None:
        self._ros.node.destroy_publisher(self._publisher)


def _logger(namespace: str, node: str) -> str:
    """Return the name of a node's logger: namespace and node, separated by dots."""
    return ".".join([*namespace.strip("/").split("/"), node]).lstrip(".")
