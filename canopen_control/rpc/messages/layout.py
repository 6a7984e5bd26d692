"""PDO layout of the buses as messages for trace, monitor and exports. Keys are never renamed."""

from __future__ import annotations

from typing import Literal

import msgspec

from canopen_control.rpc.messages.declare import BitRate, Bits, Count, Identifier, Index, NodeId, Subindex

Direction = Literal["rpdo", "tpdo"]


class MappedEntry(msgspec.Struct, frozen=True):
    """Object in a PDO; `data_type` is a name of CiA 301, `name` that of the EDS.

    Its value times `factor` plus `offset` is in `unit`, if the robot's files contain it; otherwise the unit is empty.
    """

    index: Index
    subindex: Subindex
    bits: Bits
    data_type: str
    name: str | None = ""
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""


class PdoLayout(msgspec.Struct, frozen=True):
    """Active PDO; `direction` as seen by the device, "rpdo" or "tpdo"; `cob_id` includes the 29-bit flag."""

    cob_id: Identifier
    direction: Direction
    number: Count
    transmission_type: Count = 255
    objects: tuple[MappedEntry, ...] = ()


class NodeLayout(msgspec.Struct, frozen=True):
    """PDOs of a node; `eds` is a path, empty without one."""

    name: str
    node_id: NodeId
    eds: str | None = ""
    pdos: tuple[PdoLayout, ...] = ()


class BusLayout(msgspec.Struct, frozen=True):
    """Bus; `bitrate` in bit/s."""

    channel: str
    bitrate: BitRate
    master_node_id: NodeId | None = None
    sync_cob_id: Identifier = 0x80
    sync_period_us: Count = 0
    nodes: tuple[NodeLayout, ...] = ()


class Layout(msgspec.Struct, frozen=True):
    """PDO layout of all buses by name."""

    buses: dict[str, BusLayout] = {}
