"""BatteryStateBroadcaster: the batteries of a robot, each by itself and all of them as one.

The law of the file (battery_state_broadcaster): the voltage of each battery is read, and what `interfaces` names
besides; without a percentage it is that of the voltage between `minimum_voltage` and `maximum_voltage`; a battery is
present that has a voltage. Of all of them voltage, current, temperature and percentage are the mean of those that are
known, charge and capacities the sum, status and health the highest. Ours: a percentage is published from 0 to 1, as
sensor_msgs defines it; upstream publishes 0 to 100.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.battery_params import QUANTITIES, Battery, BatteryParams, read_params
from canopen_control.controllers.sensor_broadcasters import SensorBroadcaster
from canopen_control.controllers.state_copy import finite
from canopen_control.rpc.messages.samples import BatteriesSample, BatteryReading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import Sample

__all__ = ["BatteryStateBroadcaster"]


class BatteryStateBroadcaster(SensorBroadcaster):
    """Tells the batteries."""

    tells: ClassVar[type[Sample] | None] = BatteriesSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = BatteryParams()

    def on_configure(self, params: Params) -> None:
        """Read the parameters; RobotConfigError with everything that is wrong in them."""
        self.params = given = read_params(params, self.name)
        self.update_rate = given.update_rate
        self._names = [each for battery in given.names for each in given.measured(battery)]

    def sample(self, wall_offset_ns: int) -> BatteriesSample:
        """Return what was measured at the last update."""
        size = len(QUANTITIES)
        batteries = [
            _reading(name, own, self._known(place * size, (place + 1) * size))
            for place, (name, own) in enumerate(zip(self.params.names, self.params.own, strict=True))
        ]
        return BatteriesSample(time=self.published(wall_offset_ns), batteries=batteries, together=_together(batteries))


def _reading(name: str, own: Battery, values: Sequence[float | None]) -> BatteryReading:
    """Return what is known of a battery; `values` are those of QUANTITIES."""
    voltage, temperature, current, charge, percentage, status, health, present = values
    if percentage is None and voltage is not None:  # nan without its bounds
        percentage = finite(100.0 * (voltage - own.minimum_voltage) / (own.maximum_voltage - own.minimum_voltage))
    return BatteryReading(
        name=name,
        voltage=voltage,
        temperature=temperature,
        current=current,
        charge=charge,
        capacity=finite(own.capacity),
        design_capacity=finite(own.design_capacity),
        percentage=None if percentage is None else percentage / 100.0,
        power_supply_status=int(status or 0),
        power_supply_health=int(health or 0),
        power_supply_technology=own.power_supply_technology,
        present=bool(voltage) if present is None else bool(present),
        location=own.location,
        serial_number=own.serial_number,
    )


def _together(batteries: Sequence[BatteryReading]) -> BatteryReading:
    """Return all batteries as one."""
    technologies = {each.power_supply_technology for each in batteries}
    return BatteryReading(
        name="",
        voltage=_mean([each.voltage for each in batteries]),
        temperature=_mean([each.temperature for each in batteries]),
        current=_mean([each.current for each in batteries]),
        charge=_sum([each.charge for each in batteries]),
        capacity=_sum([each.capacity for each in batteries]),
        design_capacity=_sum([each.design_capacity for each in batteries]),
        percentage=_mean([each.percentage for each in batteries]),
        power_supply_status=max(each.power_supply_status for each in batteries),
        power_supply_health=max(each.power_supply_health for each in batteries),
        power_supply_technology=technologies.pop() if len(technologies) == 1 else 0,
        present=any(each.present for each in batteries),
        location=", ".join(each.location for each in batteries if each.location),
        serial_number=", ".join(each.serial_number for each in batteries if each.serial_number),
    )


def _sum(values: Sequence[float | None]) -> float | None:
    """Return the sum of what is known, None where nothing is."""
    known = [each for each in values if each is not None]
    return math.fsum(known) if known else None


def _mean(values: Sequence[float | None]) -> float | None:
    """Return the mean of what is known, None where nothing is."""
    known = [each for each in values if each is not None]
    return math.fsum(known) / len(known) if known else None
