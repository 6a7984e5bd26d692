"""Chooses how a new robot moves a drive: interface, mode of operation, PDOs, units, supervision, from its EDS alone.

Velocity before position, as far as 0x6502 and the mappable targets let it. What the drive ramps itself (PV, PP is after
CSP, which ros2_control's position controllers expect) needs no set-point every cycle. Units are those of the EDS's
defaults (0x608F, 0x6091, 0x6092, 0x60A9), else a guess that is called one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode, mode_name, supported_modes
from canopen_control.cia402.units import counts_per_revolution, rpm_of_unit
from canopen_control.errors import ConfigError, RobotConfigError
from canopen_control.scaffold.pdo_choice import PdoUse, PdoWish, choose_pdos

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.od.model import Address, ObjectDictionary

__all__ = ["POSITION", "VELOCITY", "DriveChoice", "Supervision", "choose_drive", "is_drive", "supervision_of"]

POSITION: Final = "position"
VELOCITY: Final = "velocity"
GUESSED_COUNTS: Final = 4096.0
"""Position counts of one motor turn where the EDS tells none."""

_CANDIDATES: Final[dict[str, tuple[tuple[OperationMode, Address], ...]]] = {
    VELOCITY: (
        (OperationMode.PV, (objects.TARGET_VELOCITY, 0)),
        (OperationMode.CSV, (objects.TARGET_VELOCITY, 0)),
        (OperationMode.VL, (objects.VL_TARGET_VELOCITY, 0)),
    ),
    POSITION: (
        (OperationMode.CSP, (objects.TARGET_POSITION, 0)),
        (OperationMode.PP, (objects.TARGET_POSITION, 0)),
        (OperationMode.IP, (objects.INTERPOLATION_DATA, 1)),
    ),
}
_WITH_SYNC: Final = (OperationMode.CSP, OperationMode.CSV, OperationMode.IP)  # their set-points act with SYNC
_ON_ARRIVAL: Final = 255
_CONTROLWORD, _STATUSWORD = (objects.CONTROLWORD, 0), (objects.STATUSWORD, 0)
_MODE, _DISPLAY = (objects.MODES_OF_OPERATION, 0), (objects.MODES_OF_OPERATION_DISPLAY, 0)
_MODE_OBJECTS: Final = {
    _MODE: "by which a mode of operation is chosen",
    _DISPLAY: "by which a drive confirms its mode of operation; nothing is enabled without",
}
_FEEDBACK: Final = {POSITION: (objects.POSITION_ACTUAL, 0), VELOCITY: (objects.VELOCITY_ACTUAL, 0)}


@dataclass(frozen=True, slots=True)
class Supervision:
    """Who can notice whose end: heartbeats of the drive, a drive that watches the master, node guarding."""

    producer: bool
    consumer: bool
    guarding: bool

    @property
    def stops_alone(self) -> bool:
        """Whether something stops the drive when the master dies."""
        return self.consumer or self.guarding


@dataclass(frozen=True, slots=True)
class DriveChoice:
    """How a drive is moved; `feedback` are its state interfaces, `counts` those of one turn of the joint.

    `told` is whether the EDS says so; `rpm` how many revolutions per minute the unit of its velocities is (0x60A9), 0
    where it is counts per second.
    """

    interface: str
    mode: OperationMode
    rpdos: tuple[PdoUse, ...]
    tpdos: tuple[PdoUse, ...]
    feedback: tuple[str, ...]
    counts: float
    told: bool
    rpm: float
    axes: int


def is_drive(od: ObjectDictionary) -> bool:
    """Whether a dictionary is that of a CiA 402 drive: it has a controlword and a statusword."""
    return _CONTROLWORD in od and _STATUSWORD in od


def choose_drive(od: ObjectDictionary, interfaces: Sequence[str] = (VELOCITY, POSITION)) -> DriveChoice:
    """Choose for the first of `interfaces` that the drive can do; RobotConfigError says why there is none."""
    wish = PdoWish(False, (_STATUSWORD,), (_DISPLAY, *_FEEDBACK.values(), (objects.ERROR_CODE, 0)))
    tpdos, missing = choose_pdos(od, wish)
    if missing:
        raise RobotConfigError("no TPDO can carry its statusword (0x6041)")
    for (index, subindex), why in _MODE_OBJECTS.items():
        if (index, subindex) not in od:
            raise RobotConfigError(f"no 0x{index:04X}, {why}")
    carried = {each for use in tpdos for each in use.objects}
    mode, rpdos, interface = _choose_mode(od, interfaces)
    counts = _counts(od)
    return DriveChoice(
        interface=interface,
        mode=mode,
        rpdos=rpdos,
        tpdos=tpdos,
        feedback=tuple(name for name, address in _FEEDBACK.items() if address in carried),
        counts=counts or GUESSED_COUNTS,
        told=counts is not None,
        rpm=rpm_of_unit(_number(od, objects.SI_UNIT_VELOCITY, 0) or 0),
        axes=sum((objects.axis_index(objects.CONTROLWORD, axis), 0) in od for axis in range(objects.AXES)),
    )


def supervision_of(od: ObjectDictionary) -> Supervision:
    """Return what the EDS lets be written of heartbeat (0x1016, 0x1017) and guarding (0x100C, 0x100D)."""

    def writable(index: int, subindex: int = 0) -> bool:
        entry = od.get(index, subindex)
        return entry is not None and entry.writable

    producer = writable(0x1017)
    consumer = any(writable(0x1016, subindex) for subindex in od.subindices(0x1016)[1:])
    return Supervision(producer, consumer, not (producer and consumer) and writable(0x100C) and writable(0x100D))


def _choose_mode(od: ObjectDictionary, interfaces: Sequence[str]) -> tuple[OperationMode, tuple[PdoUse, ...], str]:
    listed = supported_modes(_number(od, objects.SUPPORTED_DRIVE_MODES, 0) or 0)
    for interface in interfaces:
        for mode, target in _CANDIDATES[interface]:
            if listed and mode not in listed:
                continue
            transmission = 1 if mode in _WITH_SYNC else _ON_ARRIVAL
            rpdos, missing = choose_pdos(od, PdoWish(True, (_CONTROLWORD, target), (_MODE,), transmission))
            if not missing:
                return mode, rpdos, interface
    modes = f"its modes are {', '.join(map(mode_name, listed))} (0x6502), and " if listed else ""
    targets = {f"0x{index:04X}" for each in interfaces for _, (index, _) in _CANDIDATES[each]}
    raise RobotConfigError(
        f"{modes}no RPDO can carry the controlword (0x6040) and a target of {' or '.join(interfaces)} "
        f"({', '.join(sorted(targets))})"
    )


def _counts(od: ObjectDictionary) -> float | None:
    """Return the position units of one turn of the shaft by the EDS's defaults, None where it tells none."""

    def pair(index: int) -> tuple[int, int] | None:
        first, second = _number(od, index, 1), _number(od, index, 2)
        return (first, second) if first and second and first > 0 and second > 0 else None

    encoder, feed = pair(objects.POSITION_ENCODER_RESOLUTION), pair(objects.FEED_CONSTANT)
    feed = feed if feed not in (None, (1, 1)) else None  # of drives without units of the user: it says nothing
    if encoder is None and feed is None:
        return None
    try:
        return counts_per_revolution(encoder or (1, 1), pair(objects.GEAR_RATIO) or (1, 1), feed)
    except ConfigError:
        return None


def _number(od: ObjectDictionary, index: int, subindex: int) -> int | None:
    entry = od.get(index, subindex)
    return entry.value if entry is not None and isinstance(entry.value, int) else None
