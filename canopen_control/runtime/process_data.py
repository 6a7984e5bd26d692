"""Process data for clients: what TPDOs carry, object by object as it came, and objects to send in RPDOs.

The law of this file: nothing is looked at while nobody watches. A watcher is first told everything that has come, and
after each cycle what has changed since; a value that changed several times within a cycle is told once. Values are the
bytes of the object (CiA 301, 7.1), little endian, as SDO gives them. What moves an axis (controlword,
mode and targets, CiA 402-2) belongs to the controllers, which have limits and timeouts, and is written by nobody else.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.cia301.pdo import PdoCodec
from canopen_control.cia402.objects import MOTION
from canopen_control.errors import CanopenError, ControlError
from canopen_control.hardware.interfaces import DIGITAL_OUTPUTS
from canopen_control.od.codec import decode, encode
from canopen_control.rpc.messages.robot import MappedValue

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.cycle import ReceivedPdo
    from canopen_control.master.remote_node import RemoteNode
    from canopen_control.od.model import Value
    from canopen_control.runtime.core import RobotCore

__all__ = ["ProcessDataFeed", "write_mapped"]

_FIRST_OBJECT = 0x1000  # below it are the types, which fill gaps


class _Watched:
    """One TPDO of a node, and what was told of it."""

    __slots__ = ("count", "node", "objects", "pdo", "values")

    def __init__(self, node: str, pdo: ReceivedPdo, mapped: Sequence[MappedObject]) -> None:
        self.node, self.pdo, self.objects = node, pdo, mapped
        self.count, self.values = 0, tuple[Any, ...]()

    def changed(self) -> list[MappedValue]:
        """Return the objects that have another value than the last time."""
        pdo, before = self.pdo, self.values
        if pdo.count == self.count:
            return []
        self.count, self.values = pdo.count, pdo.values
        known = len(before) == len(pdo.values)
        return [
            _told(mapped, value)
            for position, (mapped, value) in enumerate(zip(self.objects, pdo.values, strict=True))
            if mapped.index >= _FIRST_OBJECT and not (known and before[position] == value)
        ]


class ProcessDataFeed:
    """The received process data of all nodes, by node."""

    def __init__(self, nodes: Iterable[RemoteNode]) -> None:
        self._watched = [
            _Watched(node.name, pdo, layout.objects)
            for node in nodes
            for layout, pdo in zip(node.plan.tpdos, node.received, strict=True)
        ]

    def everything(self) -> dict[str, list[MappedValue]]:
        """Return all objects that have come since their node has booted."""
        found: dict[str, list[MappedValue]] = {}
        for each in self._watched:
            if each.pdo.stamp >= 0:
                pairs = zip(each.objects, each.pdo.values, strict=True)
                found.setdefault(each.node, []).extend(
                    _told(mapped, value) for mapped, value in pairs if mapped.index >= _FIRST_OBJECT
                )
        return found

    def changes(self) -> dict[str, list[MappedValue]]:
        """Return what has changed since the last call; {} for nothing."""
        found: dict[str, list[MappedValue]] = {}
        for each in self._watched:
            if told := each.changed():
                found.setdefault(each.node, []).extend(told)
        return found


def write_mapped(robot: RobotCore, node: RemoteNode, index: int, subindex: int, data: bytes) -> None:
    """Send an object in the RPDOs that map it, from the next cycle on; raises ControlError.

    It is refused for what moves an axis, for digital outputs that a controller commands, and while the node is not
    operational. An RPDO that moves no axis is sent once for it.
    """
    what = f"{node.who}: 0x{index:04X}:{subindex:02X}"
    output = robot.bus_of(node).network.image.output(node.node_id, index, subindex)
    mapped = next((each for sent in node.sent for each in sent.codec.objects if each[:2] == (index, subindex)), None)
    if output is None or mapped is None:
        raise ControlError(f"{what} is in none of its RPDOs; map it in bus.yml, or write it by SDO")
    if any(index - offset in MOTION for offset in node.plan.axes):
        raise ControlError(f"{what} moves the drive and belongs to the controllers; command one of them")
    for joint in robot.joints.values():
        commanded = joint.commands.get(DIGITAL_OUTPUTS)
        if joint.axis.digital_outputs is output and commanded is not None and commanded.owner is not None:
            raise ControlError(f"{what} is commanded by {commanded.owner}; deactivate that controller first")
    if not node.ready:
        raise ControlError(f"{what} cannot be sent: the node is not operational: {node.error or 'it has not booted'}")
    output.write(_number(data, mapped, what))


def _number(data: bytes, mapped: MappedObject, what: str) -> int:
    """Return what the RPDO packs; ControlError for what it could not, since the cycle must never find that out."""
    try:
        value = decode(data, mapped.data_type)
        PdoCodec((mapped,)).pack([value])
    except (ValueError, CanopenError) as error:
        raise ControlError(f"{what}: {error}") from None
    return value  # type: ignore[return-value]  # most often a number


def _told(mapped: MappedObject, value: Value) -> MappedValue:
    if isinstance(value, int):
        size = (mapped.bits + 7) // 8
        data = (value & ((1 << 8 * size) - 1)).to_bytes(size, "little")
    else:
        data = value if isinstance(value, bytes) else encode(value, mapped.data_type)
    return MappedValue(mapped.index, mapped.subindex, data)
