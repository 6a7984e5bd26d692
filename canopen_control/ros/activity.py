"""`/controller_manager/activity`: the lifecycle states of controllers and hardware components, whenever one changes.

The law of the file (controller_manager, Jazzy): reliable and transient local, one message deep, so that who comes later
has the present states at once. The stream tells the states of controllers; those of the hardware are asked for when
something has happened, one request at a time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from canopen_control.ros.controller_manager import STATES
from canopen_control.ros.endpoint import Endpoint
from canopen_control.ros.interfaces import interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import LATCHED
from canopen_control.rpc.messages.robot import ListHardware

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros
    from canopen_control.rpc.messages.robot import HardwareReading
    from canopen_control.rpc.messages.state import RobotEvent, StateSample

    States = dict[str, str]

__all__ = ["Activity"]

_PERIOD_S: Final = 1.0  # of a look at the hardware, should a change have come without an event


class Activity(Endpoint):
    """The publisher of `controller_manager/activity`, relative to the namespace."""

    def __init__(self, ros: Ros) -> None:
        self._ros = ros
        self._message = interface("controller_manager_msgs/msg/ControllerManagerActivity")
        self._named = interface("controller_manager_msgs/msg/NamedLifecycleState")
        self._state = interface("lifecycle_msgs/msg/State")
        self._publisher = ros.node.create_publisher(self._message, "controller_manager/activity", LATCHED)
        self._controllers: States = {}
        self._told: tuple[States, States] | None = None
        self._asking, self._due = False, True
        self._next = self._time = 0.0

    def on_event(self, event: RobotEvent) -> None:
        """Look at the hardware with the next sample: it may be what has changed."""
        del event
        self._due = True

    def on_state(self, state: StateSample) -> None:
        """Ask for the hardware if anything may have changed."""
        self._time = state.time
        controllers = dict(state.controllers)
        # a clock that was set back does not silence it
        idle = controllers == self._controllers and not self._due and self._time < self._next <= self._time + _PERIOD_S
        if self._asking or idle:
            return
        self._controllers, self._next = controllers, self._time + _PERIOD_S
        self._asking, self._due = True, False
        self._ros.ask(ListHardware(), self._on_hardware)

    def _on_hardware(self, answer: list[HardwareReading] | None, error: str | None) -> None:
        self._asking = False
        hardware = {each.name: each.state for each in answer or ()}
        if error is not None:
            self._ros.warn("activity", f"controller_manager/activity: {error}")
        elif (self._controllers, hardware) != self._told:
            self._told = (self._controllers, hardware)
            self._publish(*self._told)

    def _publish(self, controllers: States, hardware: States) -> None:
        message = self._message(
            controllers=self._lifecycles(controllers), hardware_components=self._lifecycles(hardware)
        )
        message.header.stamp = time_message(self._time)
        self._publisher.publish(message)

    def _lifecycles(self, states: States) -> list[Any]:
        return [
            self._named(name=name, state=self._state(id=STATES.get(label, 0), label=label))
            for name, label in states.items()
        ]

    def close(self) -> None:
        """Leave the topic."""
        self._ros.node.destroy_publisher(self._publisher)
