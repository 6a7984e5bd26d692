"""Maps velocity and torque offset (0x60B1, 0x60B2) into the RPDOs of a node whose `feed_forward` asks for them.

The law of this file: bus.yml's own mapping stays as it is; an offset is put behind it, first where the target position
is, else into another RPDO of bus.yml that has room, else into one of the first four that nobody uses, with the
transmission of the target position. What cannot be mapped is told, and done without.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import MAX_BITS
from canopen_control.cia402.objects import TARGET_POSITION, TORQUE_OFFSET, VELOCITY_OFFSET
from canopen_control.master.keys import PdoConfig, PdoObject

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.plan_builder import PlanBuilder

__all__ = ["add_feed_forward"]

_OFFSETS: Final = {"velocity": VELOCITY_OFFSET, "effort": TORQUE_OFFSET}
_PREDEFINED: Final = range(1, 5)
_COMMUNICATION, _MAPPING = 0x1400, 0x1600

RpdoKeys = dict[int, PdoConfig]


def add_feed_forward(builder: PlanBuilder, axes: Sequence[int]) -> None:
    """Put the offsets that are asked for into the node's RPDOs, for each axis by the offset of its objects."""
    wanted = [(name, _OFFSETS[name] + offset, offset) for name in builder.node.motion.feed_forward for offset in axes]
    for name, index, offset in wanted:
        rpdos = builder.node.boot.rpdo
        if any(index in _mapped(builder, number, pdo) for number, pdo in rpdos.items() if pdo.enabled):
            continue
        text = _why_not(builder, index) or _add(builder, index, TARGET_POSITION + offset)
        if text:
            builder.warn("feed_forward", f"{text}; done without feed-forward of {name}")


def _why_not(builder: PlanBuilder, index: int) -> str:
    entry = builder.od.get(index, 0)
    if entry is None:
        return f"0x{index:04X} is not in {builder.file}"
    if not entry.rpdo_mappable or entry.data_type.bits is None:
        return f"0x{index:04X} {entry.name} cannot be mapped into an RPDO"
    return "" if builder.node.boot.rpdo else f"no RPDO stands in bus.yml; map 0x{index:04X} together with what is used"


def _add(builder: PlanBuilder, index: int, target: int) -> str:
    """Map an object into the first RPDO that has room; return what is wrong where none has."""
    rpdos = builder.node.boot.rpdo
    mine = [number for number, pdo in rpdos.items() if pdo.enabled and pdo.mapping is not None]
    mine.sort(key=lambda number: target not in _mapped(builder, number, rpdos[number]))
    for number in mine:
        pdo = rpdos[number]
        if pdo.mapping is not None and _has_room(builder, number, pdo.mapping, index):
            return _put(builder, number, replace(pdo, mapping=[*pdo.mapping, PdoObject(index)]))
    beside = next((rpdos[number] for number in mine if target in _mapped(builder, number, rpdos[number])), PdoConfig())
    for number in _PREDEFINED:
        used = number in rpdos and rpdos[number].enabled
        if not used and _has_room(builder, number, [], index):
            return _put(builder, number, PdoConfig(transmission=beside.transmission, mapping=[PdoObject(index)]))
    return f"no RPDO of {builder.file} has room for 0x{index:04X}"


def _put(builder: PlanBuilder, number: int, pdo: PdoConfig) -> str:
    boot = builder.node.boot
    builder.node = replace(builder.node, boot=replace(boot, rpdo={**boot.rpdo, number: pdo}))
    return ""


def _has_room(builder: PlanBuilder, number: int, mapping: Sequence[PdoObject], index: int) -> bool:
    od = builder.od
    entries = [od.get(each.index, each.sub_index) for each in (*mapping, PdoObject(index))]
    bits = sum((entry.data_type.bits or 0) if entry is not None else MAX_BITS for entry in entries)
    last_slot = (_MAPPING + number - 1, len(entries))
    return bits <= MAX_BITS and (_COMMUNICATION + number - 1, 1) in od and last_slot in od


def _mapped(builder: PlanBuilder, number: int, pdo: PdoConfig) -> list[int]:
    """Return the indices that an RPDO of bus.yml carries."""
    if pdo.mapping is not None:
        return [each.index for each in pdo.mapping]
    slots = range(1, (builder.default(_MAPPING + number - 1, 0) or 0) + 1)
    return [(builder.default(_MAPPING + number - 1, slot) or 0) >> 16 for slot in slots]
