"""The parameters of battery_state_broadcaster/BatteryStateBroadcaster.

Keys, defaults and meaning are those of ros2_controllers; `state_joints` is what `batteries` was called before.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, cast

from canopen_control.controllers.params import CommonParams
from canopen_control.errors import RobotConfigError, nearest
from canopen_control.yamlfile.convert import derived, setting

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.controllers.params import Params

__all__ = ["QUANTITIES", "Battery", "BatteryParams", "read_params"]

QUANTITIES: Final = (
    "battery_voltage",
    "battery_temperature",
    "battery_current",
    "battery_charge",
    "battery_percentage",
    "battery_power_supply_status",
    "battery_power_supply_health",
    "battery_present",
)
"""What may be measured of a battery: V, degC, A, Ah, 0 to 100, and enums of sensor_msgs/BatteryState."""
_RENAMES: Final = {"state_joints": "batteries"}


@dataclass(frozen=True)
class Battery:
    """What is known of one battery: V and Ah, an enum of sensor_msgs/BatteryState, nan and "" where nothing is."""

    minimum_voltage: float = setting(math.nan, nan=True)
    maximum_voltage: float = setting(math.nan, nan=True)
    capacity: float = setting(math.nan, nan=True)
    design_capacity: float = setting(math.nan, nan=True)
    power_supply_technology: int = setting(0, low=0, high=8)
    location: str = ""
    serial_number: str = ""


@dataclass(frozen=True)
class BatteryParams(CommonParams):
    """Parameters of the broadcaster; `interfaces` by "<battery>.battery_temperature", `own` by battery."""

    batteries: tuple[str, ...] = ()
    interfaces: dict[str, bool] = setting(key="interfaces", section=True, factory=dict)  # noqa: RUF009 - makes a field
    sensor_name: str = ""
    design_capacity: float = setting(math.nan, nan=True)
    power_supply_technology: int = setting(0, low=0, high=8)
    own: tuple[Battery, ...] = derived(())

    @property
    def names(self) -> tuple[str, ...]:
        """The batteries, also the one that is given as a sensor."""
        return (self.sensor_name,) if self.sensor_name else self.batteries

    def measured(self, battery: str) -> list[str]:
        """Return the state interface of each of QUANTITIES of a battery, "" for those that are not read."""
        if self.sensor_name:
            return [f"{battery}/voltage", *[""] * (len(QUANTITIES) - 1)]
        first, *others = QUANTITIES
        wanted = [self.interfaces.get(f"{battery}.{each}", False) for each in others]
        names = [f"{battery}/{each}" if is_wanted else "" for each, is_wanted in zip(others, wanted, strict=True)]
        return [f"{battery}/{first}", *names]

    def mistakes(self) -> Iterator[str]:
        """Yield what cannot be."""
        if bool(self.sensor_name) == bool(self.batteries):
            both = "both 'sensor_name' and 'batteries'" if self.batteries else "no 'batteries'"
            yield f"{both}; give it under ros__parameters: batteries: [main_battery]"
        if len(set(self.batteries)) != len(self.batteries):
            yield f"batteries names one twice: {', '.join(self.batteries)}; name each once"
        known = [f"{battery}.{each}" for battery in self.batteries for each in QUANTITIES[1:]]
        yield from (f"interfaces.{each}{nearest(each, known)}" for each in self.interfaces if each not in known)
        for name, each in zip(self.names, self.own, strict=True):
            if each.minimum_voltage >= each.maximum_voltage:
                yield f"{name}: minimum_voltage is {each.minimum_voltage:g}; give less than maximum_voltage"


def read_params(params: Params, name: str) -> BatteryParams:
    """Return the parameters of controller `name`; raise RobotConfigError with everything that is wrong in them."""
    nodes = [params.flat.get(key) for key in ("batteries", "state_joints")]
    batteries = tuple(dict.fromkeys(each.text for node in nodes if node is not None for each in node.elements()))
    found = params.read(_with_batteries(batteries), _RENAMES)
    own = tuple(getattr(found, f"battery_{batteries.index(each)}") for each in found.batteries)
    if found.sensor_name:
        own = (Battery(design_capacity=found.design_capacity, power_supply_technology=found.power_supply_technology),)
    given = dataclasses.replace(found, own=own)
    if mistakes := list(given.mistakes()):
        raise RobotConfigError(f"{name}: {'; '.join(mistakes)}")
    return given


def _with_batteries(batteries: tuple[str, ...]) -> type[BatteryParams]:
    """Return the class of the parameters with those of each battery, which stand below its name."""
    fields: list[tuple[str, Any, Any]] = [
        (f"battery_{index}", Battery, setting(Battery(), key=battery, section=True))
        for index, battery in enumerate(batteries)
    ]
    return cast(
        "type[BatteryParams]", dataclasses.make_dataclass("BatteryParams", fields, bases=(BatteryParams,), frozen=True)
    )
