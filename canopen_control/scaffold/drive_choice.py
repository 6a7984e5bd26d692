"""Choice of interfaces, modes, PDOs, units and supervision for a new robot's drive, based on its EDS.

The objects of each further axis of a device are 0x800 higher. All axes are moved and share the device's PDOs; axes with
the same command interface have the same mode, since bus.yml has one mode per interface and node. Velocity is preferred
to position, as far as 0x6502 and the mappable targets allow. For velocities PV is preferred, because the drive computes
the ramp and needs no set-point every cycle; for positions CSP, as ros2_control's position controllers expect. Torque is
chosen on request only. Units are from the EDS (0x608F, 0x6091, 0x6092, 0x60A9), or are a guess that is marked as such.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import TARGET_OBJECTS, OperationMode, mode_name, supported_modes
from canopen_control.cia402.motors import MODES, MotorMap, motors_of
from canopen_control.cia402.units import counts_of_objects, rpm_of_unit
from canopen_control.errors import RobotConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.od.codec import accepts
from canopen_control.od.indices import (
    GUARD_TIME,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_PRODUCER,
    LIFE_FACTOR,
)
from canopen_control.scaffold.pdo_choice import PdoRequirement, PdoUse, choose_pdos

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from canopen_control.od.model import Address, ObjectDictionary


EFFORT: Final = "effort"
POSITION: Final = "position"
VELOCITY: Final = "velocity"
GUESSED_COUNTS: Final = 4096.0
"""Position counts of one motor turn if the EDS does not define them."""

_CANDIDATES: Final = {
    VELOCITY: (OperationMode.PV, OperationMode.CSV, OperationMode.VL),
    POSITION: (OperationMode.CSP, OperationMode.PP, OperationMode.IP),
    EFFORT: (OperationMode.TQ, OperationMode.CST),
}
#: modes with one set-point per SYNC (CiA 402-2)
_WITH_SYNC: Final = (OperationMode.CSP, OperationMode.CSV, OperationMode.CST, OperationMode.IP)
_ON_ARRIVAL: Final = 255
_MODE_OBJECTS: Final = {
    objects.MODES_OF_OPERATION: "which selects the mode of operation",
    objects.MODES_OF_OPERATION_DISPLAY: "which confirms the mode of operation, as required to enable the drive",
}
_FEEDBACK: Final = {POSITION: objects.POSITION_ACTUAL, VELOCITY: objects.VELOCITY_ACTUAL}


@dataclass(frozen=True, slots=True)
class Supervision:
    """Supervision in use: heartbeat of the drive, heartbeat consumer in the drive, or node guarding.

    `reacts` means that the drive has an object for its reaction to the loss of the master.
    """

    producer: bool
    consumer: bool
    guarding: bool
    reacts: bool = True

    @property
    def stops_alone(self) -> bool:
        """Whether the drive detects the loss of the master and stops."""
        return self.consumer or self.guarding


@dataclass(frozen=True, slots=True)
class AxisChoice:
    """Interface, mode and units of axis `number`; `counts` are position counts per joint revolution.

    `feedback` are state interfaces. `is_known` is True if the EDS contains the counts; `rpm` is the unit of velocities
    in revolutions per minute (0x60A9), 0 for counts per second.
    """

    number: int
    interface: str
    mode: OperationMode
    feedback: tuple[str, ...]
    counts: float
    is_known: bool
    rpm: float

    def index(self, index: int) -> int:
        """Return the index of a profile object for this axis, given its index for the first axis."""
        return objects.axis_index(index, self.number)


@dataclass(frozen=True, slots=True)
class DriveChoice:
    """Axes and PDOs of a drive; `motors` is set if several motors share one set of objects."""

    axes: tuple[AxisChoice, ...]
    rpdos: tuple[PdoUse, ...]
    tpdos: tuple[PdoUse, ...]
    motors: MotorMap | None = None

    @property
    def modes(self) -> dict[str, OperationMode]:
        """Mode of operation for each used command interface."""
        return {axis.interface: axis.mode for axis in self.axes}


def axes_of(od: ObjectDictionary) -> tuple[int, ...]:
    """Return the axis numbers, from 0, of a CiA 402 drive: all axes with controlword and statusword."""
    od = _view(od)
    return tuple(
        axis
        for axis in range(objects.AXES)
        if all((objects.axis_index(index, axis), 0) in od for index in (objects.CONTROLWORD, objects.STATUSWORD))
    )


def is_drive(od: ObjectDictionary) -> bool:
    """Whether an object dictionary belongs to a CiA 402 drive."""
    return bool(axes_of(od))


def choose_drive(od: ObjectDictionary, interfaces: Sequence[Sequence[str]] = ()) -> DriveChoice:
    """Choose interfaces, modes and PDOs for all axes of a drive; raise RobotConfigError with the reason if impossible.

    `interfaces` are the acceptable interfaces of each axis, in order of preference; by default velocity, then position.
    """
    axes, motors = axes_of(od), motors_of(od)
    tpdos = _feedback_pdos(od, axes)
    chosen, rpdos = _choose_modes(od, axes, [*interfaces, *[(VELOCITY, POSITION)] * len(axes)])
    sent = [address for use in tpdos for address in use.objects]
    if motors is not None:
        sent = [part for address in sent for part in motors.parts(*address) or (address,)]
    carried, view = {index for index, _ in sent}, _view(od)
    choices = (_axis_choice(view, axis, *choice, carried) for axis, choice in zip(axes, chosen, strict=True))
    return DriveChoice(tuple(choices), rpdos, tpdos, motors)


def _view(od: ObjectDictionary) -> ObjectDictionary:
    """Return the object dictionary with the objects of each axis at the indices of CiA 402."""
    motors = motors_of(od)
    return od if motors is None else motors.view


def _pdos_for(od: ObjectDictionary, required: PdoRequirement) -> tuple[tuple[PdoUse, ...], tuple[Address, ...]]:
    """Return the PDOs for objects of the axes, and those that do not fit; shared objects have the device's address."""
    if (motors := motors_of(od)) is None:
        return choose_pdos(od, required)
    needed, useful = (
        tuple(dict.fromkeys(motors.address(*address) for address in addresses))
        for addresses in (required.needed, required.useful)
    )
    return choose_pdos(od, replace(required, needed=needed, useful=useful))


def _axis_choice(
    od: ObjectDictionary, axis: int, interface: str, mode: OperationMode, carried: Container[int]
) -> AxisChoice:
    counts = _counts(od, axis)
    return AxisChoice(
        number=axis,
        interface=interface,
        mode=mode,
        feedback=tuple(name for name, index in _FEEDBACK.items() if objects.axis_index(index, axis) in carried),
        counts=counts or GUESSED_COUNTS,
        is_known=counts is not None,
        rpm=rpm_of_unit(od.number(objects.axis_index(objects.SI_UNIT_VELOCITY, axis)) or 0),
    )


def _feedback_pdos(od: ObjectDictionary, axes: Sequence[int]) -> tuple[PdoUse, ...]:
    """Choose the TPDOs; raise RobotConfigError if none can carry a statusword, or a mode object is missing."""

    def addresses_of(*indices: int) -> tuple[Address, ...]:
        return tuple((objects.axis_index(index, axis), 0) for axis in axes for index in indices)

    useful = addresses_of(objects.MODES_OF_OPERATION_DISPLAY, *_FEEDBACK.values(), objects.ERROR_CODE)
    tpdos, missing = _pdos_for(od, PdoRequirement(False, addresses_of(objects.STATUSWORD), useful))
    if missing:
        raise RobotConfigError(f"no TPDO can carry its statusword ({_named(missing)})")
    for axis in axes:
        for index, why in _MODE_OBJECTS.items():
            if (objects.axis_index(index, axis), 0) not in _view(od):
                raise RobotConfigError(f"no 0x{objects.axis_index(index, axis):04X}, {why}")
    return tpdos


def _named(addresses: Sequence[Address]) -> str:
    return ", ".join(f"0x{index:04X}" for index, _ in addresses)


_PERIOD_MS: Final = 100  # as in the bus.yml of a new robot
_LIFE: Final = 5
_ENTRY: Final = MAX_NODE_ID << 16 | _LIFE * _PERIOD_MS  # CiA 301, 7.5.2.19: node-ID and time


def supervision_of(od: ObjectDictionary) -> Supervision:
    """Return the supervision that the EDS permits: heartbeat (0x1016, 0x1017), else guarding."""
    # CiA 301, 7.2.8.3.2.1: a heartbeat producer time above 0 disables node guarding
    producer = accepts(od.get(HEARTBEAT_PRODUCER, 0), _PERIOD_MS)
    consumer = any(
        accepts(od.get(HEARTBEAT_CONSUMER, subindex), _ENTRY) for subindex in od.subindices(HEARTBEAT_CONSUMER)[1:]
    )
    guarding = accepts(od.get(GUARD_TIME, 0), _PERIOD_MS) and accepts(od.get(LIFE_FACTOR, 0), _LIFE)
    guarding = not (producer and consumer) and guarding
    return Supervision(producer, consumer, guarding, objects.has_loss_reaction(od))


_Chosen = list[tuple[str, OperationMode]]


def _choose_modes(
    od: ObjectDictionary, axes: Sequence[int], interfaces: Sequence[Sequence[str]]
) -> tuple[_Chosen, tuple[PdoUse, ...]]:
    """Choose the interface and mode of each axis, then the RPDOs; raise RobotConfigError if impossible."""
    chosen: _Chosen = []
    for axis, interface in zip(axes, interfaces, strict=False):
        chosen.append(_choose_mode(od, axis, interface, dict(chosen)))
    rpdos, missing = _rpdos(od, axes, chosen)
    if missing:
        raise RobotConfigError(f"its RPDOs cannot carry the objects of {len(axes)} axes: {_named(missing)} do not fit")
    return chosen, rpdos


def _choose_mode(
    od: ObjectDictionary, axis: int, interfaces: Sequence[str], chosen: dict[str, OperationMode]
) -> tuple[str, OperationMode]:
    """Choose the interface and mode of one axis; raise RobotConfigError with the reason if impossible.

    `interfaces` are in order of preference; `chosen` maps each interface to the mode already chosen for earlier axes.
    """
    listed = supported_modes(_view(od).number(objects.axis_index(objects.SUPPORTED_DRIVE_MODES, axis)) or 0)
    possible = tuple(OperationMode) if motors_of(od) is None else MODES
    for interface in interfaces:
        for mode in (mode for mode in _CANDIDATES[interface] if mode in possible):
            if (listed and mode not in listed) or chosen.get(interface, mode) is not mode:
                continue
            if not _rpdos(od, (axis,), [(interface, mode)])[1]:
                return interface, mode
    modes = f"its modes are {', '.join(map(mode_name, listed))} (0x6502), and " if listed else ""
    candidates = [mode for interface in interfaces for mode in _CANDIDATES[interface]]
    indices = {objects.axis_index(TARGET_OBJECTS[mode][0], axis) for mode in candidates}
    raise RobotConfigError(
        f"{modes}no RPDO can carry the controlword (0x{objects.axis_index(objects.CONTROLWORD, axis):04X}) and a "
        f"target of {' or '.join(interfaces)} ({', '.join(f'0x{index:04X}' for index in sorted(indices))})"
    )


def _rpdos(
    od: ObjectDictionary, axes: Sequence[int], chosen: _Chosen
) -> tuple[tuple[PdoUse, ...], tuple[Address, ...]]:
    """Return the RPDOs for controlwords, targets and modes of axes, and the objects that do not fit."""
    needed: list[Address] = []
    for axis, (_, mode) in zip(axes, chosen, strict=True):
        index, subindex = TARGET_OBJECTS[mode]
        needed += [(objects.axis_index(objects.CONTROLWORD, axis), 0), (objects.axis_index(index, axis), subindex)]
    useful = tuple((objects.axis_index(objects.MODES_OF_OPERATION, axis), 0) for axis in axes)
    transmission = 1 if any(mode in _WITH_SYNC for _, mode in chosen) else _ON_ARRIVAL
    return _pdos_for(od, PdoRequirement(True, tuple(needed), useful, transmission))


def _counts(od: ObjectDictionary, axis: int) -> float | None:
    """Return the position counts per shaft revolution from the EDS defaults, or None."""

    def pair(index: int) -> tuple[int, int] | None:
        first, second = (od.number(objects.axis_index(index, axis), subindex) for subindex in (1, 2))
        return (first, second) if first and second and first > 0 and second > 0 else None

    return counts_of_objects(
        *map(pair, (objects.POSITION_ENCODER_RESOLUTION, objects.GEAR_RATIO, objects.FEED_CONSTANT))
    )
