"""What a running robot may be asked about its nodes and their objects: where they are, NMT, SDO, PDO, touch probes."""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Count, Done, Effect, Index, Request, Subindex

__all__ = [
    "MAX_OBJECT",
    "NODE_METHODS",
    "BusPlace",
    "GetNodes",
    "GetSdoProgress",
    "NmtRequest",
    "NodeIdentity",
    "NodeListing",
    "NodeName",
    "NodePlace",
    "PdoWrite",
    "ReadTouchProbe",
    "SdoData",
    "SdoPiece",
    "SdoProgress",
    "SdoRead",
    "SdoWrite",
    "TouchProbe",
]

MAX_OBJECT: Final = 400_000  # bytes of an object that an answer can carry; as many are taken in pieces

NodeName = str | int  # or its node id
Seconds = Annotated[float, msgspec.Meta(gt=0, le=60)]


class NodeIdentity(msgspec.Struct, frozen=True):
    """What boot expects of 0x1000 and 0x1018; 0 where anything will do."""

    device_type: int = 0
    vendor_id: int = 0
    product_code: int = 0
    revision_number: int = 0
    serial_number: int = 0
    eds_revision: int = 0


class NodePlace(msgspec.Struct, frozen=True, kw_only=True):
    """A node: where it is, the path of its EDS, and what bus.yml says of it.

    `axes` counts those of CiA 402 that its EDS has, `joints` are what it moves: none for a proxy.
    """

    name: str
    node_id: int
    bus: str = ""
    eds: str = ""
    identity: NodeIdentity = NodeIdentity()
    driver: str | None = None
    namespace: str = ""
    remappings: dict[str, str] = {}
    channel_names: list[str] | None = None
    joints: list[str] = []
    axes: int = 0


class BusPlace(msgspec.Struct, frozen=True):
    """A bus and the master's node id on it."""

    channel: str
    node_id: int | None = None


class NodeListing(msgspec.Struct, frozen=True):
    """All buses by name, and all nodes."""

    buses: dict[str, BusPlace] = {}
    nodes: list[NodePlace] = []


class GetNodes(Request[NodeListing], frozen=True):
    """Where each node is and which EDS describes it."""


class NmtRequest(Request[Done], frozen=True, kw_only=True):
    """`command`: start, stop, preop, reset-node, reset-comm; `node` may be "all".

    `boot` true: after a reset it is booted again; else that waits for `start`. `source` is by whose name the robot's
    events tell it.
    """

    command: str
    node: NodeName
    boot: bool = False
    source: str | None = None


class SdoData(msgspec.Struct, frozen=True):
    """The bytes of an object."""

    data: bytes


class SdoRead(Request[SdoData], frozen=True, kw_only=True):
    """Upload an object; `timeout` in seconds for each answer (null: the node's), `block` asks for block transfer."""

    node: NodeName
    index: Index
    subindex: Subindex = 0
    block: bool = False
    timeout: Seconds | None = None


class SdoWrite(Request[Done], frozen=True, kw_only=True):
    """Download an object; what moves an axis is refused while a stop is latched. The robot's events say who did it.

    `source` is by whose name, that of the client's program without one.
    """

    node: NodeName
    index: Index
    subindex: Subindex = 0
    data: bytes
    timeout: Seconds | None = None
    source: str | None = None


class SdoProgress(msgspec.Struct, frozen=True):
    """How many bytes of a transfer are over, and of how many; 0 and null while there is none, or nobody knows."""

    done: Count = 0
    total: Count | None = None


class GetSdoProgress(Request[SdoProgress], frozen=True, kw_only=True):
    """How far the SDO transfer is that is under way with a node, whoever asked for it."""

    node: NodeName


class SdoPiece(Request[Done], frozen=True, kw_only=True):
    """A piece of what this connection's next `sdo_write` writes before its own data: a request has 64 KiB at most."""

    data: bytes


class PdoWrite(Request[Done], frozen=True, kw_only=True):
    """Send an object in the RPDOs that map it, once, with the next cycle and the SYNC that follows; not what moves."""

    node: NodeName
    index: Index
    subindex: Subindex = 0
    data: bytes


class TouchProbe(msgspec.Struct, frozen=True, omit_defaults=True):
    """The touch probe objects of an axis (0x60B8 to 0x60BD) in device units; what the drive lacks is left out."""

    function: int | None = None
    status: int | None = None
    probe_1_positive: int | None = None
    probe_1_negative: int | None = None
    probe_2_positive: int | None = None
    probe_2_negative: int | None = None


class ReadTouchProbe(Request[TouchProbe], frozen=True, kw_only=True):
    """What the touch probes of a node caught."""

    node: NodeName


NODE_METHODS: Final = (
    ("nodes", Effect.READS, GetNodes),
    ("nmt", Effect.MOVES, NmtRequest),
    ("sdo_read", Effect.READS, SdoRead),
    ("sdo_write", Effect.MOVES, SdoWrite),
    ("sdo_data", Effect.CHANGES, SdoPiece),
    ("sdo_progress", Effect.READS, GetSdoProgress),
    ("pdo_write", Effect.CHANGES, PdoWrite),
    ("touch_probe", Effect.READS, ReadTouchProbe),
)
