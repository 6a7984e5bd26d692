"""`~/battery_state` and `~/raw_battery_states` of the battery state broadcaster.

The law of the file (battery_state_broadcaster): the first is all batteries as one, a BatteryState, the second each by
itself, a BatteryStateArray whose headers name the battery as their frame. What is not known is nan. A message is made
only where somebody listens.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.ros.conversions import unknown_as_nan
from canopen_control.ros.endpoint import Endpoint, NewSamples
from canopen_control.ros.interfaces import MissingInterface, interface
from canopen_control.ros.joint_states import time_message
from canopen_control.ros.qos import SYSTEM_DEFAULT
from canopen_control.rpc.messages.samples import BatteriesSample

if TYPE_CHECKING:
    from canopen_control.ros.endpoint import Ros, RosMessage
    from canopen_control.rpc.messages.samples import BatteryReading
    from canopen_control.rpc.messages.state import ControllerReading, StateSample

__all__ = ["BatteryTopics"]

_MEASURED = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")
_TOLD = ("power_supply_status", "power_supply_health", "power_supply_technology", "present", "location",
         "serial_number")  # fmt: skip


class BatteryTopics(Endpoint):
    """The publishers of one broadcaster."""

    def __init__(self, ros: Ros, controller: ControllerReading) -> None:
        self._ros, self._name, self._samples = ros, controller.name, NewSamples(BatteriesSample)
        self._one: Any = interface("sensor_msgs/msg/BatteryState")
        make = ros.node.create_publisher
        self._together = make(self._one, f"{self._name}/battery_state", SYSTEM_DEFAULT)
        self._each: Any = None
        try:
            self._array: Any = interface("control_msgs/msg/BatteryStateArray")
        except MissingInterface as error:
            ros.leave_out(error.name)
        else:
            self._each = make(self._array, f"{self._name}/raw_battery_states", SYSTEM_DEFAULT)

    def on_state(self, state: StateSample) -> None:
        """Publish what is new."""
        sample = self._samples.of(state).get(self._name)
        if sample is None:
            return
        if self._together.get_subscription_count():
            self._together.publish(self._message(sample.together, sample.time))
        if self._each is not None and self._each.get_subscription_count():
            self._each.publish(
                self._array(battery_states=[self._message(each, sample.time) for each in sample.batteries])
            )

    def close(self) -> None:
        """Leave the topics."""
        for publisher in filter(None, (self._together, self._each)):
            self._ros.node.destroy_publisher(publisher)

    def _message(self, battery: BatteryReading, time: float) -> RosMessage:
        message = self._one()
        message.header.stamp, message.header.frame_id = time_message(time), battery.name
        for field in _MEASURED:
            setattr(message, field, unknown_as_nan(getattr(battery, field)))
        for field in _TOLD:
            setattr(message, field, getattr(battery, field))
        return message
