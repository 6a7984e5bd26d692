"""Any EDS makes a device: the node, and a drive on each axis that has a controlword.

The law of this file: the dictionary alone decides. A known identity brings its personality, everything else is
generic; a dictionary without CiA 402 objects makes a plain node.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.od.eds import read_eds
from canopen_control.virtual.drive import attach_drives
from canopen_control.virtual.node import VirtualNode
from canopen_control.virtual.personality import GENERIC, Personality
from canopen_control.virtual.switchboard import FaultSwitches
from canopen_control.virtual.tmcm1270 import TMCM1270, is_tmcm1270

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.virtual.plant import Plant

__all__ = ["make_device", "personality_of"]


def personality_of(od: ObjectDictionary) -> Personality:
    """Return what is known of the device, by its identity."""
    return TMCM1270 if is_tmcm1270(od) else GENERIC


def make_device(
    source: str | Path | ObjectDictionary,
    node_id: int,
    faults: Iterable[str] = (),
    *,
    serial: int | None = None,
    plant: Callable[[int], Plant] | None = None,
    personality: Personality | None = None,
) -> VirtualNode:
    """Make the virtual device of an EDS (a path, or a dictionary that is read already).

    `plant` makes the plant of an axis; `faults` are switched on from the start, ``name`` or ``name@seconds``.
    Raises EdsError for a file that cannot be used, ConfigError for an unknown fault.
    """
    od = read_eds(source, node_id).od if isinstance(source, str | Path) else source.for_node(node_id)
    node = VirtualNode(od, node_id, serial=serial, personality=personality or personality_of(od))
    attach_drives(node, plant)
    switches = FaultSwitches(node)
    for fault in faults:
        switches.schedule(fault)
    return node
