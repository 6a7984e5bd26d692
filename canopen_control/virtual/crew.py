"""All that one process of virtual drives consists of, made from its files before anything runs.

The law of this file: whatever is wrong in a file is told here; what it makes is ready to live on any port.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.cia301.lss import UNCONFIGURED
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import make_device
from canopen_control.virtual.storage import Storage
from canopen_control.virtual.world import PlainWorld, World

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.virtual.launch import Options
    from canopen_control.virtual.node import VirtualNode
    from canopen_control.virtual.timeline import Switching

__all__ = ["Crew", "make_crew"]


@dataclass(frozen=True, slots=True)
class Crew:
    """Nodes, what hangs on their axes, and what will happen to them."""

    nodes: tuple[VirtualNode, ...]
    world: World
    timeline: tuple[Switching, ...] = ()


def make_crew(node_ids: Sequence[int], eds: Path, options: Options, say: Callable[[str], None]) -> Crew:
    """Make the nodes of an EDS; EdsError and ConfigError with what is wrong in a file, `say` takes warnings.

    A node that LSS gave another id, in an earlier process with the same store, starts with that one.
    """
    od = read_eds(eds, node_ids[0]).od
    if UNCONFIGURED in node_ids and not od.device.lss_supported:
        raise ConfigError(f"{eds}: it has no LSS, so a node without an id (255) could never get one")
    timeline = () if options.scenario is None else _timeline(options.scenario, node_ids)
    world = PlainWorld() if options.plant is None else _world(options.plant)
    storage = None if options.store is None else Storage(options.store, say)
    nodes = []
    for number, node_id in enumerate(node_ids):
        serial = None if options.serial is None else options.serial + number
        nodes.append(_node(od, node_id, options.faults, serial, world, storage))
    return Crew(tuple(nodes), world, timeline)


def _timeline(path: Path, node_ids: Sequence[int]) -> tuple[Switching, ...]:
    from canopen_control.virtual.scenario import read_scenario  # YAML is slow to import

    return tuple(read_scenario(path, node_ids))


def _world(path: Path) -> World:
    from canopen_control.virtual.worldfile import read_world  # YAML is slow to import

    return read_world(path)


def _node(
    od: ObjectDictionary,
    node_id: int,
    faults: Sequence[str],
    serial: int | None,
    world: World,
    storage: Storage | None,
) -> VirtualNode:
    active = node_id if storage is None else storage.node_id(node_id)
    serial = node_id if serial is None else serial
    node = make_device(od, active, faults, serial=serial, plant=lambda axis: world.plant(node_id, axis))
    if storage is not None:
        storage.attach(node, node_id)
    return node
