"""Object addresses of drives whose motors share one set of objects.

In CiA 402-2, 5.1 the objects of axis a are 0x800 * a higher. A drive for two wheels (ZLTECH ZLAC8015D) has them only
once: targets and actual values have a subindex for each motor, and a further subindex with 16 bits for each motor; the
statusword has 16 bits for each motor in an object of 32 bits; the controlword is common to all motors. Only `MotorMap`
knows this arrangement. Master, virtual drive and simulation use the addresses of CiA 402 throughout; SDO and PDO
mappings are translated at the interface to the bus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.od.model import AXIS_STEP, PROFILE_START, DataType, ObjectCode, ObjectInfo

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.od.model import Address, Entry, ObjectDictionary


_MEASURED_AND_COMMANDED: Final = (
    o.TARGET_POSITION,
    o.TARGET_VELOCITY,
    o.TARGET_TORQUE,
    o.POSITION_ACTUAL,
    o.VELOCITY_ACTUAL,
)
_PACKED: Final = (o.STATUSWORD, o.ERROR_CODE)
"""16-bit objects of CiA 402 that such a device has only once, with 16 bits for each motor."""

_RECORDS: Final = frozenset(
    (
        o.VL_MIN_MAX_AMOUNT,
        o.VL_ACCELERATION,
        o.VL_DECELERATION,
        o.VL_QUICK_STOP,
        o.POSITION_RANGE_LIMIT,
        o.SOFTWARE_POSITION_LIMIT,
        o.POSITION_ENCODER_RESOLUTION,
        o.VELOCITY_ENCODER_RESOLUTION,
        o.GEAR_RATIO,
        o.FEED_CONSTANT,
        o.VELOCITY_FACTOR,
        o.ACCELERATION_FACTOR,
        o.HOMING_SPEEDS,
        o.PROFILE_JERK,
        o.INTERPOLATION_DATA,
        o.INTERPOLATION_TIME_PERIOD,
        o.INTERPOLATION_BUFFER,
        o.SUPPORTED_HOMING_METHODS,
        o.ADDITIONAL_POSITION_ACTUAL,
        o.ADDITIONAL_VELOCITY_ACTUAL,
        o.VELOCITY_CONTROL_PARAMETERS,
        o.POSITION_CONTROL_PARAMETERS,
        o.DIGITAL_OUTPUTS,
    )
)
"""Objects that have subindices in CiA 402 itself."""

MODES: Final = (OperationMode.PV, OperationMode.TQ, OperationMode.CSP, OperationMode.CSV, OperationMode.CST)
"""Modes in which no bit of the controlword starts or ends a motion."""

_HALF: Final = 16  # bits of each motor in an object for all motors
_PARTS: Final = {True: DataType.INTEGER16, False: DataType.UNSIGNED16}


@dataclass(frozen=True, slots=True)
class ObjectPlace:
    """Location of an axis' object in the device; `shift` and `bits` are 0 unless the axis has a part of the object."""

    index: int
    subindex: int
    shift: int = 0
    bits: int = 0

    @property
    def address(self) -> Address:
        return self.index, self.subindex

    def part_of(self, data: bytes) -> bytes:
        """Return the bytes that belong to the axis from the data of the device's object."""
        return data[self.shift // 8 : (self.shift + self.bits) // 8] if self.bits else data


def per_motor(od: ObjectDictionary) -> tuple[int, ...]:
    """Return the targets and actual values that have subindices 1 and 2 in `od`, but are variables in CiA 402."""
    return tuple(index for index in _MEASURED_AND_COMMANDED if (index, 1) in od and (index, 2) in od)


def motors_of(od: ObjectDictionary) -> MotorMap | None:
    """Return the map of a two-motor device, which uses subindices 1 and 2; None for other devices."""
    return MotorMap(od, (1, 2)) if per_motor(od) and not problem_of(od, (1, 2)) else None


def problem_of(od: ObjectDictionary, subindices: Sequence[int]) -> str:
    """Return why the motors of a device are not in `subindices`, without the device's name, or "" if they are."""
    if len(subindices) < 2 or not all(0 < subindex < 0xFF for subindex in subindices):
        return f"a subindex for each of two or more motors is needed, such as [1, 2], not {list(subindices)}"
    if doubled := sorted({subindex for subindex in subindices if list(subindices).count(subindex) > 1}):
        return f"subindex {doubled[0]} is listed twice; each motor needs its own subindex"
    # CiA 402-2, 5.1: axis 1 has its own controlword at 0x6840
    if (o.axis_index(o.CONTROLWORD, 1), 0) in od:
        return "it has a second controlword (0x6840): each axis has its own objects, as in CiA 402"
    several = [index for index in _MEASURED_AND_COMMANDED if any(subindex for subindex in od.subindices(index))]
    missing = [f"0x{index:04X}:{sub:02X}" for index in several for sub in subindices if (index, sub) not in od]
    if not several:
        return "its targets and actual values have no subindices: it has one motor"
    return f"{', '.join(missing)} is not in it" if missing else ""


class MotorMap:
    """Mapping between a device and a CiA 402 view in which axis n has the values of `subindices[n]`.

    `view` is the dictionary as in CiA 402, with axis 1 from 0x6800 on; `places` are the locations of those objects of
    the view that are elsewhere in the device. `shared` maps objects that the device has only once to those of the other
    axes in the view.
    """

    def __init__(self, device: ObjectDictionary, subindices: Sequence[int]) -> None:
        self.device, self.subindices = device, tuple(subindices)
        self.places: dict[Address, ObjectPlace] = {}
        self.shared: dict[Address, tuple[Address, ...]] = {}
        self._parts: dict[Address, tuple[Address, ...]] = {}
        self._axes = range(len(self.subindices))
        self.view = replace(device, objects=dict(device.objects), entries=dict(device.entries))
        for index in sorted({entry.index for entry in device if 0 <= entry.index - PROFILE_START < AXIS_STEP}):
            entry = device.get(index)
            if index not in _RECORDS and all((index, subindex) in device for subindex in self.subindices):
                self._divide(index)
            elif index in _PACKED and entry is not None and entry.data_type.bits == _HALF * len(self.subindices):
                self._unpack(entry)
            else:
                self._share(index)

    def parts(self, index: int, subindex: int) -> tuple[Address, ...]:
        """Return the addresses in the view that share a device object, lowest bits first; () if unchanged.

        Several parts divide the bits of the object equally.
        """
        return self._parts.get((index, subindex), ())

    def split(self, objects: Iterable[MappedObject]) -> tuple[MappedObject, ...]:
        """Convert the objects mapped in a PDO of the device to objects of the view."""
        split: list[MappedObject] = []
        for mapped in objects:
            parts = self.parts(mapped.index, mapped.subindex)
            if len(parts) > 1:
                kind = _PARTS[self.view.entries[parts[0]].data_type.signed]
                split += [MappedObject(*address, mapped.bits // len(parts), kind) for address in parts]
            else:
                split.append(MappedObject(*parts[0], mapped.bits, mapped.data_type) if parts else mapped)
        return tuple(split)

    def address(self, index: int, subindex: int = 0) -> Address:
        """Return the device address of an object of the view."""
        place = self.places.get((index, subindex))
        return (index, subindex) if place is None else place.address

    def _divide(self, index: int) -> None:
        """Assign each subindex of an object, and each part of the common subindex, to an axis."""
        device, view = self.device, self.view
        for subindex in device.subindices(index):
            del view.entries[index, subindex]
        indices = [o.axis_index(index, axis) for axis in self._axes]
        for address, subindex in zip(indices, self.subindices, strict=True):
            self._add(address, 0, device[index, subindex], ObjectPlace(index, subindex))
            self._parts[index, subindex] = ((address, 0),)
        both = device.get(index, max(self.subindices) + 1)
        if both is not None and both.data_type.bits == _HALF * len(indices):
            self._parts[both.address] = tuple((address, 0) for address in indices)

    def _unpack(self, entry: Entry) -> None:
        """Assign to each axis its 16 bits of a packed object."""
        indices = [o.axis_index(entry.index, axis) for axis in self._axes]
        part = replace(entry, data_type=DataType.UNSIGNED16, default=None, low=None, high=None)
        for axis, address in enumerate(indices):
            self._add(address, 0, part, ObjectPlace(entry.index, 0, axis * _HALF, _HALF))
        self._parts[entry.address] = tuple((address, 0) for address in indices)

    def _share(self, index: int) -> None:
        """Map the object of the first axis to all other axes."""
        for subindex in self.device.subindices(index):
            copies = [o.axis_index(index, axis) for axis in self._axes[1:]]
            for copy in copies:
                self._add(copy, subindex, self.device[index, subindex], ObjectPlace(index, subindex))
            self.shared[index, subindex] = tuple((copy, subindex) for copy in copies)

    def _add(self, index: int, subindex: int, entry: Entry, place: ObjectPlace) -> None:
        self.view.entries[index, subindex] = replace(entry, index=index, subindex=subindex)
        self.places[index, subindex] = place
        info = self.device.objects.get(place.index)
        code = ObjectCode.VAR if info is None or place != ObjectPlace(place.index, subindex) else info.code
        self.view.objects[index] = ObjectInfo(index, entry.name if info is None else info.name, code)
