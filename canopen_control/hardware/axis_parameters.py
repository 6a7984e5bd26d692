"""Drive parameters that are read by SDO after each boot: modes, limits, units and homing methods.

Only objects in the EDS are read; an abort means that the drive does not have the object. The axis is `loaded` when all
uploads have ended, and is not enabled before. Units of the drive (0x608F, 0x6091, 0x6092) are used only if bus.yml
defines no scale.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import (
    INTERFACE_MODES,
    TARGET_OBJECTS,
    OperationMode,
    mode_for_interface,
    mode_name,
    mode_of,
    mode_words,
    supported_modes,
)
from canopen_control.cia402.motors import MODES, motors_of
from canopen_control.cia402.objects import axis_index
from canopen_control.cia402.units import INT32_MAX, INT32_MIN, Scale, counts_per_revolution, is_feed
from canopen_control.errors import ConfigError, DriveError, RobotConfigError, SdoAbort
from canopen_control.hardware.axis import TORQUE_MAX, position_span
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS, MOTION_INTERFACES, TARGET
from canopen_control.hardware.tracking import FEED_FORWARD
from canopen_control.master.keys import SCALES
from canopen_control.od.codec import decode, encode
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY, InterfaceInfo

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import UnitKeys
    from canopen_control.master.plan import NodePlan
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.urdf.ros2_control import ControlJoint, Ros2ControlSystem


# Choice of the mode of operation for a command interface (0x6502, CiA 402-2).
#
# A mode in bus.yml is used as it is; else the best mode that the drive lists (0x6502) and whose target is in an RPDO,
# cyclic modes before profile modes. A mode that cannot be used is refused before anything is sent.


_ASSUMED: Final = (OperationMode.PP, OperationMode.IP, OperationMode.PV, OperationMode.VL, OperationMode.TQ)
"""Modes assumed for a drive without 0x6502 (optional): the modes that are older than the cyclic modes."""

_SERVED: Final = {
    POSITION: (*INTERFACE_MODES[POSITION], OperationMode.IP),
    VELOCITY: (*INTERFACE_MODES[VELOCITY], OperationMode.VL),
    EFFORT: INTERFACE_MODES[EFFORT],
    TARGET: (
        OperationMode.PP,
        OperationMode.PV,
        OperationMode.VL,
        OperationMode.CSP,
        OperationMode.CSV,
        OperationMode.IP,
        OperationMode.TQ,
        OperationMode.CST,
    ),
}
"""Possible modes of each command interface, best mode first.

A TARGET accepts every mode with a target; the modes in which the drive computes the ramp come first.
"""


def listed_modes(axis: AxisProcessData, parameters: AxisParameters) -> tuple[int, ...]:
    """Return the modes in 0x6502 and bus.yml; () if 0x6502 is missing or empty.

    Some drives have modes that 0x6502 does not list (Technosoft iPOS: CSP; roboticslab-uc3m/yarp-devices, issue 222).
    """
    listed = _of_drive(axis, parameters)
    return (*listed, *(mode for mode in _of_file(axis) if mode not in listed)) if listed else ()


def unlisted_modes(axis: AxisProcessData, parameters: AxisParameters) -> list[str]:
    """Return warnings about a missing 0x6502, or about modes in bus.yml that 0x6502 does not list."""
    listed = _of_drive(axis, parameters)
    if not listed and not _of_file(axis):
        return [
            "neither the drive nor its EDS lists modes in 0x6502, so the profile modes PV, PP and TQ are tried; "
            "give velocity_mode, position_mode or effort_mode in bus.yml"
        ]
    named = ", ".join(mode.name for mode in listed)
    return [
        f"0x6502 lists {named} but not {mode_name(mode)}, which bus.yml selects and is tried anyway"
        for mode in _of_file(axis)
        if listed and mode not in listed and mode >= 0
    ]


def _of_file(axis: AxisProcessData) -> list[int]:
    keys = axis.node.config.motion
    modes = (keys.position_mode, keys.velocity_mode, keys.effort_mode)
    return [mode_of(mode) for mode in modes if mode is not None]


def _of_drive(axis: AxisProcessData, parameters: AxisParameters) -> tuple[OperationMode, ...]:
    """Return the modes in the drive's 0x6502, else in the EDS; () if both are missing.

    The value 0 is ignored: every drive has a mode, and manufacturers also write 0 for "no value".
    """
    identity, in_eds = axis.node.identity, axis.node.od.number(axis.index(objects.SUPPORTED_DRIVE_MODES))
    at_boot = identity.supported_modes if identity is not None and len(axis.node.plan.axes) == 1 else None
    return supported_modes(parameters.get(objects.SUPPORTED_DRIVE_MODES) or at_boot or in_eds or 0)


def choose_mode(axis: AxisProcessData, parameters: AxisParameters, interface: str) -> int:
    """Return the mode for a command interface; raise DriveError if no suitable mode has its target in an RPDO."""
    config = axis.node.config
    keys = config.motion
    modes = {POSITION: keys.position_mode, VELOCITY: keys.velocity_mode, EFFORT: keys.effort_mode}
    modes[TARGET] = next((mode for mode in modes.values() if mode is not None), None)
    choices = modes[interface]
    listed = listed_modes(axis, parameters)
    if choices is not None:
        require_mapped(axis, choices)
        return mode_of(choices)
    candidates = [mode for mode in _SERVED[interface] if mode in listed or (not listed and mode in _ASSUMED)]
    for mode in candidates:
        if _is_mapped(axis, mode):
            return mode
    for mode in candidates[:1]:
        require_mapped(axis, mode)
    return mode_for_interface(POSITION if interface == TARGET else interface, listed)


def leading_interface(axis: AxisProcessData, parameters: AxisParameters, interfaces: Collection[str]) -> str:
    """Return the interface that selects the mode: the only interface, or position with feed-forward.

    In CSP a position can be commanded together with velocity and effort, if their offset objects are in RPDOs. Raise
    DriveError for any other combination.
    """
    if len(interfaces) == 1:
        return next(iter(interfaces))
    node, names = axis.node, " and ".join(interfaces)
    if POSITION not in interfaces:
        raise DriveError(f"joint {axis.joint}: {names} cannot be commanded together")
    # CiA 402-2, mode CSP: 0x60B1 and 0x60B2 are added to the demands of the velocity and torque loops
    if (mode := choose_mode(axis, parameters, POSITION)) is not OperationMode.CSP:
        raise DriveError(
            f"joint {axis.joint}: {names} can be commanded together only in mode CSP, but position is "
            f"commanded in {mode_name(mode)}; set position_mode: 8 for {node.name} in bus.yml, or command the "
            "position alone"
        )
    outputs = {VELOCITY: axis.velocity_offset, EFFORT: axis.torque_offset}
    for interface in interfaces:
        if interface != POSITION and outputs.get(interface) is None:
            index = objects.VELOCITY_OFFSET if interface == VELOCITY else objects.TORQUE_OFFSET
            raise DriveError(
                f"joint {axis.joint}: {names} can be commanded together only if an RPDO contains "
                f"0x{axis.index(index):04X}; set feed_forward: [{interface}] for {node.name} in bus.yml, or "
                "command the position alone"
            )
    return POSITION


def serving_objects(interface: str) -> tuple[tuple[int, int], ...]:
    """Return the target objects (axis 0) of all modes that can serve a command interface."""
    return tuple(TARGET_OBJECTS[mode] for mode in _SERVED[interface])


def require_targets(axis: AxisProcessData, interfaces: Collection[str]) -> None:
    """Raise RobotConfigError for an unknown command interface, or one without a target in an RPDO."""
    for name in interfaces:
        if name == DIGITAL_OUTPUTS:
            if axis.digital_outputs is None:
                raise _unmapped(axis, name, "0x60FE:01")
        elif name == TARGET or (name in FEED_FORWARD and POSITION in interfaces and _feeds(axis, name)):
            continue  # a drive without a robot may only be observed; enabling it reports the missing object
        elif name not in _SERVED:
            known = ", ".join((*MOTION_INTERFACES, DIGITAL_OUTPUTS))
            raise RobotConfigError(f"joint {axis.joint}: no command interface {name!r}; available: {known}")
        elif not any(_is_mapped(axis, mode) for mode in _served(axis, name)):
            index, _ = axis.target_objects[_served(axis, name)[0]]
            place = f"0x{axis.index(index):04X}"
            if name in FEED_FORWARD and POSITION in interfaces:
                place += f", or set feed_forward: [{name}] for use with its position,"
            raise _unmapped(axis, name, place)


def _feeds(axis: AxisProcessData, interface: str) -> bool:
    return (axis.velocity_offset if interface == VELOCITY else axis.torque_offset) is not None


def _served(axis: AxisProcessData, interface: str) -> tuple[int, ...]:
    """Return the modes that can serve a command interface; modes whose target is set in bus.yml come first."""
    preferred = [mode for mode, name in axis.own_modes.items() if name == interface]
    return (*preferred, *(mode for mode in _SERVED[interface] if mode not in preferred and _starts_alone(axis, mode)))


def _starts_alone(axis: AxisProcessData, mode: int) -> bool:
    """Whether a mode cannot start another motor: it needs no start bits, or has a controlword of its own."""
    return axis.node.plan.motors is None or mode in MODES


def require_own_start(axis: AxisProcessData, mode: int) -> None:
    """Raise DriveError if the start bits of a mode would move all motors that share the controlword."""
    if not _starts_alone(axis, mode):
        possible = ", ".join(map(mode_name, MODES))
        raise DriveError(
            f"{axis.label}: {mode_words(mode)} starts motions by bits of the controlword, which all motors share; "
            f"modes without such bits are {possible}"
        )


def has_target(axis: AxisProcessData) -> bool:
    """Whether an RPDO contains the target of any mode that can serve a TARGET."""
    return any(_is_mapped(axis, mode) for mode in (*axis.own_modes, *_SERVED[TARGET]))


def _is_mapped(axis: AxisProcessData, mode: int) -> bool:
    address = axis.target_objects.get(mode)
    return address is not None and axis.output(*address) is not None


def require_mapped(axis: AxisProcessData, mode: int) -> None:
    """Raise DriveError unless an RPDO contains the target object of a mode."""
    if not _is_mapped(axis, mode):
        index, subindex = axis.target_objects.get(mode, (0, 0))
        raise DriveError(
            f"{axis.node.label}: no RPDO carries 0x{axis.index(index):04X}:{subindex:02X}, "
            f"the target of {mode_words(mode)}; map it in bus.yml"
        )


def _unmapped(axis: AxisProcessData, interface: str, title: str) -> RobotConfigError:
    advice = f"map {title} in bus.yml, or remove the interface"
    if motors_of(axis.node.od) is not None:
        advice = "its targets have one subindex per motor, so set `motor_subindices: [1, 2]` in bus.yml"
    return RobotConfigError(
        f"joint {axis.joint}: no RPDO of {axis.node.name} carries the target of its command interface {interface!r}; "
        f"{advice}"
    )


# Command interfaces that ros2_canopen's hardware plugins export although the description does not list them.
#
# Rules (canopen_ros2_control): Cia402System and RobotSystem create the interfaces of a joint by themselves, so that
# their descriptions often list none. A joint in such a tag without any command interface gets those of position,
# velocity and effort for which an RPDO of its node contains a target; a joint that lists command interfaces is not
# changed.


PLUGINS: Final = (
    "canopen_ros2_control/Cia402System",
    "canopen_ros2_control/RobotSystem",
    "canopen_ros2_control/Cia402RobotSystem",
)


def add_plugin_interfaces(description: UrdfDescription, plans: Iterable[NodePlan]) -> UrdfDescription:
    """Return the description with the command interfaces that ros2_canopen's plugins would export."""
    by_name = {plan.name: plan for plan in plans}
    hardware = tuple(_completed(tag, by_name) for tag in description.hardware)
    before = {joint.name: joint for tag in description.hardware for joint in tag.joints}
    notes = [
        f"{description.path}:{joint.place.line}: {joint.name} lists no command interface and gets those of "
        f"{tag.plugin}: {', '.join(joint.command_interfaces)}"
        for tag in hardware
        for joint in tag.joints
        if joint is not before[joint.name]
    ]
    return replace(description, hardware=hardware, notes=(*description.notes, *notes)) if notes else description


def _completed(tag: Ros2ControlSystem, plans: Mapping[str, NodePlan]) -> Ros2ControlSystem:
    if tag.plugin not in PLUGINS:
        return tag
    return replace(tag, joints=tuple(_joint(joint, plans) for joint in tag.joints))


def _joint(joint: ControlJoint, plans: Mapping[str, NodePlan]) -> ControlJoint:
    """Add to a joint without command interfaces those that its node can serve."""
    name, node_id = joint.parameters.get("device_name"), joint.parameters.get("node_id", "").strip()
    plan = plans.get(name or "") or next((plan for plan in plans.values() if str(plan.node_id) == node_id), None)
    axis = joint.parameters.get("axis", joint.parameters.get("channel", "0")).strip()
    if joint.command_interfaces or joint.mimic is not None or plan is None or not axis.isdigit():
        return joint
    mapped = {(entry.index, entry.subindex) for pdo in plan.rpdos for entry in pdo.objects}
    carried = [
        interface
        for interface in MOTION_INTERFACES
        if any((axis_index(index, int(axis)), subindex) in mapped for index, subindex in serving_objects(interface))
    ]
    return replace(joint, command_interfaces={name: InterfaceInfo(name) for name in carried}) if carried else joint


_OBJECTS: Final = (
    (objects.SUPPORTED_DRIVE_MODES, (0,)),
    (objects.SOFTWARE_POSITION_LIMIT, (1, 2)),
    (objects.POSITION_RANGE_LIMIT, (1, 2)),
    (objects.MAX_PROFILE_VELOCITY, (0,)),
    (objects.MAX_MOTOR_SPEED, (0,)),
    (objects.PROFILE_DECELERATION, (0,)),
    (objects.QUICK_STOP_DECELERATION, (0,)),
    (objects.QUICK_STOP_OPTION, (0,)),
    (objects.POSITIVE_TORQUE_LIMIT, (0,)),
    (objects.NEGATIVE_TORQUE_LIMIT, (0,)),
    (objects.POSITION_ENCODER_RESOLUTION, (1, 2)),
    (objects.GEAR_RATIO, (1, 2)),
    (objects.FEED_CONSTANT, (1, 2)),
    (objects.SUPPORTED_HOMING_METHODS, tuple(range(1, 40))),
    (objects.INTERPOLATION_BUFFER, (6,)),
)
_PROFILE: Final = ((objects.PROFILE_VELOCITY, (0,)), (objects.PROFILE_ACCELERATION, (0,)))
_HOMING_SPEEDS: Final = (1, 2)  # speed during search for the switch, and for the zero
_UNLIMITED: Final = 0xFFFFFFFF
_SLOWEST_S: Final = 60.0  # duration of a ramp, as in `check`


Pair = tuple[int, int] | None
_UNITS: Final = (objects.POSITION_ENCODER_RESOLUTION, objects.GEAR_RATIO, objects.FEED_CONSTANT)


def planned_scales(config: BusConfig, name: str, axis: int) -> dict[str, float]:
    """Return the scales that an axis of a node will have: those of bus.yml, else from the units of plan and EDS."""
    plan, od = config.plans[name], config.dictionaries[name]
    written = {(write.index, write.subindex): write.data for write in plan.writes}

    def value(index: int, subindex: int) -> int | None:
        data, entry = written.get((index, subindex)), od.get(index, subindex)
        number = int.from_bytes(data, "little") if data is not None else entry and entry.value
        return number if isinstance(number, int) else None

    indices = [axis_index(index, axis) for index in _UNITS]
    counts = _counts_per_turn(*(_pair(value(index, 1), value(index, 2)) for index in indices))
    return _scales(config.nodes[name].units, axis, counts)


def _pair(first: int | None, second: int | None) -> Pair:
    return (first, second) if first and second and first > 0 and second > 0 else None


def _counts_per_turn(encoder: Pair, gear: Pair, feed: Pair) -> float | None:
    # CiA 402-2: 0x608F, 0x6091 and 0x6092 are optional
    if encoder is None and feed is None:
        return None
    try:
        # Drives without user units have a feed constant of one unit per revolution, which is ignored.
        return counts_per_revolution(encoder or (1, 1), gear or (1, 1), feed if feed not in (None, (1, 1)) else None)
    except ConfigError:
        return None


def _scales(units: UnitKeys, axis: int, counts: float | None) -> dict[str, float]:
    """Return the scales of bus.yml, or if it gives none, those of `counts` per turn, if known."""
    if counts is None or units.gives(axis, *SCALES):
        return units.of_axis(axis)
    return units.with_scale(counts / math.tau).of_axis(axis)


class AxisParameters:
    """Parameters of one axis; `failed` lists the objects that could not be read.

    With `is_profile_target` the objects of the drive's own ramp (0x6081, 0x6083) are read too. `report` receives later
    findings, as sentences.
    """

    def __init__(
        self,
        axis: AxisProcessData,
        on_loaded: Callable[[], None],
        report: Callable[[str], None] = lambda _text: None,
        *,
        is_profile_target: bool = False,
    ) -> None:
        self._objects = _OBJECTS + _PROFILE if is_profile_target else _OBJECTS
        self.loaded = False
        self.failed: list[str] = []
        self.values: dict[tuple[int, int], int] = {}
        self._axis, self._on_loaded, self._report = axis, on_loaded, report
        self._open = 0
        self._round = self._bounded_round = 0

    def load(self) -> None:
        """Start reading the parameters after a boot of the drive."""
        axis = self._axis
        self.loaded, self.failed = False, []
        self._round += 1
        axis.limits.ramp_unbounded = axis.limits.described < math.inf
        addresses = [(index, sub) for index, subs in self._objects for sub in subs if axis.has(index, sub)]
        self._open = len(addresses)
        for index, subindex in addresses:
            axis.node.read(axis.index(index), subindex, self._answer(index, subindex, self._round))
        if not addresses:
            self._finish()

    def forget(self) -> None:
        """Discard the parameters of a lost drive, and ignore pending SDO responses."""
        self.loaded = False
        self._round += 1

    def get(self, index: int, subindex: int = 0) -> int | None:
        """Return the value of an object (index of axis 0), or None if the drive does not have the object."""
        return self.values.get((index, subindex))

    @property
    def homing_methods(self) -> frozenset[int] | None:
        """Homing methods in the drive's 0x60E3, or None if 0x60E3 is missing."""
        listed = [value for (index, _), value in self.values.items() if index == objects.SUPPORTED_HOMING_METHODS]
        return frozenset(listed) if listed else None

    def bound_ramp(self) -> None:
        """Reduce the profile velocity 0x6081 of PP to the velocity limit, once per `load`.

        No set-point is sent before this has ended.
        """
        axis, number = self._axis, self._round
        if not self.loaded or not axis.limits.ramp_unbounded or self._bounded_round == number:
            return
        self._bounded_round = number

        def report(_bounded: bool, text: str) -> None:
            if number == self._round:
                axis.limits.ramp_unbounded = False
                self._report_if(text)

        if axis.has(objects.PROFILE_VELOCITY):
            self._lower(objects.PROFILE_VELOCITY, 0, report)
        else:
            report(False, "its EDS has no 0x6081, so the drive alone limits its speed in PP")

    def bound_homing(self, done: Callable[[str], None]) -> None:
        """Reduce the homing speeds (0x6099) to the velocity limit; call `done` with "" or the reason for a failure."""
        axis = self._axis
        subindices = [sub for sub in _HOMING_SPEEDS if axis.has(objects.HOMING_SPEEDS, sub)]
        if axis.limits.described == math.inf:
            subindices = []
        elif not subindices:
            self._report(
                f"its EDS has no 0x{axis.index(objects.HOMING_SPEEDS):04X}, so the drive alone limits its homing speed"
            )

        def report(bounded: bool, text: str) -> None:
            if not bounded:
                done(text)
                return
            self._report_if(text)
            if subindices:
                self._lower(objects.HOMING_SPEEDS, subindices.pop(0), report)
            else:
                done("")

        report(True, "")

    def _lower(self, base: int, subindex: int, report: Callable[[bool, str], None]) -> None:
        """Reduce a speed object of the drive to the velocity limit.

        `report` receives whether the speed is within the limit, and a text to report or "". A profile velocity of 0
        means no limit; a homing speed of 0 moves nothing.
        """
        axis, index = self._axis, self._axis.index(base)
        entry, words = axis.node.od[index, subindex], axis.limits.words
        place = f"0x{index:04X}" + (f":{subindex:02X}" if subindex else "")
        most = int(axis.limits.described * abs(axis.scale.vel_to_dev))

        def read(request: SdoRequest) -> None:
            if request.error is not None:
                report(False, f"{place} could not be read, so the axis may move faster than {words}: {request.error}")
                return
            limit = int.from_bytes(request.data, "little")
            if limit <= most and (limit or base != objects.PROFILE_VELOCITY):
                report(True, "")
                return

            def written(done: SdoRequest) -> None:
                if done.error is not None:
                    report(False, f"{place} could not be reduced from {limit}, faster than {words}: {done.error}")
                    return
                if (output := axis.output(base, subindex)) is not None:
                    output.record(most)
                report(True, f"{place} was reduced from {limit} to {most}, {words}")

            axis.node.write(index, subindex, encode(most, entry.data_type), written)

        axis.node.read(index, subindex, read)

    def _report_if(self, text: str) -> None:
        if text:
            self._report(text)

    def _answer(self, index: int, subindex: int, number: int) -> Callable[[SdoRequest], None]:
        def answered(request: SdoRequest) -> None:
            if number == self._round:
                self._take(index, subindex, request)

        return answered

    def _take(self, index: int, subindex: int, request: SdoRequest) -> None:
        entry = self._axis.node.od.get(self._axis.index(index), subindex)
        if request.error is not None:
            self.values.pop((index, subindex), None)
            # an SDO abort is the answer of a drive that does not have the object
            if not isinstance(request.error, SdoAbort):
                self.failed.append(str(request.error))
        elif entry is not None:
            try:
                value = decode(request.data, entry.data_type)
            except ValueError as error:
                self.failed.append(f"0x{request.index:04X}:{subindex:02X} {entry.name}: {error}")
            else:
                self.values[index, subindex] = value if isinstance(value, int) else 0
        self._open -= 1
        if self._open == 0:
            self._finish()

    def _finish(self) -> None:
        self._apply_scale()
        self._apply_limits()
        self.loaded = True
        self._report_slow_ramps()
        self._report_quick_stop()
        self._on_loaded()

    def _report_slow_ramps(self) -> None:
        """Report decelerations in the drive that are so low that the axis would keep moving for minutes in a stop."""
        axis = self._axis
        speed = axis.limits.most
        unit = "if its unit is that of the velocities per s, " if axis.scale.has_own_velocity_unit else ""
        for base in (objects.PROFILE_DECELERATION, objects.QUICK_STOP_DECELERATION):
            slope = self.get(base)
            if slope and speed < INT32_MAX and speed / slope > _SLOWEST_S:
                self._report(
                    f"0x{axis.index(base):04X} is {slope}, so that braking from {axis.limits.words} takes "
                    f"{speed / slope:.0f} s; {unit}write a faster ramp under `sdo:` in bus.yml"
                )

    def _report_quick_stop(self) -> None:
        """Report a 0x605A that CiA 402 does not define: with -1, Beckhoff's AX8000 ignores a quick stop."""
        code = self.get(objects.QUICK_STOP_OPTION)
        if code is not None and code not in objects.OPTION_CODES[objects.QUICK_STOP_OPTION]:
            index = self._axis.index(objects.QUICK_STOP_OPTION)
            self._report(
                f"0x{index:04X} is {code}, which CiA 402 does not define: a quick stop may not stop the axis; add "
                f"`{{index: 0x{index:04X}, sub_index: 0, value: 2}}` under `sdo:` in bus.yml"
            )

    def _pair(self, index: int) -> Pair:
        return _pair(self.get(index, 1), self.get(index, 2))

    def counts_per_turn(self) -> float | None:
        """Return the position units per shaft revolution, or None if the drive does not define units."""
        return _counts_per_turn(*(self._pair(index) for index in _UNITS))

    def _apply_scale(self) -> None:
        axis = self._axis
        axis.scale = Scale(**_scales(axis.node.config.units, axis.number, self.counts_per_turn()))
        scale, turn = axis.scale, self._counts_of_motor()
        axis.turn = turn or abs(scale.pos_to_dev) * math.tau
        axis.rpm_to_dev = math.copysign(60.0 / math.tau, scale.vel_to_dev)
        if turn is not None:
            units = axis.node.config.units
            only_velocity = units.gives(axis.number, "scale_vel_to_dev") and not units.gives(
                axis.number, "scale_pos_to_dev"
            )
            to_dev = scale.vel_to_dev if only_velocity else scale.pos_to_dev
            axis.rpm_to_dev = to_dev / turn * 60.0

    def _counts_of_motor(self) -> float | None:
        """Return the position units per motor revolution from the drive or bus.yml, or None if unknown."""
        encoder, gear = self._pair(objects.POSITION_ENCODER_RESOLUTION), self._pair(objects.GEAR_RATIO) or (1, 1)
        feed = self._pair(objects.FEED_CONSTANT)
        if feed is not None and is_feed(feed):
            return feed[0] / feed[1] * gear[1] / gear[0]
        if encoder is not None and is_feed(encoder):
            return encoder[0] / encoder[1]
        return self._axis.node.config.units.counts_per_revolution

    def _apply_limits(self) -> None:
        limits = self._axis.limits
        low, high = self.get(objects.SOFTWARE_POSITION_LIMIT, 1), self.get(objects.SOFTWARE_POSITION_LIMIT, 2)
        if low is not None and high is not None and low < high:
            limits.low, limits.high = low, high
        else:
            limits.low, limits.high = INT32_MIN, INT32_MAX
        start, end = self.get(objects.POSITION_RANGE_LIMIT, 1), self.get(objects.POSITION_RANGE_LIMIT, 2)
        if start is not None and end is not None:
            self._axis.unwrap.set_span(position_span(start, end))
        limits.take_velocity(min(self._largest_velocity(), float(INT32_MAX)), self._axis.scale)
        limits.deceleration = self.get(objects.PROFILE_DECELERATION) or math.inf
        positive, negative = self.get(objects.POSITIVE_TORQUE_LIMIT), self.get(objects.NEGATIVE_TORQUE_LIMIT)
        limits.torque_positive = min(positive or TORQUE_MAX, TORQUE_MAX)
        limits.torque_negative = min(negative or TORQUE_MAX, TORQUE_MAX)

    def _largest_velocity(self) -> float:
        """Return the smaller of 0x607F and 0x6080 in velocity units; infinite if neither limits the velocity."""
        bounds = [math.inf]
        profile, motor = self.get(objects.MAX_PROFILE_VELOCITY), self.get(objects.MAX_MOTOR_SPEED)
        axis = self._axis
        # CiA 402-2: 0x607F is in velocity units, 0x6080 in revolutions of the motor per minute
        # drives use 0 and 0x7FFFFFFF or more for no limit
        if profile and profile < _UNLIMITED >> 1:
            bounds.append(profile)
        if motor and motor < _UNLIMITED >> 1 and self._counts_of_motor() is not None:
            bounds.append(motor * abs(axis.scale.vel_to_dev / axis.rpm_to_dev))
        return min(bounds)
