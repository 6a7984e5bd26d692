"""The PDO layout of a bus as plain data, for those who listen: trace, monitor, exports, the API's `layout`.

The law of this file: it is what a boot makes of the bus, taken from the same plans; nothing is decided here. Keys may
be added, never renamed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from canopen_control.cia301.sync import SYNC_COB_ID

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.master.config import BusConfig
    from canopen_control.master.plan import NodePlan, PdoLayout

__all__ = ["layout_of"]


def layout_of(config: BusConfig, channel: str = "") -> dict[str, Any]:
    """Return `{"channel", "bitrate" (bit/s), "master_node_id", "sync_cob_id", "sync_period_us", "nodes": [...]}`.

    A node is `{"name", "node_id", "eds" (path), "pdos": [{"cob_id", "direction", "number", "transmission_type",
    "objects": [{"index", "subindex", "bits", "data_type", "name"}]}]}`.
    """
    return {
        "channel": channel or config.master.channel,
        "bitrate": config.master.baudrate * 1000,
        "master_node_id": config.master.node_id,
        "sync_cob_id": SYNC_COB_ID,
        "sync_period_us": config.master.sync_period,
        "nodes": [
            {
                "name": name,
                "node_id": plan.node_id,
                "eds": str(config.eds_paths[name].resolve()),
                "pdos": list(_pdos(plan)),
            }
            for name, plan in config.plans.items()
        ],
    }


def _pdos(plan: NodePlan) -> Iterator[dict[str, Any]]:
    for direction, layouts in (("rpdo", plan.rpdos), ("tpdo", plan.tpdos)):
        for layout in layouts:
            yield {
                "cob_id": layout.cob_id,
                "direction": direction,
                "number": layout.number,
                "transmission_type": layout.transmission_type,
                "objects": list(_objects(plan, layout)),
            }


def _objects(plan: NodePlan, layout: PdoLayout) -> Iterator[dict[str, Any]]:
    for mapped in layout.objects:
        name, parent = (
            plan.entry_names.get((mapped.index, mapped.subindex), ""),
            plan.object_names.get(mapped.index, ""),
        )
        yield {
            "index": mapped.index,
            "subindex": mapped.subindex,
            "bits": mapped.bits,
            "data_type": mapped.data_type.name,
            "name": name if not parent or parent == name or not name else f"{parent}: {name}",
        }
