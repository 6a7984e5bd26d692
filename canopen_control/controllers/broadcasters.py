"""Broadcasters of states other than joint states: GPIOs, diagnostics, sensors and batteries.

A broadcaster claims no command interface and publishes the states once per update. The GPIO broadcaster publishes the
configured interfaces (by default `digital_inputs` and `digital_outputs` of every drive, and all interfaces of a <gpio>
that is named under `joints`). The diagnostics evaluate each joint by its drive: without data for `stale_after` the
joint is STALE, an error code is a fault, and the rest is as in `rpc/messages/health.py`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final

from canopen_control.cia301.nmt import NmtState, state_of_byte
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.controllers.base import ALL_STATES, Controller, StateCopy, finite
from canopen_control.controllers.params import CommonParams, refuse, repeated
from canopen_control.errors import ControlError, nearest
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, OK, ReturnType
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.health import diagnose, stale
from canopen_control.rpc.messages.samples import (
    BatteriesSample,
    BatteryReading,
    DiagnosticsSample,
    GpioSample,
    ImuSample,
    JointDiagnosis,
    PoseSample,
    RangeSample,
    WrenchSample,
)
from canopen_control.yamlfile.convert import derived, section, setting

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.hardware.interfaces import CommandInterface, StateInterface
    from canopen_control.rpc.messages.health import HealthStatus
    from canopen_control.rpc.messages.samples import Sample, Values


# The parameters of battery_state_broadcaster/BatteryStateBroadcaster.
#
# Keys, defaults and meaning are those of ros2_controllers; `state_joints` is the former name of `batteries`.


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
"""Battery state interfaces, in V, degC, A, Ah and percent; the last three are values of sensor_msgs/BatteryState."""
_RENAMES: Final = {"state_joints": "batteries"}


@dataclass(frozen=True)
class BatteryFacts:
    """Fixed properties of one battery, for sensor_msgs/BatteryState.

    Unknown numbers are nan, unknown texts are empty.
    """

    minimum_voltage: float = setting(
        math.nan,
        nan=True,
        help="voltage of the empty battery in V; used to compute a percentage that the battery does not report",
    )
    maximum_voltage: float = setting(math.nan, nan=True, help="voltage of the full battery in V")
    capacity: float = setting(math.nan, nan=True, help="capacity in Ah at the last full charge")
    design_capacity: float = setting(math.nan, nan=True, help="capacity in Ah of the new battery")
    power_supply_technology: int = setting(
        0, low=0, high=8, help="chemistry of the battery, a number of sensor_msgs/BatteryState"
    )
    location: str = setting("", help="location of the battery, such as a slot")
    serial_number: str = setting("", help="serial number of the battery")


@dataclass(frozen=True)
class BatteryParams(CommonParams):
    """Parameters of battery_state_broadcaster/BatteryStateBroadcaster.

    The keys of `interfaces` are "<battery>.battery_temperature" and so on; `facts` are the properties of each
    battery, in the order of `names`.
    """

    batteries: tuple[str, ...] = setting(
        (), help="names of `<sensor>`, `<gpio>` or `<joint>` parts that have at least `battery_voltage`"
    )
    interfaces: dict[str, bool] = section(
        "interfaces",
        help="`.BATTERY.battery_temperature` and so on; true: also read that state interface (`battery_current`, "
        "`battery_charge`, `battery_percentage`, `battery_power_supply_status`, `..._health`, "
        "`battery_present`)",
    )
    sensor_name: str = setting("", help="name of a single battery, whose `voltage` is read (deprecated)")
    design_capacity: float = setting(math.nan, nan=True, help="capacity in Ah of the battery in `sensor_name`")
    power_supply_technology: int = setting(0, low=0, high=8, help="chemistry of the battery in `sensor_name`")
    facts: tuple[BatteryFacts, ...] = derived(())

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the batteries; if the deprecated `sensor_name` is given, only this name."""
        return (self.sensor_name,) if self.sensor_name else self.batteries

    def measured(self, battery: str) -> list[str]:
        """Return a battery's state interfaces in the order of `QUANTITIES`; "" marks a quantity that is not read."""
        if self.sensor_name:
            return [f"{battery}/voltage", *[""] * (len(QUANTITIES) - 1)]
        first, *others = QUANTITIES
        selected = [self.interfaces.get(f"{battery}.{other}", False) for other in others]
        names = [
            f"{battery}/{other}" if is_selected else "" for other, is_selected in zip(others, selected, strict=True)
        ]
        return [f"{battery}/{first}", *names]

    def mistakes(self) -> Iterator[str]:
        if bool(self.sensor_name) == bool(self.batteries):
            both = "both 'sensor_name' and 'batteries'" if self.batteries else "no 'batteries'"
            yield f"{both}; give only batteries under ros__parameters: batteries: [main_battery]"
        yield from repeated("batteries", self.batteries)
        interfaces = [f"{battery}.{quantity}" for battery in self.batteries for quantity in QUANTITIES[1:]]
        yield from (
            f"interfaces.{interface}{nearest(interface, interfaces)}"
            for interface in self.interfaces
            if interface not in interfaces
        )
        for name, battery in zip(self.names, self.facts, strict=True):
            if battery.minimum_voltage >= battery.maximum_voltage:
                yield f"{name}: minimum_voltage is {battery.minimum_voltage:g}; it must be below maximum_voltage"


def read_params(params: Params, name: str) -> BatteryParams:
    """Return the parameters of battery broadcaster `name`; raise RobotConfigError with all errors in them."""
    batteries = params.names("batteries", "state_joints")
    settings = params.read_each(BatteryParams, batteries, {"facts": ("{}", BatteryFacts)}, _RENAMES)
    facts = tuple(settings.facts[batteries.index(battery)] for battery in settings.batteries)
    if settings.sensor_name:
        facts = (
            BatteryFacts(
                design_capacity=settings.design_capacity, power_supply_technology=settings.power_supply_technology
            ),
        )
    result = dataclasses.replace(settings, facts=facts)
    refuse(params, result.mistakes(), name)
    return result


# The parameters of the sensor broadcasters: IMU, range, force and torque, pose.
#
# Keys, defaults and meaning are those of ros2_controllers (jazzy).


AXES: Final = ("force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z")
POSE: Final = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))
_UNKNOWN: Final = (0.0,) * 9
_COVARIANCE: Final = 9


@dataclass(frozen=True)
class SensorParams(CommonParams):
    """Common parameters of sensor broadcasters: the <sensor> of the description, and the frame id."""

    sensor_name: str = setting("", help="`<sensor>` of the description whose interfaces have the names of ros2_control")
    frame_id: str = setting("", help="frame id of the message headers")

    def mistakes(self) -> Iterator[str]:
        if not self.sensor_name:
            yield "no 'sensor_name'; give it under ros__parameters: sensor_name: imu"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: imu_link"


@dataclass(frozen=True)
class ImuParams(SensorParams):
    """Parameters of imu_sensor_broadcaster/IMUSensorBroadcaster.

    Each covariance has nine numbers, row by row about x, y and z.
    """

    static_covariance_orientation: tuple[float, ...] = setting(
        _UNKNOWN, help="covariance of the orientation: nine numbers, row by row about x, y, z; all 0: unknown"
    )
    static_covariance_angular_velocity: tuple[float, ...] = setting(
        _UNKNOWN,
        help="covariance of the angular velocity: nine numbers, row by row about x, y, z; first number -1: not "
        "measured",
    )
    static_covariance_linear_acceleration: tuple[float, ...] = setting(
        _UNKNOWN, help="covariance of the linear acceleration: nine numbers, row by row about x, y, z"
    )

    def mistakes(self) -> Iterator[str]:
        yield from super().mistakes()
        for quantity in ("orientation", "angular_velocity", "linear_acceleration"):
            covariance = getattr(self, f"static_covariance_{quantity}")
            if len(covariance) != _COVARIANCE or not all(map(math.isfinite, covariance)):
                yield f"static_covariance_{quantity} has {len(covariance)} numbers; give nine finite ones, row by row"


@dataclass(frozen=True)
class RangeParams(SensorParams):
    """Parameters of range_sensor_broadcaster/RangeSensorBroadcaster; units are rad, m and m^2."""

    radiation_type: int = setting(0, low=0, high=1, help="0: ultrasound, 1: infrared")
    field_of_view: float = setting(
        0.52, low=0.0, high=2 * math.pi, help="angle in rad within which objects are measured"
    )
    min_range: float = setting(0.52, help="smallest measured distance in m")
    max_range: float = setting(4.0, help="largest measured distance in m")
    variance: float = setting(0.0, low=0.0, high=1e9, help="variance of the distance in m^2; 0: unknown")


@dataclass(frozen=True)
class ForceTorqueParams(SensorParams):
    """Parameters of force_torque_sensor_broadcaster/ForceTorqueSensorBroadcaster.

    The state interfaces are those of `sensor_name`, or are listed one by one in `interface_names`; unlisted axes have
    no value. Forces in N and torques in Nm are published as (value + offset) * multiplier.
    """

    interface_names: dict[str, str] = section(
        "interface_names",
        help="`.force.x` to `.torque.z`: full names of state interfaces, instead of `sensor_name`",
    )
    offset: dict[str, float] = section(
        "offset",
        help="`.force.x` to `.torque.z`: offset in N or Nm, added to the value",
    )
    multiplier: dict[str, float] = section(
        "multiplier",
        help="`.force.x` to `.torque.z`: factor, applied after the offset; absent: 1.0",
    )

    @property
    def names(self) -> list[str]:
        """State interfaces of the six axes, in the order of `AXES`; "" marks an axis without an interface."""
        if self.sensor_name:
            return [f"{self.sensor_name}/{axis}" for axis in AXES]
        return [self.interface_names.get(axis, "") for axis in AXES]

    def mistakes(self) -> Iterator[str]:
        named = any(self.interface_names.values())
        if bool(self.sensor_name) == named:
            both = "both 'sensor_name' and interface_names" if named else "neither 'sensor_name' nor interface_names"
            yield f"{both}; give sensor_name for all six, or some of interface_names.force.x to torque.z"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: tool0"
        for key, covariance in (
            ("interface_names", self.interface_names),
            ("offset", self.offset),
            ("multiplier", self.multiplier),
        ):
            yield from (f"{key}.{axis}{nearest(axis, AXES)}" for axis in covariance if axis not in AXES)
        for key, numbers in (("offset", self.offset), ("multiplier", self.multiplier)):
            yield from (f"{key}.{axis} is {number}; give a finite number" for axis, number in numbers.items()
                        if not math.isfinite(number))  # fmt: skip


@dataclass(frozen=True)
class PoseTransform:
    """Parameters of the transform that a pose broadcaster publishes: an enable flag and the child frame."""

    enable: bool = setting(True, help="whether to publish the pose as a transform on `/tf` too")
    child_frame_id: str = setting("", help="child frame of the transform; empty: `pose_name`")
    publish_rate: float = setting(0.0, low=0.0, help="has no effect: the transform is published at every update")


@dataclass(frozen=True)
class PoseParams(CommonParams):
    """Parameters of pose_broadcaster/PoseBroadcaster.

    The state interfaces are those of `pose_name`, or are listed one by one in `interface_names`.
    """

    frame_id: str = setting("", help="frame in which the pose is given")
    pose_name: str = setting("", help="`<sensor>` of the description with `position.x` to `orientation.w`")
    interface_names: dict[str, str] = section(
        "interface_names",
        help="`.position.x` to `.orientation.w`: full names of state interfaces, instead of `pose_name`",
    )
    tf: PoseTransform = section("tf", PoseTransform())

    @property
    def names(self) -> list[str]:
        """The seven state interfaces of the pose, in the order of `POSE`."""
        if self.pose_name:
            return [f"{self.pose_name}/{key}" for key in POSE]
        return [self.interface_names[key] for key in POSE]

    @property
    def child_frame_id(self) -> str | None:
        """Child frame of the published transform; None if no transform is published."""
        return (self.tf.child_frame_id or self.pose_name or None) if self.tf.enable else None

    def mistakes(self) -> Iterator[str]:
        named = any(self.interface_names.values())
        if bool(self.pose_name) == named:
            both = "both 'pose_name' and interface_names" if named else "neither 'pose_name' nor interface_names"
            yield f"{both}; give pose_name for all seven, or interface_names.position.x to orientation.w"
        elif named and (missing := [key for key in POSE if not self.interface_names.get(key)]):
            yield f"interface_names.{missing[0]} is missing; a pose needs position.x to orientation.w"
        if not self.frame_id:
            yield "no 'frame_id'; give it under ros__parameters: frame_id: map"
        yield from (f"interface_names.{name}{nearest(name, POSE)}" for name in self.interface_names if name not in POSE)


# Sensor broadcasters: IMU, range, force and torque, pose; they read the state interfaces of a <sensor> of any hardware.
#
# Rules (ros2_controllers, Jazzy): the names of the interfaces are fixed (`orientation.x`, `range`, `force.x` ...), and
# a broadcaster is activated only if all the interfaces that it reads exist; a force-torque broadcaster whose interfaces
# are named one by one publishes nan for the others. A published value is the state at the update, nan if the hardware
# has none.


_IMU: Final = (
    *(f"orientation.{axis}" for axis in "xyzw"),
    *(f"angular_velocity.{axis}" for axis in "xyz"),
    *(f"linear_acceleration.{axis}" for axis in "xyz"),
)


class SensorBroadcaster(Controller):
    """Base class of broadcasters that read a fixed list of state interfaces; "" marks a missing interface."""

    is_broadcaster: ClassVar[bool] = True

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = self.reads()
        self._names: list[str] = []
        self._sources: list[tuple[int, StateInterface]] = []
        self._values: list[float] = []

    def state_interface_names(self) -> list[str]:
        return [name for name in self._names if name]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        by_name = {state.name: state for state in states}
        self._values = [math.nan] * len(self._names)
        self._sources = [(place, by_name[name]) for place, name in enumerate(self._names) if name]
        self.update(now, 0.0)

    def update(self, now: int, period: float) -> ReturnType:
        del period
        for place, source in self._sources:
            self._values[place] = source.value
        self.stamp = now
        return OK

    def _set_up(self, params: SensorParams | PoseParams, names: list[str]) -> None:
        refuse(self.name, params.mistakes())
        self.update_rate, self.frame_id, self._names = params.update_rate, params.frame_id, names

    def _finite(self, first: int, last: int) -> tuple[float | None, ...]:
        """Return values `first` to `last` - 1 of the last update; None for values that are not finite."""
        return tuple(finite(value) for value in self._values[first:last])


class IMUSensorBroadcaster(SensorBroadcaster):
    """Broadcaster of the orientation, angular velocity and linear acceleration of an IMU."""

    title: ClassVar[str] = "IMU"
    reads: ClassVar[type[ImuParams]] = ImuParams
    sample_type: ClassVar[type[Sample] | None] = ImuSample
    params: ImuParams

    def on_configure(self, params: Params) -> None:
        self.params = params.read(ImuParams)
        self._set_up(self.params, [f"{self.params.sensor_name}/{quantity}" for quantity in _IMU])

    def sample(self, wall_offset_ns: int) -> ImuSample:
        params = self.params
        return ImuSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            orientation=self._finite(0, 4),
            angular_velocity=self._finite(4, 7),
            linear_acceleration=self._finite(7, 10),
            orientation_covariance=list(params.static_covariance_orientation),
            angular_velocity_covariance=list(params.static_covariance_angular_velocity),
            linear_acceleration_covariance=list(params.static_covariance_linear_acceleration),
        )


class RangeSensorBroadcaster(SensorBroadcaster):
    """Broadcaster of the distance that one range sensor measures."""

    title: ClassVar[str] = "Range sensor"
    reads: ClassVar[type[RangeParams]] = RangeParams
    sample_type: ClassVar[type[Sample] | None] = RangeSample
    params: RangeParams

    def on_configure(self, params: Params) -> None:
        self.params = params.read(RangeParams)
        self._set_up(self.params, [f"{self.params.sensor_name}/range"])

    def sample(self, wall_offset_ns: int) -> RangeSample:
        params = self.params
        return RangeSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            range=finite(self._values[0]),
            radiation_type=params.radiation_type,
            field_of_view=params.field_of_view,
            min_range=params.min_range,
            max_range=params.max_range,
            variance=params.variance,
        )


class ForceTorqueSensorBroadcaster(SensorBroadcaster):
    """Broadcaster of the forces along three axes and the torques about them."""

    title: ClassVar[str] = "Force and torque"
    reads: ClassVar[type[ForceTorqueParams]] = ForceTorqueParams
    sample_type: ClassVar[type[Sample] | None] = WrenchSample

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self._scales: list[tuple[float, float]] = []

    def on_configure(self, params: Params) -> None:
        settings = params.read(ForceTorqueParams)
        self._set_up(settings, settings.names)
        self._scales = [(settings.offset.get(axis, 0.0), settings.multiplier.get(axis, 1.0)) for axis in AXES]

    def update(self, now: int, period: float) -> ReturnType:
        super().update(now, period)
        for place, source in self._sources:
            offset, factor = self._scales[place]
            self._values[place] = (source.value + offset) * factor
        return OK

    def sample(self, wall_offset_ns: int) -> WrenchSample:
        return WrenchSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            force=self._finite(0, 3),
            torque=self._finite(3, 6),
        )


class PoseBroadcaster(SensorBroadcaster):
    """Broadcaster of a pose, and optionally of its transform."""

    title: ClassVar[str] = "Pose"
    reads: ClassVar[type[PoseParams]] = PoseParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Transform: `tf.KEY`": PoseTransform,
    }
    sample_type: ClassVar[type[Sample] | None] = PoseSample
    params: PoseParams

    def on_configure(self, params: Params) -> None:
        self.params = settings = params.read(PoseParams)
        refuse(params, settings.mistakes(), self.name)  # before `names`, which need all keys
        self._set_up(settings, settings.names)
        if settings.tf.publish_rate:
            self.report(
                "parameter",
                "tf.publish_rate has no effect: the transform is published at every update; set update_rate",
            )

    def sample(self, wall_offset_ns: int) -> PoseSample:
        return PoseSample(
            time=self.published(wall_offset_ns),
            frame_id=self.frame_id,
            position=self._finite(0, 3),
            orientation=self._finite(3, 7),
            child_frame_id=self.params.child_frame_id,
        )


# BatteryStateBroadcaster: the state of each battery of a robot, and of all batteries combined.
#
# Rules (battery_state_broadcaster): the voltage of each battery is read, and the quantities enabled in `interfaces`.
# A percentage that is not measured is interpolated from the voltage between `minimum_voltage` and `maximum_voltage`;
# without a `battery_present` state, a battery with a voltage is present. For all batteries combined, voltage, current,
# temperature and percentage are the mean of the known values, charge and capacities the sum, status and health the
# highest. Difference from upstream: a percentage is published from 0 to 1, as sensor_msgs defines it, not 0 to 100.


class BatteryStateBroadcaster(SensorBroadcaster):
    """Broadcaster of the state of each battery, and of all batteries combined."""

    title: ClassVar[str] = "Batteries"
    reads: ClassVar[type[BatteryParams]] = BatteryParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Each battery: `BATTERY.KEY`": BatteryFacts,
    }
    sample_type: ClassVar[type[Sample] | None] = BatteriesSample
    params: BatteryParams

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_params(params, self.name)
        self.update_rate = settings.update_rate
        self._names = [name for battery in settings.names for name in settings.measured(battery)]

    def sample(self, wall_offset_ns: int) -> BatteriesSample:
        size = len(QUANTITIES)
        batteries = [
            _reading(name, facts, self._finite(place * size, (place + 1) * size))
            for place, (name, facts) in enumerate(zip(self.params.names, self.params.facts, strict=True))
        ]
        return BatteriesSample(time=self.published(wall_offset_ns), batteries=batteries, together=_together(batteries))


def _reading(name: str, facts: BatteryFacts, values: Sequence[float | None]) -> BatteryReading:
    """Return the state of one battery; `values` are in the order of `QUANTITIES`."""
    voltage, temperature, current, charge, percentage, status, health, present = values
    if percentage is None and voltage is not None:  # the result is nan without voltage bounds
        percentage = finite(100.0 * (voltage - facts.minimum_voltage) / (facts.maximum_voltage - facts.minimum_voltage))
    return BatteryReading(
        name=name,
        voltage=voltage,
        temperature=temperature,
        current=current,
        charge=charge,
        capacity=finite(facts.capacity),
        design_capacity=finite(facts.design_capacity),
        percentage=None if percentage is None else percentage / 100.0,
        power_supply_status=int(status or 0),
        power_supply_health=int(health or 0),
        power_supply_technology=facts.power_supply_technology,
        present=bool(voltage) if present is None else bool(present),
        location=facts.location,
        serial_number=facts.serial_number,
    )


def _together(batteries: Sequence[BatteryReading]) -> BatteryReading:
    technologies = {battery.power_supply_technology for battery in batteries}
    return BatteryReading(
        name="",
        voltage=_mean([battery.voltage for battery in batteries]),
        temperature=_mean([battery.temperature for battery in batteries]),
        current=_mean([battery.current for battery in batteries]),
        charge=_sum([battery.charge for battery in batteries]),
        capacity=_sum([battery.capacity for battery in batteries]),
        design_capacity=_sum([battery.design_capacity for battery in batteries]),
        percentage=_mean([battery.percentage for battery in batteries]),
        power_supply_status=max(battery.power_supply_status for battery in batteries),
        power_supply_health=max(battery.power_supply_health for battery in batteries),
        power_supply_technology=technologies.pop() if len(technologies) == 1 else 0,
        present=any(battery.present for battery in batteries),
        location=", ".join(battery.location for battery in batteries if battery.location),
        serial_number=", ".join(battery.serial_number for battery in batteries if battery.serial_number),
    )


def _sum(values: Sequence[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return math.fsum(numbers) if numbers else None


def _mean(values: Sequence[float | None]) -> float | None:
    numbers = [value for value in values if value is not None]
    return math.fsum(numbers) / len(numbers) if numbers else None


@dataclass(frozen=True)
class StateParams(CommonParams):
    """Parameters of the GPIO and diagnostics broadcasters; `stale_after` is in s.

    An empty `joints` selects all joints. An empty `interfaces` selects all interfaces of the listed joints, or, if no
    joints are listed, the default interfaces of the broadcaster.
    """

    joints: tuple[str, ...] = setting((), help="publish only these joints; empty: all")
    interfaces: tuple[str, ...] = setting(
        (), help="publish only these interfaces; empty: the default interfaces of the broadcaster"
    )
    stale_after: float = setting(
        0.5, low=0.001, help="time in s without new values after which a joint is reported as STALE"
    )


class _StateBroadcaster(Controller):
    """Base class of broadcasters that publish selected state interfaces, by default those in `chosen`."""

    title: ClassVar[str] = "GPIO and diagnostics"
    reads: ClassVar[type[StateParams]] = StateParams
    is_broadcaster: ClassVar[bool] = True
    chosen: tuple[str, ...] = ()

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = StateParams()
        self._copy = StateCopy({})

    def on_configure(self, params: Params) -> None:
        self.params = params.read(StateParams)
        self.update_rate = self.params.update_rate

    def state_interface_names(self) -> list[str]:
        if self.params.joints and self.params.interfaces:
            return [f"{joint}/{interface}" for joint in self.params.joints for interface in self.params.interfaces]
        return [ALL_STATES]

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        layout: dict[str, dict[str, StateInterface | None]] = {}
        for state in filter(self._is_selected, states):
            layout.setdefault(state.joint, {})[state.interface] = state
        if not layout:
            kinds = ", ".join(self.params.interfaces or self.chosen) or "any interface"
            raise ControlError(
                f"{self.name}: no joint has a state interface of {kinds}; list others under `interfaces`"
            )
        self._copy, self.joints = StateCopy(layout), tuple(layout)
        self.stamp = now

    def _is_selected(self, state: StateInterface) -> bool:
        joints, interfaces = self.params.joints, self.params.interfaces
        if joints and state.joint not in joints:
            return False
        return state.interface in (interfaces or self.chosen) or bool(joints and not interfaces)

    def update(self, now: int, period: float) -> ReturnType:
        del period
        self._copy.refresh()
        self.stamp = now
        return ReturnType.OK


class GpioBroadcaster(_StateBroadcaster):
    """Broadcaster of the inputs and outputs of drives and of <gpio> parts."""

    chosen = ("digital_inputs", DIGITAL_OUTPUTS)
    sample_type: ClassVar[type[Sample] | None] = GpioSample

    def sample(self, wall_offset_ns: int) -> GpioSample:
        return GpioSample(time=self.published(wall_offset_ns), parts=self._copy.by_joint())


class DiagnosticsBroadcaster(_StateBroadcaster):
    """Broadcaster of the health of the drives behind the joints."""

    chosen = ("nmt_state", "statusword", "error_code", "age")

    sample_type: ClassVar[type[Sample] | None] = DiagnosticsSample

    def sample(self, wall_offset_ns: int) -> DiagnosticsSample:
        judged = [
            JointDiagnosis(joint, *self._diagnose(values), values) for joint, values in self._copy.by_joint().items()
        ]
        return DiagnosticsSample(time=self.published(wall_offset_ns), joints=judged)

    def _diagnose(self, values: Values) -> HealthStatus:
        age, code, nmt, word = (values.get(key) for key in ("age", "error_code", "nmt_state", "statusword"))
        has_values = any(value is not None for value in values.values())
        if (diagnosis := stale(age, self.params.stale_after, is_known=has_values)) is not None:
            return diagnosis
        state = None if word is None else decode_statusword(int(word))
        name = State.FAULT.name if code else "" if state is None else state.name
        nmt_state = NmtState.OPERATIONAL if nmt is None else state_of_byte(int(nmt))
        return diagnose(
            [name] if name else [],
            ready=nmt_state is NmtState.OPERATIONAL,
            nmt=f"{nmt:g}" if nmt_state is None else nmt_state.text,
            error=f"error code {FaultEvent(error_code=int(code)).code_text}" if code else None,
        )
