"""Description of a bus for decoding: its nodes, their objects, and the contents of their PDOs.

The data are plain and frozen. They come from a layout (derived from bus.yml by `master/pdo_layout.py`, or requested
from a running robot as `layout`), or from EDS files with their default PDOs. If a part is missing (an unreadable
EDS, an unknown node), names are missing in the output, but never frames.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from canopen_control.cia301.emcy import EMCY_COB_ID
from canopen_control.cia301.pdo import MappedObject
from canopen_control.cia301.sync import SYNC_COB_ID
from canopen_control.cia402 import objects
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.frame import can_id_of
from canopen_control.od.eds import SUFFIXES, read_eds
from canopen_control.od.indices import COB_ID_EMCY, DEVICE_TYPE
from canopen_control.od.model import DataType, ObjectCode
from canopen_control.od.pdos import pdos_of
from canopen_control.rpc.messages.layout import MappedEntry, PdoLayout

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from canopen_control.od.model import ObjectDictionary
    from canopen_control.od.pdos import Pdo
    from canopen_control.rpc.messages.layout import BusLayout


DEFAULT_BITRATE = 1_000_000
_RAW_TYPES = {
    8: DataType.UNSIGNED8,
    16: DataType.UNSIGNED16,
    24: DataType.UNSIGNED24,
    32: DataType.UNSIGNED32,
    40: DataType.UNSIGNED40,
    48: DataType.UNSIGNED48,
    56: DataType.UNSIGNED56,
    64: DataType.UNSIGNED64,
}


@dataclass(frozen=True, slots=True)
class NodeDescription:
    """Description of one node; `od` is None without an EDS, `eds` is the path of the EDS or ""."""

    name: str
    node_id: int
    od: ObjectDictionary | None = None
    pdos: tuple[PdoLayout, ...] = ()
    eds: str = ""

    def __str__(self) -> str:
        return f"node {self.node_id} ({self.name})" if self.name else f"node {self.node_id}"

    @property
    def is_drive(self) -> bool:
        """Whether the node is a CiA 402 drive; True for a node without an EDS."""
        if self.od is None:
            return True
        device_type = self.od.get(DEVICE_TYPE)
        value = device_type.value if device_type is not None else None
        if isinstance(value, int) and value & 0xFFFF and not objects.is_drive_profile(value):
            return False
        return (objects.CONTROLWORD, 0) in self.od or (objects.STATUSWORD, 0) in self.od

    @property
    def emcy_cob_id(self) -> int:
        """COB-ID of the node's EMCY: 0x1014 in the EDS, else the identifier of the predefined connection set."""
        entry = self.od.get(COB_ID_EMCY) if self.od is not None else None
        value = entry.value if entry is not None else None
        return can_id_of(value) if isinstance(value, int) and value & 0x7FF else EMCY_COB_ID + self.node_id


@dataclass(frozen=True, slots=True)
class NetworkDescription:
    """Description of one bus; `bitrate` is in bit/s, `sync_cob_id` includes the flag of 29-bit identifiers.

    `notes` are sentences about files that could not be read and whose names are therefore missing.
    """

    channel: str = ""
    bitrate: int = DEFAULT_BITRATE
    master_node_id: int | None = None
    sync_cob_id: int = SYNC_COB_ID
    nodes: Mapping[int, NodeDescription] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def name_of(self, node_id: int) -> str:
        """Return the name of a node, "master" for the master, or ""."""
        node = self.nodes.get(node_id)
        if node is not None:
            return node.name
        return "master" if node_id == self.master_node_id else ""

    def node_label(self, node_id: int) -> str:
        """Return ``node 3 (left_drive)``, or ``node 3`` if the node has no name."""
        name = self.name_of(node_id)
        return f"node {node_id} ({name})" if name else f"node {node_id}"


def entry_name(od: ObjectDictionary | None, index: int, subindex: int) -> str:
    """Return the name of an entry in the EDS, preceded by that of its array or record; "" if unknown."""
    if od is None:
        return ""
    entry, info = od.get(index, subindex), od.objects.get(index)
    if entry is None:
        return info.name if info is not None else ""
    if info is None or info.code in (ObjectCode.VAR, ObjectCode.DOMAIN):
        return entry.name
    # "Consumer heartbeat time 1" already contains the object
    if entry.name.casefold().startswith(info.name.casefold()):
        return entry.name
    return f"{info.name}: {entry.name}"


def network_of_layout(layout: BusLayout, paths: Mapping[str, Path] = MappingProxyType({})) -> NetworkDescription:
    """Return the description of one bus of a layout; a note is added for a missing or invalid EDS.

    `paths` maps names of EDS files to files that replace those of the layout, as in a recording.
    """
    notes: list[str] = []
    nodes = {}
    for node in layout.nodes:
        path = str(paths.get(Path(node.eds).name, node.eds)) if node.eds else ""
        od = _read(path, node.node_id, notes) if path else None
        nodes[node.node_id] = NodeDescription(node.name, node.node_id, od, node.pdos, path)
    return NetworkDescription(
        layout.channel, layout.bitrate, layout.master_node_id, layout.sync_cob_id, nodes, tuple(notes)
    )


def pdos_by_default(od: ObjectDictionary) -> tuple[PdoLayout, ...]:
    """Return the PDOs that are enabled and have a mapping by default."""
    return tuple(_pdo_by_default(od, pdo) for pdo in pdos_of(od) if pdo.enabled and pdo.mapped)


def _pdo_by_default(od: ObjectDictionary, pdo: Pdo) -> PdoLayout:
    entries = (
        MappedEntry(
            mapped.index,
            mapped.subindex,
            mapped.bits,
            type_of(od, mapped.index, mapped.subindex, mapped.bits).name,
            entry_name(od, mapped.index, mapped.subindex) or address_text(mapped.index, mapped.subindex),
        )
        for mapped in pdo.mapped
    )
    transmission = 255 if pdo.transmission_type is None else pdo.transmission_type
    return PdoLayout(
        can_id_of(pdo.cob_id or 0), "rpdo" if pdo.is_rpdo else "tpdo", pdo.number, transmission, tuple(entries)
    )


def type_of(od: ObjectDictionary | None, index: int, subindex: int, bits: int) -> DataType:
    """Return the data type of an object in a PDO, taken from the EDS if possible.

    Otherwise it is the unsigned type of that width, or OCTET_STRING for other whole bytes, or UNSIGNED64 for odd bits.
    """
    entry = od.get(index, subindex) if od is not None else None
    if entry is not None:
        return entry.data_type
    return _RAW_TYPES.get(bits, DataType.UNSIGNED64 if bits % 8 else DataType.OCTET_STRING)


def address_text(index: int, subindex: int) -> str:
    """Return an address such as ``0x6041:00``."""
    return f"0x{index:04X}:{subindex:02X}"


def pdo_name(pdo: PdoLayout) -> str:
    """Return the name of a PDO, such as ``RPDO1``."""
    return f"{pdo.direction.upper()}{pdo.number}"


def mapped_name(entry: MappedEntry) -> str:
    """Return the name of an object in a PDO, or its address if it has no name."""
    return entry.name or address_text(entry.index, entry.subindex)


def mapped_object(entry: MappedEntry) -> MappedObject:
    """Return a mapped object for a `PdoCodec`; an unknown data type becomes the raw type of its width."""
    data_type = DataType.__members__.get(entry.data_type) or type_of(None, entry.index, entry.subindex, entry.bits)
    return MappedObject(entry.index, entry.subindex, entry.bits, data_type)


def is_gap(entry: MappedEntry) -> bool:
    """Whether a mapped object is a data type that only fills a gap (dummy mapping, CiA 301, 7.5.2.36)."""
    return entry.index <= 7 and not entry.subindex


def _read(path: str, node_id: int, notes: list[str]) -> ObjectDictionary | None:
    try:
        return read_eds(path, node_id).od
    except (CanopenError, OSError) as error:
        notes.append(f"node {node_id} has no names: {error}")
        return None


# Description from EDS files alone: the node-IDs, the files, and their default PDOs. Nothing is sent, so nodes cannot be
# identified. The user therefore names the node of a file: ``3=FILE``, a DCF with a node-ID, or one file for all nodes.


_NODE_IDS = range(1, 128)


def network_of_eds(channel: str, options: Iterable[str], find: Callable[[str], Path] = Path) -> NetworkDescription:
    """Return the description from options ``NODE=FILE``, ``FILE`` and ``FOLDER``; ``FILE`` has the lowest precedence.

    `find` returns the path of a file. Raise EdsError for an invalid file, ConfigError for a folder without node-IDs.
    """
    everybody: dict[int, NodeDescription] = {}
    named: dict[int, NodeDescription] = {}
    for option in options:
        node, equals, file = option.partition("=")
        if equals and node.strip().isdecimal():
            described = _one(int(node), find(file), option)
            named[described.node_id] = described
        elif Path(option).expanduser().is_dir():
            named.update((description.node_id, description) for description in _folder(Path(option).expanduser()))
        else:
            everybody.update((description.node_id, description) for description in _all(find(option)))
    return NetworkDescription(channel=channel, nodes=everybody | named)


def _one(node_id: int, path: Path, option: str) -> NodeDescription:
    if node_id not in _NODE_IDS:
        raise ConfigError(f"--eds {option}: node-IDs are 1 to 127")
    od = read_eds(path, node_id).od
    return NodeDescription(path.stem, node_id, od, pdos_by_default(od), str(path))


def _all(path: Path) -> Iterator[NodeDescription]:
    """Yield a description for every node-ID; for a DCF, only for its node-ID."""
    parsed = read_eds(path).od
    if parsed.node_id is not None:
        yield NodeDescription(path.stem, parsed.node_id, parsed, pdos_by_default(parsed), str(path))
        return
    for node_id in _NODE_IDS:
        od = parsed.for_node(node_id)
        yield NodeDescription("", node_id, od, pdos_by_default(od), str(path))


def _folder(folder: Path) -> Iterator[NodeDescription]:
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    parsed = [(path, read_eds(path).od) for path in files]
    named = [(path, od) for path, od in parsed if od.node_id is not None]
    if not named:
        raise ConfigError(f"--eds {folder}: no file in it contains a node-ID; give --eds NODE=FILE for each file")
    for path, od in named:
        yield NodeDescription(path.stem, od.node_id or 0, od, pdos_by_default(od), str(path))
