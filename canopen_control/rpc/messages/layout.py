"""The PDO layout of the buses as messages, for those who listen: trace, monitor, exports. Keys are never renamed."""

from __future__ import annotations

from typing import Literal

import msgspec

from canopen_control.rpc.messages.declare import BitRate, Bits, Count, Identifier, Index, NodeId, Subindex

Direction = Literal["rpdo", "tpdo"]


class MappedEntry(msgspec.Struct, frozen=True):
    """An object in a PDO; `data_type` is a name of CiA 301, `name` what the EDS calls it.

    Times `factor` plus `offset` its number is in `unit`, where the robot's files say so; the unit is empty elsewhere.
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
    """A live PDO; `direction` is the device's, "rpdo" or "tpdo", `cob_id` has the flag of a 29-bit identifier."""

    cob_id: Identifier
    direction: Direction
    number: Count
    transmission_type: Count = 255
    objects: tuple[MappedEntry, ...] = ()


class NodeLayout(msgspec.Struct, frozen=True):
    """The PDOs of a node; `eds` is a path, empty where there is none."""

    name: str
    node_id: NodeId
    eds: str | None = ""
    pdos: tuple[PdoLayout, ...] = ()


class BusLayout(msgspec.Struct, frozen=True):
    """A bus; `bitrate` in bit/s."""

    channel: str
    bitrate: BitRate
    master_node_id: NodeId | None = None
    sync_cob_id: Identifier = 0x80
    sync_period_us: Count = 0
    nodes: tuple[NodeLayout, ...] = ()


class Layout(msgspec.Struct, frozen=True):
    """What the PDOs of each bus carry, by its name."""

    buses: dict[str, BusLayout] = {}
