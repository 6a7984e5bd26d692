"""`/diagnostics` once per second, and at once when a level changes; `~/events` with every event.

`/diagnostics` is absolute and holds one status per node, per controller and for the cycle. Events
are rcl_interfaces/msg/Log, the message of `/rosout`, with the node's or the robot's name; EMCY messages of the drives
are among them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from canopen_control.ros.diagnosis import Diagnosis, diagnose
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.nodes import ros_name
from canopen_control.ros.qos import EVENTS, ROSOUT
from canopen_control.ros.sample_publisher import time_message

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.ros.endpoint import Ros
    from canopen_control.ros.nodes import RosNode
    from canopen_control.rpc.messages.state import RobotEvent, StateSample


_PERIOD_S: Final = 1.0
_LEVELS: Final = {"debug": 10, "info": 20, "warning": 30, "error": 40, "fatal": 50}  # of rcl_interfaces/msg/Log


class Diagnostics(Endpoint):
    """The publisher of `/diagnostics`."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._publisher = ros.node.create_publisher(DiagnosticArray, "/diagnostics", EVENTS)
        self._next, self._missed = 0.0, 0
        self._levels: dict[str, int] = {}

    def on_state(self, state: StateSample) -> None:
        """Publish when due, or when a level has changed."""
        diagnoses = diagnose(self._ros.robot, state, self._ros.controllers, self._missed)
        levels = {diagnosis.name: int(diagnosis.level) for diagnosis in diagnoses}
        time = state.time
        # a clock that was set back does not silence it
        if levels == self._levels and time < self._next <= time + _PERIOD_S:
            return
        self._next, self._levels = time + _PERIOD_S, levels
        self._missed = state.cycle.missed
        message = DiagnosticArray(status=[_status(diagnosis) for diagnosis in diagnoses])
        message.header.stamp = time_message(time)
        self._publisher.publish(message)

    def close(self) -> None:
        """Destroy the publisher."""
        self._ros.node.destroy_publisher(self._publisher)


class Events(Endpoint):
    """The publisher of `~/events`."""

    def __init__(self, ros: Ros) -> None:
        self._ros, self._log = ros, interface("rcl_interfaces/msg/Log")
        self._publisher = ros.node.create_publisher(self._log, "~/events", EVENTS)

    def on_event(self, event: RobotEvent) -> None:
        """Publish an event."""
        self._publisher.publish(log_message(self._log, event, self._ros.robot))

    def close(self) -> None:
        """Destroy the publisher."""
        self._ros.node.destroy_publisher(self._publisher)


def log_message(log: Any, event: RobotEvent, robot: str) -> Any:  # noqa: ANN401 - a generated class
    """Return an event of the API as a `log`, the class of rcl_interfaces/msg/Log."""
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


# `/rosout`: what happens to a robot, at its level, from the node it concerns; rqt_console shows it.
#
# Rules (rcl): the name of a message is its node's, `NAMESPACE.NODE`; the quality is that of every node's
# log. An event of a drive is its node's, of a controller that controller's, of the robot itself the bridge's. The robot
# reports repeated events once, and then as a summary; an event that only repeats the reason of the last one of the same
# node is omitted here, unless it is worse. None of it appears on the bridge's standard error: the robot's log has it.


_SAME_S: Final = 1.0  # within which an event follows from the one before


class _Cause(NamedTuple):
    """Last reported cause of a node: time, level, and text without its name."""

    time: float
    level: int
    text: str


class Rosout(Endpoint):
    """Publisher of /rosout; `nodes` are those of the bus, in their namespaces."""

    def __init__(self, ros: Ros, nodes: Iterable[RosNode]) -> None:
        self._ros, self._log = ros, interface("rcl_interfaces/msg/Log")
        self._namespace = str(ros.node.get_namespace())
        self._of_nodes = {node.name: _logger(node.namespace, ros_name(node.name)) for node in nodes}
        self._own = _logger(self._namespace, str(ros.node.get_name()))
        self._publisher = ros.node.create_publisher(self._log, "/rosout", ROSOUT)
        self._causes: dict[str, _Cause] = {}

    def on_event(self, event: RobotEvent) -> None:
        """Publish an event."""
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
        """Whether an event repeats the reported cause, such as a lost node after its missing heartbeat."""
        last = self._causes.get(name)
        same = last is not None and abs(event.time - last.time) <= _SAME_S and level <= last.level
        if last is not None and same and event.kind != "stop" and event.text.endswith(last.text):
            return True
        self._causes[name] = _Cause(event.time, level, event.text.partition(": ")[2] or event.text)
        return False

    def close(self) -> None:
        """Destroy the publisher."""
        self._ros.node.destroy_publisher(self._publisher)


def _logger(namespace: str, node: str) -> str:
    """Return the name of a node's logger."""
    return ".".join([*namespace.strip("/").split("/"), node]).lstrip(".")
