"""Messages with the PDO mappings of all buses, for traces, the monitor and exports; their keys are never renamed."""

from __future__ import annotations

from typing import Literal

import msgspec

from canopen_control.rpc.messages.declare import BitRate, Bits, Count, Identifier, Index, NodeId, Subindex

Direction = Literal["rpdo", "tpdo"]


class MappedEntry(msgspec.Struct, frozen=True):
    """Object mapped in a PDO; `data_type` is a name from CiA 301, `name` the name in the EDS.

    The value times `factor` plus `offset` is in `unit`, if the files of the robot define a unit; otherwise `unit` is
    "".
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
    """Active PDO; `direction` is from the device's view, `cob_id` includes the flag of 29-bit identifiers."""

    cob_id: Identifier
    direction: Direction
    number: Count
    transmission_type: Count = 255
    objects: tuple[MappedEntry, ...] = ()


class NodeLayout(msgspec.Struct, frozen=True):
    """Active PDOs of a node; `eds` is the path of the EDS, or "" without one."""

    name: str
    node_id: NodeId
    eds: str | None = ""
    pdos: tuple[PdoLayout, ...] = ()


class BusLayout(msgspec.Struct, frozen=True):
    """PDOs of all nodes on a bus, and the SYNC of the bus; `bitrate` is in bit/s."""

    channel: str
    bitrate: BitRate
    master_node_id: NodeId | None = None
    sync_cob_id: Identifier = 0x80
    sync_period_us: Count = 0
    nodes: tuple[NodeLayout, ...] = ()


class Layout(msgspec.Struct, frozen=True):
    """PDO mappings of all buses, by bus name."""

    buses: dict[str, BusLayout] = {}
