"""The PDO layout of a bus as a message, for those who listen: trace, monitor, exports, the API's `layout`.

It is what a boot makes of the bus, taken from the same plans; nothing is decided here.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.rpc.messages.layout import BusLayout, MappedEntry, NodeLayout
from canopen_control.rpc.messages.layout import PdoLayout as PdoMessage

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan, PdoLayout
    from canopen_control.rpc.messages.layout import Direction

__all__ = ["layout_of"]


def layout_of(config: BusConfig, channel: str = "") -> BusLayout:
    """Return the layout of a bus; `channel` is that of bus.yml where none is given."""
    master = config.master
    return BusLayout(
        channel or master.channel,
        master.baudrate * 1000,
        master.node_id,
        SYNC_COB_ID,
        master.sync_period,
        tuple(
            NodeLayout(name, plan.node_id, str(config.eds_paths[name].resolve()), tuple(_pdos(plan)))
            for name, plan in config.plans.items()
        ),
    )


def _pdos(plan: NodePlan) -> Iterator[PdoMessage]:
    yield from (_pdo(plan, "rpdo", layout) for layout in plan.rpdos)
    yield from (_pdo(plan, "tpdo", layout) for layout in plan.tpdos)


def _pdo(plan: NodePlan, direction: Direction, layout: PdoLayout) -> PdoMessage:
    objects = tuple(_objects(plan, layout))
    return PdoMessage(layout.cob_id, direction, layout.number, layout.transmission_type, objects)


def _objects(plan: NodePlan, layout: PdoLayout) -> Iterator[MappedEntry]:
    for mapped in layout.objects:
        name = plan.entry_names.get((mapped.index, mapped.subindex), "")
        parent = plan.object_names.get(mapped.index, "")
        full = name if not parent or parent == name or not name else f"{parent}: {name}"
        yield MappedEntry(mapped.index, mapped.subindex, mapped.bits, mapped.data_type.name, full)
