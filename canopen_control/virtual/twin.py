"""A second node with the same id: what a wrong DIP switch puts on the bus.

The law of this file: it hears what the first one hears and answers for itself; it is the same device with another
serial number, and it boots by itself when it is plugged in.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.virtual.drive import attach_drives
from canopen_control.virtual.node import VirtualNode

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame

__all__ = ["make_twin", "serve_twin"]

_OTHER_SERIAL = 1000


def make_twin(node: VirtualNode, now: int) -> VirtualNode:
    """Return a second device like `node`, powered on, and in PRE-OPERATIONAL as any that was just plugged in."""
    serial = (node.store.number(0x1018, 4) + _OTHER_SERIAL) & 0xFFFFFFFF
    twin = VirtualNode(node.od, node.node_id, serial=serial, personality=node.personality)
    attach_drives(twin)
    twin.store.preset(0x1018, 4, serial)
    twin.tick(now)
    return twin


def serve_twin(twin: VirtualNode) -> list[CanFrame]:
    """Return what a twin sends; nobody is told what happens to it."""
    twin.events()
    return twin.frames()
