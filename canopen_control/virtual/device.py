"""Virtual devices from EDS files: the node, and a drive for each axis with a controlword.

The object dictionary alone determines the device: a known identity or vendor selects the device model, every other
device is generic; a dictionary without CiA 402 objects gives a node without axes.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.cia402 import objects as o
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.host.sockets import lock
from canopen_control.od.codec import decode, encode
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry
from canopen_control.virtual.device_model import (
    GENERIC,
    DeviceModel,
    Limit,
    MissingSetPoint,
    ShaftFollower,
    vendor_model,
)
from canopen_control.virtual.fault_table import FaultSwitches
from canopen_control.virtual.plant import WORLD_NOTE, IndependentPlants, ReportsAssumptions, World
from canopen_control.virtual.quirks import quirks_of, switches_of
from canopen_control.virtual.shaft import ShaftWorld
from canopen_control.virtual.virtual_node import VirtualNode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.od.model import Address, ObjectDictionary
    from canopen_control.personality import Personality
    from canopen_control.virtual.object_store import VirtualStore
    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.scenario import ScenarioEvent


# File with the parameters that survive power-off: the values of 0x1010, and the node-ID and bit rate of LSS.
#
# The file is readable JSON, with one entry for each node by the node-ID with which the node was started:
#
#     {"format": "canopen_control store 1",
#      "nodes": {"3": {"device": [646, 1270], "node_id": 3, "bitrate": null, "values": {"6083:00": "10270000"}}}}
#
# Values are the object's bytes as on the wire. The file is replaced as a whole, never written in part; several
# processes may share it. Values that do not fit the dictionary (any more) are ignored and reported; the entry of
# another device is refused.


FORMAT = "canopen_control store 1"
_Record = dict[str, Any]  # the stored entry of a node; it may have been edited


class ParameterFile:
    """File with the stored parameters of nodes; `path` need not exist yet.

    Raise ConfigError if the file cannot be read or has another format. `report` receives a sentence about each ignored
    value of the file, and about a failed write.
    """

    def __init__(self, path: Path, report: Callable[[str], None]) -> None:
        self.path, self._report = path, report
        self._nodes = self._read()
        self._keys: dict[VirtualNode, str] = {}

    def node_id(self, started_with: int) -> int:
        """Return the node-ID that LSS stored for the node started as `started_with`, else `started_with`."""
        record = self._nodes.get(str(started_with), {})
        stored = record.get("node_id", started_with)
        possible = isinstance(stored, int) and (1 <= stored <= MAX_NODE_ID or stored == UNCONFIGURED)
        return int(stored) if possible else started_with

    def attach(self, node: VirtualNode, started_with: int) -> None:
        """Restore a node's parameters before power-on, and store changes; raise ConfigError for another device."""
        key = str(started_with)
        record = self._nodes.get(key)
        if record is not None:
            self._restore(node, record)
        self._keys[node] = key
        node.keeper = self

    def _restore(self, node: VirtualNode, record: _Record) -> None:
        device = _device(node)
        if record.get("device") != device:
            raise ConfigError(
                f"{self.path}: the values stored for node {node.node_id} are of device {record.get('device')}, not of "
                f"{device} (vendor, product); use another --store file"
            )
        if node.lss is not None and isinstance(record.get("bitrate"), int):
            node.lss.stored_bitrate = record["bitrate"]
        values = record.get("values")
        for name, text in values.items() if isinstance(values, dict) else ():
            try:
                address = _address(name)
                entry = node.od[address]
                node.store.power_on[address] = decode(bytes.fromhex(text), entry.data_type)
            except (KeyError, TypeError, ValueError):
                self._report(f"{self.path}: {name} of node {node.node_id} does not fit its EDS and is ignored")

    def keep(self, node: VirtualNode) -> bool:
        """Write the parameters of a node to the file; return False on failure."""
        key, lss = self._keys[node], node.lss
        values = {_name(a): encode(v, node.od[a].data_type).hex() for a, v in sorted(node.store.saved().items())}
        record: _Record = {
            "device": _device(node),
            "node_id": node.node_id if lss is None else lss.stored_node_id,
            "bitrate": None if lss is None else lss.stored_bitrate,
            "values": values,
        }
        try:
            with lock(self.path):
                self._nodes = self._read() | {key: record}
                self._write()
        except (CanopenError, OSError) as error:
            self._report(f"{self.path} cannot be written: {error}")
            return False
        return True

    def _read(self) -> dict[str, _Record]:
        try:
            content = json.loads(self.path.read_bytes())
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise ConfigError(f"{self.path} cannot be read: {error.strerror}") from None
        except ValueError:
            content = None
        nodes = content.get("nodes") if isinstance(content, dict) and content.get("format") == FORMAT else None
        if not isinstance(nodes, dict) or not all(isinstance(record, dict) for record in nodes.values()):
            raise ConfigError(f"{self.path} is not a store of virtual drives; use a new file name, the file is created")
        return nodes

    def _write(self) -> None:
        new = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        with new.open("w", encoding="utf-8") as file:
            json.dump({"format": FORMAT, "nodes": self._nodes}, file, indent=1)
            file.flush()
            os.fsync(file.fileno())
        new.replace(self.path)


def _device(node: VirtualNode) -> list[int]:
    return [node.store.number(0x1018, 1), node.store.number(0x1018, 2)]


def _name(address: Address) -> str:
    return f"{address[0]:04X}:{address[1]:02X}"


def _address(name: str) -> Address:
    index, _, subindex = name.partition(":")
    return int(index, 16), int(subindex, 16)


# The device model of the TMCM-1270 (PD42-x-1270), a stepper drive of Trinamic for CANopen.
#
# The model has only the behaviour in the EDS and in the public manuals of the drive family. Positions are
# microsteps, velocities pps (microsteps per second), accelerations pps per second. Velocity, accelerations and the
# quick-stop ramp have no usable default: until they are written, nothing moves. In profile velocity 0x6083 is also the
# deceleration. Bits 5 and 9 of the controlword have no effect in profile position, where bit 12 shows a set-point in
# process. In CSP the drive moves to the target within 0x60C2 and stops there until the next target arrives. Bit 14 of
# the statusword is set during a motion, bit 15 is the direction. Homing method 35 needs no power. There is no 0x6007:
# the reaction to a lost heartbeat is 0x1029:01, whose default enters PRE-OPERATIONAL and lets the motor continue; NMT
# STOPPED in operation is a fault. Bit 30 of the COB-IDs of TPDOs is set by default and may be cleared: `cob_id: auto`
# of ros2_canopen does that to real drives.


IDENTITY = (0x286, 0x4F6)  # 0x1018:01 and :02
_MICROSTEPS, _SWITCHES, _ENABLE_DELAY = 0x2000, 0x2005, 0x200A
_BOTH_DISABLED = 3
_MOVING, _NEGATIVE = 1 << 14, 1 << 15


def is_tmcm1270(od: ObjectDictionary) -> bool:
    """Whether a dictionary has the vendor-ID and product code of a TMCM-1270."""
    entries = (od.get(0x1018, 1), od.get(0x1018, 2))
    return tuple(None if entry is None else entry.value for entry in entries) == IDENTITY


def _velocity_bits(velocity: float) -> int:
    return (_MOVING if abs(velocity) >= 0.5 else 0) | (_NEGATIVE if velocity < 0.0 else 0)


def _switches_disabled(store: VirtualStore) -> bool:
    return store.number(_SWITCHES) & _BOTH_DISABLED == _BOTH_DISABLED


def _microsteps(store: VirtualStore) -> int:
    return store.number(_MICROSTEPS)


TMCM1270 = DeviceModel(
    name="TMCM-1270",
    unset_ramp=0.0,
    unset_velocity=0.0,
    velocity_ramp_both_ways=True,
    ramps_positions=True,
    single_set_point=True,
    homing_methods=frozenset((0, 17, 18, 19, 21, 35)),
    homing_halts=False,
    homes_without_power=True,
    counts_per_revolution=51_200,
    delays=MappingProxyType({4: _ENABLE_DELAY}),
    communication_data=bytes.fromhex("00FF000000"),
    missing=MissingSetPoint(),
    recovers_sync=False,
    rpdo_error=(0x6320, bytes.fromhex("00FF000000")),
    software_limit=Limit(0xFF01, b"\x01", b"\x02"),
    switch_limit=Limit(0xFF01, b"\x04", b"\x03"),
    switches_disabled=_switches_disabled,
    velocity_bits=_velocity_bits,
    identity=MappingProxyType(
        {
            (0x1008, 0): "TMCM-1270",
            (0x1009, 0): "virtual",
            (0x100A, 0): "3.26",
            (0x1018, 3): 0x0003001A,
            (_MICROSTEPS, 0): 8,
            (0x2003, 0): 128,
            (0x2004, 0): 8,
            (0x2704, 0): 1000,
            (0x2707, 0): 1000,
        }
    ),
    display=MappingProxyType({(0x2107, 0): _microsteps}),
)


def device_model_of(od: ObjectDictionary) -> DeviceModel:
    """Return the device model for the identity or vendor in a dictionary; `GENERIC` if both are unknown."""
    return TMCM1270 if is_tmcm1270(od) else vendor_model(od) or GENERIC


NO_OBJECTS: Final[Mapping[Address, int]] = MappingProxyType({})
"""No values in place of those of the EDS."""


def make_device(
    source: str | Path | ObjectDictionary,
    node_id: int,
    faults: Iterable[str] = (),
    *,
    serial: int | None = None,
    plant: Callable[[int], Plant] | None = None,
    model: DeviceModel | None = None,
    quirks: Sequence[str] = (),
    like: Personality | None = None,
    objects: Mapping[Address, int] = NO_OBJECTS,
) -> VirtualNode:
    """Create the virtual device of an EDS (a path or a dictionary).

    `plant` creates the plant of an axis. `faults` (``name`` or ``name@seconds``) are switched on at power-on or later,
    `quirks` (``name``, ``name=value`` or ``name=value@axis``) at power-on, together with those of the personality
    `like`. `objects` are values in place of those of the EDS, such as the identity that a robot expects; the model of
    the device stays that of the EDS. Raise EdsError for a file that cannot be used, and ConfigError for an invalid or
    impossible fault or quirk, a value that does not fit, or a personality whose objects the dictionary lacks.
    """
    od = read_eds(source, node_id).od if isinstance(source, str | Path) else source.for_node(node_id)
    model = model or device_model_of(od)
    node = VirtualNode(_with_objects(od, objects), node_id, serial=serial, model=model, plant=plant)
    switches = FaultSwitches(node)
    for fault in faults:
        switches.schedule(fault)
    if like is not None:
        take_personality(node, like)
    quirks = [*(() if like is None else quirks_of(like)), *quirks]
    if quirks:
        switches_of(node).start_with(quirks)
    return node


def _with_objects(od: ObjectDictionary, objects: Mapping[Address, int]) -> ObjectDictionary:
    """Return `od` with other values; objects that the file lacks are added, as read-only numbers of 32 bits."""
    if not objects:
        return od
    changed = replace(od, entries=od.entries.copy(), objects=od.objects.copy())
    for (index, subindex), value in objects.items():
        entry = changed.get(index, subindex) or Entry(index, subindex, "", DataType.UNSIGNED32, "ro")
        low, high, place = entry.data_type.minimum, entry.data_type.maximum, f"0x{index:04X}:{subindex:02X}"
        if not entry.data_type.is_integer:
            text = f"{place} is a {entry.data_type.name}, and only integers can be given; choose another object"
            raise ConfigError(f"node {od.node_id}: {text}")
        if not low <= value <= high:
            text = f"{place} = {value} does not fit {entry.data_type.name}; give {low} to {high}"
            raise ConfigError(f"node {od.node_id}: {text}")
        changed.add(replace(entry, parameter_value=value, parameter_relative=False))
        count = changed.get(index) or Entry(index, 0, "", DataType.UNSIGNED8, "ro", default=0)
        if isinstance(count.value, int) and count.value < subindex <= 0xFE:
            changed.add(replace(count, default=subindex, parameter_value=None))
    return changed


def take_personality(node: VirtualNode, like: Personality) -> None:
    """Set 0x6502 to the modes of a personality; raise ConfigError if the EDS lacks an object of the personality."""
    missing = [f"0x{index:04X}" for index in like.objects if not node.od.subindices(index)]
    if missing:
        raise ConfigError(
            f"{like.line_of('objects')}: {like.title} has {', '.join(missing)}, which the EDS of node {node.node_id} "
            f"({node.name}) lacks; use an EDS with these objects"
        )
    if like.modes:
        for drive in node.drives.values():
            listed = sum(1 << mode - 1 for mode in like.modes)
            node.store.preset(o.SUPPORTED_DRIVE_MODES + drive.objects.offset, 0, listed)


@dataclass(frozen=True, slots=True)
class Devices:
    """Virtual devices of a process, with their world and the timeline of their scenario."""

    nodes: tuple[VirtualNode, ...]
    world: World
    timeline: tuple[ScenarioEvent, ...] = ()


def make_devices(
    node_ids: Sequence[int],
    eds: Path,
    report: Callable[[str], None],
    *,
    faults: Sequence[str] = (),
    quirks: Sequence[str] = (),
    like: Personality | None = None,
    serial: int | None = None,
    store: Path | None = None,
    scenario: Path | None = None,
    plant: Path | None = None,
    eds_files: Mapping[int, Path] | None = None,
    world: World | None = None,
    objects: Mapping[int, Mapping[Address, int]] | None = None,
) -> Devices:
    """Create all devices of a process; an error in a file is raised before any device runs.

    Raise EdsError and ConfigError. `report` gets warnings and the assumptions of the world. `serial` is the serial
    number of the first node, see `launch.DriveOptions`; `eds_files` maps node-IDs to EDS files, where they differ from
    `eds`, and `objects` to values that replace those of the EDS; `world` is an existing world. A node whose node-ID was
    changed by LSS, in an earlier process with the same store, starts with the changed node-ID.
    """
    files = {node_id: eds if eds_files is None else eds_files.get(node_id, eds) for node_id in node_ids}
    ods = {file: read_eds(file, node_ids[0]).od for file in files.values()}
    if UNCONFIGURED in node_ids and not ods[files[UNCONFIGURED]].device.lss_supported:
        raise ConfigError(
            f"{files[UNCONFIGURED]}: LSS is not supported, so a node without an id (255) could never get an id"
        )
    timeline = () if scenario is None else _timeline(scenario, node_ids)
    world = world or (IndependentPlants() if plant is None else _world(plant))
    for note in world.notes if isinstance(world, ReportsAssumptions) else ():
        report(f"{WORLD_NOTE}{note}")
    file = None if store is None else ParameterFile(store, report)
    nodes = [
        _node(
            ods[files[node_id]],
            node_id,
            (faults, quirks, like),
            _serial(node_id) if serial is None else serial + number,
            world,
            file,
            NO_OBJECTS if objects is None else objects.get(node_id, NO_OBJECTS),
        )
        for number, node_id in enumerate(node_ids)
    ]
    return Devices(tuple(nodes), world, timeline)


def _serial(node_id: int) -> int:
    """Return a default serial number, by which LSS distinguishes nodes without a node-ID."""
    return os.getpid() if node_id == UNCONFIGURED else node_id


def _timeline(path: Path, node_ids: Sequence[int]) -> tuple[ScenarioEvent, ...]:
    from canopen_control.virtual.scenario import read_scenario  # YAML is slow to import

    return tuple(read_scenario(path, node_ids))


def _world(path: Path) -> World:
    from canopen_control.virtual.plant_file import read_world  # YAML is slow to import

    return read_world(path)


def _node(
    od: ObjectDictionary,
    node_id: int,
    behaviour: tuple[Sequence[str], Sequence[str], Personality | None],
    serial: int,
    world: World,
    file: ParameterFile | None,
    objects: Mapping[Address, int],
) -> VirtualNode:
    active = node_id if file is None else file.node_id(node_id)
    faults, quirks, like = behaviour
    plant = partial(world.plant, node_id)
    node = make_device(od, active, faults, serial=serial, plant=plant, quirks=quirks, like=like, objects=objects)
    if file is not None:
        file.attach(node, node_id)
    if isinstance(world, ShaftWorld) and isinstance(node.function, ShaftFollower) and world.has_shaft(node_id):
        node.function.follow(world, node_id)
    return node
