"""What a node has to be told before it may run: bus.yml and EDS become a list of SDO writes and a PDO layout.

The law of the file: everything is decided here, before the first frame is sent, and whatever does not fit (an object
the EDS lacks, a value out of its type, a mapping over 64 bits) is an error of the configuration, not of the boot.

The order is the one of ros2_canopen's generator: error control, RPDOs, TPDOs, then the `sdo:` list. What this package
adds has a `reason`: the drive watches the master (0x1016), stops when it is lost (0x1029 or 0x6007), interpolates over
the SYNC period (0x60C2), and has no live PDO that nobody configured.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.cia301.pdo import MappedObject
from canopen_control.od.codec import encode

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.master.config import NodeConfig, PdoConfig
    from canopen_control.od.model import Entry, ObjectDictionary

__all__ = ["Identity", "NodePlan", "PdoLayout", "PlannedWrite", "make_plan"]

DISABLED = 0x80000000  # bit 31 of a PDO's COB-ID
NO_RTR = 0x40000000  # bit 30: kept as the device has it
CONSUMER, PRODUCER, GUARD_TIME, LIFE_TIME, ERROR_BEHAVIOUR = 0x1016, 0x1017, 0x100C, 0x100D, 0x1029
ABORT_CONNECTION, INTERPOLATION = 0x6007, 0x60C2
CONTROLWORD, STATUSWORD = 0x6040, 0x6041
AXIS_OFFSET, AXES = 0x800, 8
LARGEST_PDO = 64  # bits
STOPPED = 2  # 0x1029: to NMT stopped
FAULT_REACTION = 1  # 0x6007: malfunction, then the fault reaction of 0x605E
_STORED = "as in the EDS, but the device may have stored something else"
_COMMUNICATION = {"rpdo": 0x1400, "tpdo": 0x1800}
_MAPPING = {"rpdo": 0x1600, "tpdo": 0x1A00}
_PREDEFINED = {"rpdo": 0x200, "tpdo": 0x180}


@dataclass(frozen=True, slots=True)
class PlannedWrite:
    """One SDO download; `reason` is empty for what bus.yml asks for, `optional` ones may be refused by the node."""

    index: int
    subindex: int
    data: bytes
    name: str
    reason: str = ""
    optional: bool = False


@dataclass(frozen=True, slots=True)
class PdoLayout:
    """A PDO that will be live: its COB-ID and what it carries, in order."""

    number: int
    cob_id: int
    transmission_type: int
    objects: tuple[MappedObject, ...]


@dataclass(frozen=True, slots=True)
class Identity:
    """What the node must be; 0 where anything will do."""

    device_type: int = 0
    vendor_id: int = 0
    product_code: int = 0
    revision_number: int = 0
    serial_number: int = 0
    eds_revision: int = 0  # only warned about


@dataclass(frozen=True, slots=True)
class NodePlan:
    """Everything the boot of a node needs; `axes` are the index offsets of its CiA 402 axes, none for other devices."""

    name: str
    node_id: int
    source: str
    identity: Identity
    writes: tuple[PlannedWrite, ...]
    rpdos: tuple[PdoLayout, ...]
    tpdos: tuple[PdoLayout, ...]
    axes: tuple[int, ...]
    heartbeat_timeout_ns: int
    entry_names: dict[tuple[int, int], str] = field(default_factory=dict)


@dataclass(slots=True)
class _Draft:
    """The plan in the making; `complain(key, text)` reports a mistake and goes on."""

    node: NodeConfig
    od: ObjectDictionary
    complain: Callable[[str, str], None]
    writes: list[PlannedWrite] = field(default_factory=list)
    layouts: dict[str, list[PdoLayout]] = field(default_factory=lambda: {"rpdo": [], "tpdo": []})

    def write(self, index: int, subindex: int, value: object, key: str, reason: str = "") -> None:
        """Add one write, encoded as the EDS types the object."""
        entry = self.od.get(index, subindex)
        if entry is None:
            self.complain(key, f"0x{index:04X}:{subindex:02X} is not in {self.node.dcf}")
            return
        try:
            data = encode(value, entry.data_type)  # type: ignore[arg-type]  # encode checks the type of the value
        except ValueError as error:
            self.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name}: {error}")
            return
        self.writes.append(PlannedWrite(index, subindex, data, entry.name, reason))

    def asked_for(self, index: int) -> bool:
        """Whether the `sdo:` list of bus.yml writes the object."""
        return any(entry.index == index for entry in self.node.sdo)


def make_plan(
    node: NodeConfig,
    od: ObjectDictionary,
    *,
    source: str,
    master_id: int,
    master_heartbeat_ms: int,
    sync_period_us: int,
    complain: Callable[[str, str], None],
) -> NodePlan:
    """Plan a node; `complain` is told (key, text) for each mistake, and the plan is then not to be used."""
    draft = _Draft(node, od, complain)
    _plan_error_control(draft, master_id, master_heartbeat_ms)
    for kind in ("rpdo", "tpdo"):
        _plan_pdos(draft, kind)
    for number, entry in enumerate(node.sdo):
        draft.write(entry.index, entry.sub_index, _signature(entry.value), f"sdo[{number}]")
    _plan_interpolation(draft, sync_period_us)
    return NodePlan(
        node.name,
        node.node_id,
        source,
        _identity(node, od),
        tuple(draft.writes),
        tuple(draft.layouts["rpdo"]),
        tuple(draft.layouts["tpdo"]),
        tuple(_axes(od)),
        node.heartbeat_timeout_ns,
        {address: entry.name for address, entry in od.entries.items()},
    )


def _identity(node: NodeConfig, od: ObjectDictionary) -> Identity:
    """Take vendor and product from the EDS; revision and serial only where bus.yml gives them (0 checks nothing)."""

    def default(index: int, subindex: int, device: int | None) -> int:
        entry = od.get(index, subindex)
        return entry.default if entry is not None and isinstance(entry.default, int) else device or 0

    return Identity(
        device_type=default(0x1000, 0, None),
        vendor_id=default(0x1018, 1, od.device.vendor_number),
        product_code=default(0x1018, 2, od.device.product_number),
        revision_number=node.revision_number or 0,
        serial_number=node.serial_number or 0,
        eds_revision=0 if node.revision_number is not None else default(0x1018, 3, od.device.revision_number),
    )


def _axes(od: ObjectDictionary) -> Iterator[int]:
    for axis in range(AXES):
        offset = AXIS_OFFSET * axis
        if (CONTROLWORD + offset, 0) in od and (STATUSWORD + offset, 0) in od:
            yield offset


def _plan_error_control(draft: _Draft, master_id: int, master_heartbeat_ms: int) -> None:
    """Let the drive watch the master and be watched: 0x1016, 0x1017, guarding, 0x1029."""
    node, od = draft.node, draft.od
    if (CONSUMER, 1) in od and node.heartbeat_consumer is not False and master_heartbeat_ms:
        timeout = min(round(master_heartbeat_ms * node.multiplier), 0xFFFF)
        reason = "" if node.heartbeat_consumer else "the drive notices when the master dies"
        draft.write(CONSUMER, 1, master_id << 16 | timeout, "heartbeat_consumer", reason)
    if node.heartbeat_ms and not draft.asked_for(PRODUCER):
        reason = "" if node.heartbeat_producer else "the master notices when the drive dies"
        draft.write(PRODUCER, 0, node.heartbeat_ms, "heartbeat_producer", reason)
    for key, index, value in (
        ("guard_time", GUARD_TIME, node.guard_time),
        ("life_time_factor", LIFE_TIME, node.life_time_factor),
    ):
        if value:
            draft.write(index, 0, 0 if node.heartbeat_ms else value, key)
    for subindex, value in node.error_behavior.items():
        draft.write(ERROR_BEHAVIOUR, subindex, value, "error_behavior")
    _plan_abort_reaction(draft)


def _plan_abort_reaction(draft: _Draft) -> None:
    """Let a lost master stop the motor: 0x6007 where it exists, else 0x1029:1 = stopped."""
    node, od = draft.node, draft.od
    if not list(_axes(od)) or node.heartbeat_consumer is False:
        return
    if (ABORT_CONNECTION, 0) in od:
        if not draft.asked_for(ABORT_CONNECTION):
            draft.write(ABORT_CONNECTION, 0, FAULT_REACTION, "sdo", "a lost master stops the motor")
    elif (ERROR_BEHAVIOUR, 1) in od and 1 not in node.error_behavior and not draft.asked_for(ERROR_BEHAVIOUR):
        draft.write(ERROR_BEHAVIOUR, 1, STOPPED, "error_behavior", "a lost master stops the motor")


def _plan_interpolation(draft: _Draft, sync_period_us: int) -> None:
    if sync_period_us and (INTERPOLATION, 1) in draft.od and not draft.asked_for(INTERPOLATION):
        value, exponent = (sync_period_us // 1000, -3) if sync_period_us % 1000 == 0 else (sync_period_us // 100, -4)
        if value > 0xFF:
            value, exponent = value // 10, exponent + 1
        reason = "interpolation over the SYNC period"
        draft.write(INTERPOLATION, 1, min(value, 0xFF), "sdo", reason)
        draft.write(INTERPOLATION, 2, exponent, "sdo", reason)


def _plan_pdos(draft: _Draft, kind: str) -> None:
    """Configure the PDOs that bus.yml lists; one that is live by default and not listed is disabled."""
    configured: dict[int, PdoConfig] = getattr(draft.node, kind)
    for number in sorted(configured):
        _plan_pdo(draft, kind, number, configured[number])
    for number in range(1, 513):
        index = _COMMUNICATION[kind] + number - 1
        if number in configured or (cob_id := _default(draft.od, index, 1)) is None or cob_id & DISABLED:
            continue
        if configured:
            draft.write(index, 1, cob_id | DISABLED, kind, "live by default, configured by nobody")
        else:
            _adopt(draft, kind, number, cob_id)


def _adopt(draft: _Draft, kind: str, number: int, cob_id: int) -> None:
    """Where bus.yml says nothing about a node's PDOs its own defaults are what it uses."""
    objects = _mapped(draft, kind, number, None)
    if objects:
        transmission = _default(draft.od, _COMMUNICATION[kind] + number - 1, 2)
        draft.layouts[kind].append(
            PdoLayout(number, cob_id & 0x7FF, 255 if transmission is None else transmission, objects)
        )


def _plan_pdo(draft: _Draft, kind: str, number: int, pdo: PdoConfig) -> None:
    index, mapping, key = _COMMUNICATION[kind] + number - 1, _MAPPING[kind] + number - 1, f"{kind}.{number}"
    if (index, 1) not in draft.od:
        draft.complain(key, f"{draft.node.dcf} has no {kind.upper()} {number} (0x{index:04X})")
        return
    cob_id = _cob_id(draft, kind, number, pdo)
    off = not pdo.enabled and (_default(draft.od, index, 1) or 0) & DISABLED
    draft.write(index, 1, cob_id | DISABLED, key, _STORED if off else "")
    if not pdo.enabled:
        return
    for subindex, value in (
        (2, pdo.transmission),
        (3, pdo.inhibit_time),
        (5, pdo.event_timer or pdo.event_deadline),
        (6, pdo.sync_start),
    ):
        if value is not None:
            same = value == _default(draft.od, index, subindex)
            draft.write(index, subindex, value, key, _STORED if same else "")
    objects = _mapped(draft, kind, number, pdo)
    if pdo.mapping is not None:
        draft.write(mapping, 0, 0, key)
        for slot, mapped in enumerate(objects, 1):
            draft.write(mapping, slot, mapped.index << 16 | mapped.subindex << 8 | mapped.bits, key)
        draft.write(mapping, 0, len(objects), key)
    draft.write(index, 1, cob_id, key)
    transmission = pdo.transmission if pdo.transmission is not None else _default(draft.od, index, 2)
    draft.layouts[kind].append(
        PdoLayout(number, cob_id & 0x7FF, 255 if transmission is None else transmission, objects)
    )


def _cob_id(draft: _Draft, kind: str, number: int, pdo: PdoConfig) -> int:
    """Return the COB-ID with bit 30 as the device has it; an enabled PDO without one gets the predefined."""
    default = _default(draft.od, _COMMUNICATION[kind] + number - 1, 1) or 0
    if isinstance(pdo.cob_id, int):
        return pdo.cob_id | default & NO_RTR
    predefined = _PREDEFINED[kind] + 0x100 * (number - 1) + draft.node.node_id
    if pdo.cob_id is None and default & 0x7FF:
        return default & ~DISABLED
    if number > len(("1", "2", "3", "4")):
        draft.complain(f"{kind}.{number}", "only PDO 1 to 4 have a predefined COB-ID; give cob_id a number")
    return predefined | default & NO_RTR


def _mapped(draft: _Draft, kind: str, number: int, pdo: PdoConfig | None) -> tuple[MappedObject, ...]:
    """Return the objects of a PDO, from bus.yml or from the EDS, with the types the EDS gives them."""
    key = f"{kind}.{number}.mapping"
    wanted = _default_mapping(draft.od, kind, number)
    if pdo is not None and pdo.mapping is not None:
        wanted = [(entry.index, entry.sub_index) for entry in pdo.mapping]
    objects = [mapped for address in wanted if (mapped := _map_one(draft, kind, key, *address)) is not None]
    if (bits := sum(mapped.bits for mapped in objects)) > LARGEST_PDO:
        draft.complain(key, f"{bits} bits, a PDO holds {LARGEST_PDO}")
    return tuple(objects)


def _map_one(draft: _Draft, kind: str, key: str, index: int, subindex: int) -> MappedObject | None:
    entry = draft.od.get(index, subindex)
    if entry is None:
        draft.complain(key, f"0x{index:04X}:{subindex:02X} is not in {draft.node.dcf}")
        return None
    if not _mappable(entry, kind):
        draft.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} cannot be mapped into a {kind.upper()}")
    if (bits := entry.data_type.bits) is None:
        draft.complain(key, f"0x{index:04X}:{subindex:02X} {entry.name} has no fixed length")
        return None
    return MappedObject(index, subindex, bits, entry.data_type)


def _mappable(entry: Entry, kind: str) -> bool:
    return entry.rpdo_mappable if kind == "rpdo" else entry.tpdo_mappable


def _default_mapping(od: ObjectDictionary, kind: str, number: int) -> Sequence[tuple[int, int]]:
    mapping = _MAPPING[kind] + number - 1
    count = _default(od, mapping, 0) or 0
    entries = [_default(od, mapping, slot) or 0 for slot in range(1, min(count, 64) + 1)]
    return [(value >> 16, value >> 8 & 0xFF) for value in entries if value]


def _default(od: ObjectDictionary, index: int, subindex: int) -> int | None:
    entry = od.get(index, subindex)
    return entry.value if entry is not None and isinstance(entry.value, int) else None


def _signature(value: object) -> object:
    """Return the signature that a word of store and restore (0x1010, 0x1011) stands for."""
    return {"save": 0x65766173, "load": 0x64616F6C}.get(value, value) if isinstance(value, str) else value
