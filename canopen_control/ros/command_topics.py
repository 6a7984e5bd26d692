"""Command topics of forward command, GPIO and PID controllers."""

from __future__ import annotations

import math
import threading
from typing import TYPE_CHECKING, Any

from std_msgs.msg import Float64MultiArray

from canopen_control.ros.conversions import command_refusal
from canopen_control.ros.endpoint import COMMANDER, Endpoint, success_of
from canopen_control.ros.interfaces import interface
from canopen_control.ros.rcl import REFERENCE, SYSTEM_DEFAULT
from canopen_control.rpc.messages.robot import CommandByName, CommandController, SetFeedForward, SetMeasuredStates

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.endpoint import NodeContext, Reply, RosMessage
    from canopen_control.rpc.messages.state import ControllerReading


# `/<controller>/commands` of the forward controllers: Float64MultiArray, one number per joint.
#
# Rules (forward_command_controller, Jazzy): only `data` is used, in the order of the joints. A message with a value
# that is not finite, or with a wrong number of values, is dropped, as the runtime would refuse such a command.


class ForwardCommands(Endpoint):
    """Subscription of `~/commands` of one forward command controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller
        self.subscribe(Float64MultiArray, f"{controller.name}/commands", self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller

    def _on_message(self, message: Float64MultiArray) -> None:
        values, topic = list(message.data), f"{self._controller.name}/commands"
        refusal = command_refusal(values, self._controller)
        if refusal is not None:
            self._ros.warn(topic, refusal)
            return
        self._ros.watch_publishers(topic, topic, values)
        self._ros.command(
            CommandController(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
        )


# `~/commands` of a GPIO command controller: outputs of <gpio> parts by their names (DynamicInterfaceGroupValues).
#
# Rules (gpio_controllers, Jazzy): a message sets the outputs that it names; the others keep their values. Own rules: an
# invalid message (an unknown or repeated name, different numbers of names and values, a value that is not finite) is
# dropped as a whole with a warning, and the controller continues. Messages that arrive before the robot has answered
# are merged, with the newest value of each output, so that no queue grows and no output is lost. The commands of the
# outputs end with this bridge.


class GpioCommands(Endpoint):
    """Subscription of `~/commands` of one GPIO command controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller, self._topic = controller, f"{controller.name}/commands"
        self._lock = threading.Lock()
        self._pending: dict[str, float] = {}
        self._is_waiting = False
        message: Any = interface("control_msgs/msg/DynamicInterfaceGroupValues")
        self.subscribe(message, self._topic, self._on_message, SYSTEM_DEFAULT)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller
        if not controller.active:
            with self._lock:
                self._pending.clear()

    def _on_message(self, message: RosMessage) -> None:
        try:
            values = outputs_of(message, self._controller)
        except ValueError as error:
            self.report(self._topic, f"{error}; the message was dropped")
            return
        with self._lock:
            wake = not self._pending and bool(values)
            self._pending.update(values)
        if wake:
            self._ros.hand_over(self._send)

    def _send(self) -> None:
        """Send the merged values to the robot, unless the previous request has not been answered yet."""
        if self._is_waiting:
            return
        with self._lock:
            values, self._pending = self._pending, {}
        if values:
            self._is_waiting = True
            request = CommandByName(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
            self._ros.ask(request, self._on_answer)

    def _on_answer(self, _done: object, error: str | None) -> None:
        self._is_waiting = False
        self.report(self._topic, error)
        self._send()


def outputs_of(message: RosMessage, controller: ControllerReading) -> dict[str, float]:
    """Return the values in a message by "gpio/interface".

    Raise ValueError with the reason if the message is invalid or the controller is not active.
    """
    if not controller.active:
        raise ValueError(f"{controller.name} is {controller.state}; activate it before commanding it")
    groups, inner = list(message.interface_groups), list(message.interface_values)
    if len(groups) != len(inner):
        raise ValueError(f"{len(groups)} interface_groups with {len(inner)} interface_values; give equal numbers")
    output_names, outputs = controller.required_command_interfaces, dict[str, float]()
    for group, group_values in zip(groups, inner, strict=True):
        names, values = list(group_values.interface_names), list(group_values.values)
        if len(names) != len(values):
            raise ValueError(f"{group}: {len(names)} interface_names with {len(values)} values; give equal numbers")
        for name, value in zip((f"{group}/{name}" for name in names), values, strict=True):
            if name not in output_names:
                raise ValueError(f"{name!r} is not an output; the outputs are: {', '.join(output_names) or 'none'}")
            if name in outputs:
                raise ValueError(f"{name} is named twice")
            if not math.isfinite(value):
                raise ValueError(f"{name} is {value}; give finite numbers")
            outputs[name] = float(value)
    return outputs


# Topics of a PID controller (`~/reference`, `~/measured_state`) and its service `~/set_feedforward_control`.
#
# Rules (pid_controller, Jazzy): a MultiDOFCommand has a reference for each degree of freedom, and its derivative if the
# controller has a second reference interface; the values are in the order of `dof_names`, or of the parameters if there
# are no names. `~/measured_state` exists with `use_external_measured_states`. While another controller commands the
# references, the robot refuses messages. Own rules: an incomplete message, or one with a value that is not finite, is
# dropped, and does not refresh the reference; a reference ends with this bridge.


class PidReferences(Endpoint):
    """Subscription of `~/reference` of a PID controller."""

    topic = "reference"

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._topic = f"{controller.name}/{self.topic}"
        self._subscription: object = None
        self.on_controller(controller)

    def on_controller(self, controller: ControllerReading) -> None:
        self._controller = controller
        if self._subscription is None and self.is_needed(controller):
            message: Any = interface("control_msgs/msg/MultiDOFCommand")
            self._subscription = self.subscribe(message, self._topic, self._on_message, REFERENCE)

    @staticmethod
    def is_needed(controller: ControllerReading) -> bool:
        """Whether the topic exists for a controller; `~/reference` always exists."""
        del controller
        return True

    def _on_message(self, message: RosMessage) -> None:
        try:
            values = self._values_of(message)
        except ValueError as error:
            self.report(self._topic, f"{error}; the message was dropped")
            return
        self._ros.watch_publishers(self._topic, self._topic, values)
        self._hand_over(values)

    def _hand_over(self, values: list[float]) -> None:
        self._ros.command(
            CommandController(controller=self._controller.name, values=values, source=COMMANDER, dead_man=True)
        )

    def _values_of(self, message: RosMessage) -> list[float]:
        """Return the values and derivatives in a message, in the controller's order.

        Raise ValueError with the reason if the message is invalid or the controller is not active.
        """
        controller = self._controller
        if not controller.active:
            raise ValueError(f"{controller.name} is {controller.state}; activate it before commanding it")
        dofs = _dofs_of(controller)
        order = _order(list(message.dof_names) or dofs, dofs)
        values = _sorted("values", message.values, order, dofs)
        # nan in every element means no command, like an empty list
        if all(map(math.isnan, message.values_dot)):
            return values
        if len(controller.reference_interfaces) < 2 * len(dofs):
            text = "values_dot is ignored: reference_and_state_interfaces has one interface; add its derivative"
            self._ros.warn(f"{self._topic} values_dot", f"{self._topic}: {text}")
            return values
        return values + _sorted("values_dot", message.values_dot, order, dofs)


class PidMeasuredStates(PidReferences):
    """Subscription of `~/measured_state` of a PID controller without state interfaces."""

    topic = "measured_state"

    def _hand_over(self, values: list[float]) -> None:
        request = SetMeasuredStates(controller=self._controller.name, values=values)
        self._ros.ask(request, lambda _done, error: self.report(self._topic, error))

    @staticmethod
    def is_needed(controller: ControllerReading) -> bool:
        """Whether the controller is configured to receive measured states as messages."""
        return bool(controller.required_command_interfaces) and not controller.required_state_interfaces


class FeedForwardSwitch(Endpoint):
    """Service `~/set_feedforward_control` of a PID controller."""

    def __init__(self, ros: NodeContext, controller: ControllerReading) -> None:
        super().__init__(ros)
        self._controller = controller.name
        self.serve("std_srvs/srv/SetBool", f"{controller.name}/set_feedforward_control", self._answer)

    def _answer(self, request: RosMessage, response: RosMessage, reply: Reply) -> None:
        command = SetFeedForward(controller=self._controller, enabled=request.data)
        self._ros.ask(command, success_of(response, reply))


def _dofs_of(controller: ControllerReading) -> list[str]:
    """Return the names of the degrees of freedom in the order of the parameters."""
    firsts = controller.reference_interfaces[: controller.width]
    return [first.removeprefix(f"{controller.name}/").rpartition("/")[0] for first in firsts]


def _order(names: Sequence[str], dofs: Sequence[str]) -> list[int]:
    """Return the index of each degree of freedom in `names`; raise ValueError unless each is named exactly once."""
    if sorted(names) == sorted(dofs):
        return [names.index(dof) for dof in dofs]
    unknown = next((name for name in names if name not in dofs), None)
    if unknown is not None:
        raise ValueError(f"{unknown!r} is not one of {', '.join(dofs)}")
    raise ValueError(f"dof_names is {', '.join(names)}; give each of {', '.join(dofs)} once")


def _sorted(field: str, values: Sequence[float], order: Sequence[int], dofs: Sequence[str]) -> list[float]:
    """Return `values` in the controller's order; `order` has the index of each degree of freedom in `values`.

    Raise ValueError unless every degree of freedom has one finite value.
    """
    if len(values) != len(order):
        raise ValueError(f"{field} has {len(values)} numbers for {', '.join(dofs)}; give {len(order)}")
    ordered = [float(values[index]) for index in order]
    for dof, value in zip(dofs, ordered, strict=True):
        if not math.isfinite(value):
            raise ValueError(f"{field} of {dof} is {value}; give finite numbers")
    return ordered
