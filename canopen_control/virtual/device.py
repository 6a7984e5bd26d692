"""Makes virtual devices of EDS files: the node, and a drive on each axis that has a controlword.

The dictionary alone decides. A known identity, or a known vendor, brings its device model, everything else is
generic; a dictionary without CiA 402 objects makes a plain node.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device_function import Follower
from canopen_control.virtual.device_model import GENERIC, DeviceModel, vendor_model
from canopen_control.virtual.fault_switches import FaultSwitches
from canopen_control.virtual.parameter_file import ParameterFile
from canopen_control.virtual.plant import WORLD_NOTE, PlainWorld, TellingWorld, World
from canopen_control.virtual.shaft import ShaftWorld
from canopen_control.virtual.tmcm1270 import TMCM1270, is_tmcm1270
from canopen_control.virtual.virtual_node import VirtualNode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.scenario import Switching

__all__ = ["Devices", "device_model_of", "make_device", "make_devices"]


def device_model_of(od: ObjectDictionary) -> DeviceModel:
    """Return what is known of the device, by its identity."""
    return TMCM1270 if is_tmcm1270(od) else vendor_model(od) or GENERIC


def make_device(
    source: str | Path | ObjectDictionary,
    node_id: int,
    faults: Iterable[str] = (),
    *,
    serial: int | None = None,
    plant: Callable[[int], Plant] | None = None,
    model: DeviceModel | None = None,
) -> VirtualNode:
    """Make the virtual device of an EDS (a path, or a dictionary that is read already).

    `plant` makes the plant of an axis; `faults` are switched on from the start, ``name`` or ``name@seconds``.
    Raises EdsError for a file that cannot be used, ConfigError for an unknown fault.
    """
    od = read_eds(source, node_id).od if isinstance(source, str | Path) else source.for_node(node_id)
    node = VirtualNode(od, node_id, serial=serial, model=model or device_model_of(od), plant=plant)
    switches = FaultSwitches(node)
    for fault in faults:
        switches.schedule(fault)
    return node


@dataclass(frozen=True, slots=True)
class Devices:
    """Nodes, what hangs on their axes, and what will happen to them."""

    nodes: tuple[VirtualNode, ...]
    world: World
    timeline: tuple[Switching, ...] = ()


def make_devices(
    node_ids: Sequence[int],
    eds: Path,
    say: Callable[[str], None],
    *,
    faults: Sequence[str] = (),
    serial: int | None = None,
    store: Path | None = None,
    scenario: Path | None = None,
    plant: Path | None = None,
    others: Mapping[int, Path] | None = None,
    world: World | None = None,
) -> Devices:
    """Make all that a process of virtual drives consists of; what is wrong in a file is told before anything runs.

    Raises EdsError and ConfigError, `say` takes warnings and what the world had to guess. `serial` is the first
    node's, see `launch.Options`; `others` are the EDS files of nodes that have another one, `world` is a world that is
    there already. A node that LSS gave another id, in an earlier process with the same store, starts with that one.
    """
    files = {node_id: eds if others is None else others.get(node_id, eds) for node_id in node_ids}
    ods = {file: read_eds(file, node_ids[0]).od for file in files.values()}
    if UNCONFIGURED in node_ids and not ods[files[UNCONFIGURED]].device.lss_supported:
        raise ConfigError(f"{files[UNCONFIGURED]}: it has no LSS, so a node without an id (255) could never get one")
    timeline = () if scenario is None else _timeline(scenario, node_ids)
    world = world or (PlainWorld() if plant is None else _world(plant))
    for note in world.notes if isinstance(world, TellingWorld) else ():
        say(f"{WORLD_NOTE}{note}")
    file = None if store is None else ParameterFile(store, say)
    nodes = [
        _node(
            ods[files[node_id]], node_id, faults, _serial(node_id) if serial is None else serial + number, world, file
        )
        for number, node_id in enumerate(node_ids)
    ]
    return Devices(tuple(nodes), world, timeline)


def _serial(node_id: int) -> int:
    """Return the serial number of a node that was given none; LSS tells nodes without an id apart by it."""
    return os.getpid() if node_id == UNCONFIGURED else node_id


def _timeline(path: Path, node_ids: Sequence[int]) -> tuple[Switching, ...]:
    from canopen_control.virtual.scenario import read_scenario  # YAML is slow to import

    return tuple(read_scenario(path, node_ids))


def _world(path: Path) -> World:
    from canopen_control.virtual.worldfile import read_world  # YAML is slow to import

    return read_world(path)


def _node(
    od: ObjectDictionary, node_id: int, faults: Sequence[str], serial: int, world: World, file: ParameterFile | None
) -> VirtualNode:
    active = node_id if file is None else file.node_id(node_id)
    node = make_device(od, active, faults, serial=serial, plant=lambda axis: world.plant(node_id, axis))
    if file is not None:
        file.attach(node, node_id)
    if isinstance(world, ShaftWorld) and isinstance(node.function, Follower):
        shaft = world.shaft(node_id)
        if shaft is not None:
            node.function.follow(shaft)
    return node
