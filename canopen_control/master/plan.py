"""The configuration plan of a node: a list of SDO writes and a PDO layout, made of bus.yml and the EDS.

The law of the file: everything is decided here, before the first frame is sent, and whatever does not fit (an object
the EDS lacks, a value out of its type, a mapping over 64 bits) is an error of the configuration, not of the boot.

The order is the one of ros2_canopen's generator: error control, RPDOs, TPDOs (`plan_pdos.py`), then the `sdo:` list;
a `configuration_file` or the ParameterValues of a DCF go before them, so that bus.yml has the last word. What this
package adds has a `reason`: the drive watches the master (0x1016), stops when it is lost (0x1029 or 0x6007),
interpolates over the SYNC period (0x60C2), and has no live PDO that nobody configured.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import consumer_entry
from canopen_control.cia402.objects import AXES, CONTROLWORD, STATUSWORD, axis_index
from canopen_control.master.plan_builder import PdoLayout, PlanBuilder, PlannedWrite
from canopen_control.master.plan_feed_forward import add_feed_forward
from canopen_control.master.plan_interpolation import plan_interpolation
from canopen_control.master.plan_pdos import is_pdo_record, plan_downloaded_pdos, plan_pdos
from canopen_control.master.plan_signals import plan_signals
from canopen_control.profiles.device_type import Profile, profile_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.keys import MasterConfig, NodeConfig, SupervisionKeys
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.profiles.device_signal import Signal

__all__ = ["CONSUMER", "Identity", "NodePlan", "PdoLayout", "PlanInput", "PlannedWrite", "make_plan"]

CONSUMER, PRODUCER, GUARD_TIME, LIFE_TIME, ERROR_BEHAVIOUR = 0x1016, 0x1017, 0x100C, 0x100D, 0x1029
TIME_COB_ID, SYNC_OVERFLOW = 0x1012, 0x1019
ABORT_CONNECTION = 0x6007
STOPPED = 2  # 0x1029: to NMT stopped
FAULT_REACTION = 1  # 0x6007: malfunction, then the fault reaction of 0x605E
_MILLISECOND = 1_000_000
_STOPS = "a lost master stops the motor"


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
    """Everything the boot of a node needs; `axes` are the index offsets of its CiA 402 axes, none for other devices.

    `guard` is (guard time in ns, life time factor) of a node watched by guarding; `restore` and `save` are subindices
    of 0x1011 and 0x1010, 0 for neither; `software_version` is what 0x1F56:01 must hold, 0 for anything. `signals` are
    those of a device that is no drive, and of `signals` in bus.yml, by name; `reads` is what the boot reads for them.
    """

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
    object_names: dict[int, str] = field(default_factory=dict)
    guard: tuple[int, int] | None = None
    keep_alive: bool = False
    software_version: int = 0
    software_file: str = ""
    restore: int = 0
    save: int = 0
    boot_up_ns: int = 1000 * _MILLISECOND
    sdo_timeout_ns: int | None = None  # of the boot; None: the client's own
    profile: Profile = Profile.NONE
    signals: dict[str, Signal] = field(default_factory=dict)
    reads: tuple[MappedObject, ...] = ()

    @property
    def supervision_ns(self) -> int:
        """After which silence the node counts as lost, by heartbeat or guarding; 0 for a node nobody watches."""
        return self.heartbeat_timeout_ns or (self.guard[0] * self.guard[1] if self.guard else 0)


@dataclass(frozen=True, slots=True)
class PlanInput:
    """What a plan is made of; `complain(key, text)`, `warn` and `note` take what is wrong, odd, or without effect.

    `downloads` are those of a `configuration_file` or of a DCF's ParameterValues; `source` names the EDS in messages;
    `spare_cob_ids` are for PDOs above 4 with `cob_id: auto`, one supply for the whole bus.
    """

    node: NodeConfig
    od: ObjectDictionary
    source: str
    master: MasterConfig
    complain: Callable[[str, str], None]
    warn: Callable[[str, str], None]
    note: Callable[[str, str], None]
    downloads: tuple[tuple[int, int, bytes], ...] = ()
    spare_cob_ids: Iterator[int] = field(default_factory=lambda: itertools.count(0x680))


def make_plan(given: PlanInput) -> NodePlan:
    """Plan a node; where something was complained of the plan is not to be used."""
    node, od = given.node, given.od
    builder = PlanBuilder(node, od, given.complain, given.warn, given.note, given.spare_cob_ids, given.downloads)
    heartbeat_ms = _plan_error_control(builder, given.master)
    _plan_sync_counter(builder, given.master)
    _plan_downloads(builder)
    add_feed_forward(builder, tuple(_axes(od)))
    for kind in ("rpdo", "tpdo"):
        plan_pdos(builder, kind)
    _check_identity(builder)
    profile = Profile(node.profile) if node.profile else profile_of(od)
    signals = plan_signals(builder, profile, tuple(_axes(od)))
    _plan_sdo_list(builder)
    plan_interpolation(builder, tuple(_axes(od)), given.master.sync_period)
    return NodePlan(
        node.name,
        node.node_id,
        given.source,
        _identity(node, od),
        builder.ordered_writes(),
        tuple(builder.layouts["rpdo"]),
        tuple(builder.layouts["tpdo"]),
        tuple(_axes(od)),
        round(heartbeat_ms * node.supervision.multiplier * _MILLISECOND),
        {address: entry.name for address, entry in od.entries.items()},
        {index: info.name for index, info in od.objects.items()},
        guard=_guard(node.supervision) if node.supervision.guarded and not heartbeat_ms else None,
        keep_alive=not node.boot.reset_communication,
        software_version=node.identity.software_version,
        software_file=node.identity.software_file,
        restore=_store_object(builder, 0x1011, node.boot.restore_configuration, "restore_configuration"),
        save=_store_object(builder, 0x1010, node.boot.save_configuration, "save_configuration"),
        boot_up_ns=node.boot.boot_timeout_ms * _MILLISECOND,
        sdo_timeout_ns=given.master.boot_timeout * _MILLISECOND if given.master.boot_timeout else None,
        profile=profile,
        signals=signals,
        reads=tuple(builder.reads),
    )


def _guard(keys: SupervisionKeys) -> tuple[int, int]:
    return keys.guard_time * _MILLISECOND, keys.life_factor


def _check_identity(builder: PlanBuilder) -> None:
    """Warn where bus.yml names another vendor or product than the EDS: then the file is that of another device."""
    given, device = builder.node.identity, builder.od.device
    for key, value, known in (
        ("vendor_id", given.vendor_id, device.vendor_number),
        ("product_code", given.product_code, device.product_number),
    ):
        if value and known and value != known:
            text = f"0x{value:X} is asked of the device, {builder.file} is for 0x{known:X}; correct one of them"
            builder.warn(key, text)


def _identity(node: NodeConfig, od: ObjectDictionary) -> Identity:
    """Take vendor and product from bus.yml, else the EDS; revision and serial from bus.yml only. 0 checks nothing.

    From the EDS only where it has the subindex: of 0x1018 a device must have no more than the vendor (CiA 301,
    7.5.2.21), and some have not even that. What [DeviceInfo] says cannot be asked of them.
    """

    def default(index: int, subindex: int, device: int | None, given: int | None = None) -> int:
        entry = od.get(index, subindex)
        if given is not None:
            return given
        if entry is None:
            return 0
        return entry.default if isinstance(entry.default, int) else device or 0

    return Identity(
        device_type=default(0x1000, 0, None),
        vendor_id=default(0x1018, 1, od.device.vendor_number, node.identity.vendor_id),
        product_code=default(0x1018, 2, od.device.product_number, node.identity.product_code),
        revision_number=node.identity.revision_number or 0,
        serial_number=node.identity.serial_number or 0,
        eds_revision=0 if node.identity.revision_number is not None else default(0x1018, 3, od.device.revision_number),
    )


def _axes(od: ObjectDictionary) -> Iterator[int]:
    for axis in range(AXES):
        controlword = axis_index(CONTROLWORD, axis)
        if (controlword, 0) in od and (axis_index(STATUSWORD, axis), 0) in od:
            yield controlword - CONTROLWORD


def _store_object(builder: PlanBuilder, index: int, subindex: int, key: str) -> int:
    if subindex and (index, subindex) not in builder.od:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} is not in {builder.file}")
    return subindex


def _plan_error_control(builder: PlanBuilder, master: MasterConfig) -> int:
    """Let the drive watch the master and be watched: 0x1016, 0x1012, 0x1017, guarding, 0x1029. Return its period."""
    keys, od = builder.node.supervision, builder.od
    if (CONSUMER, 1) in od and keys.heartbeat_consumer is not False:
        timeout = min(round(master.heartbeat_ms * keys.multiplier), 0xFFFF)
        reason = "" if keys.heartbeat_consumer else "the node notices when the master dies"
        free = (sub for sub in od.subindices(CONSUMER)[1:] if builder.can_write(CONSUMER, sub))
        builder.write(CONSUMER, next(free, 1), consumer_entry(master.node_id, timeout), "heartbeat_consumer", reason)
    elif keys.heartbeat_consumer:
        builder.complain(
            "heartbeat_consumer", f"0x1016:01 is not in {builder.file}, so the node cannot watch the master"
        )
    if builder.node.boot.time_cob_id is not None:
        builder.write(TIME_COB_ID, 0, builder.node.boot.time_cob_id, "time_cob_id")
    period = _plan_producer(builder)
    for key, index, value in (
        ("guard_time", GUARD_TIME, keys.guard_time),
        ("life_time_factor", LIFE_TIME, keys.life_time_factor),
    ):
        if value:
            builder.write(index, 0, value if keys.guarded else 0, key)
    if keys.guarded and not keys.life_time_factor:
        builder.write(LIFE_TIME, 0, keys.life_factor, "guard_time", "the node notices when it is guarded no more")
    for subindex, value in keys.error_behavior.items():
        builder.write(ERROR_BEHAVIOUR, subindex, value, "error_behavior")
    for offset in _axes(od):
        _plan_abort_reaction(builder, offset)
    return period


def _plan_producer(builder: PlanBuilder) -> int:
    """Return the node's heartbeat period in ms, and write it unless the `sdo:` list or a file does."""
    keys = builder.node.supervision
    asked = builder.asked_value(PRODUCER)
    if asked is not None and not keys.heartbeat_producer:
        return asked
    if keys.heartbeat_ms and not keys.heartbeat_producer and not builder.can_write(PRODUCER, 0):
        period = builder.default(PRODUCER, 0) or 0
        if not period:
            cannot = "cannot be written" if (PRODUCER, 0) in builder.od else f"is not in {builder.file}"
            builder.warn("dcf", f"0x1017 {cannot}: nobody notices when this node dies; give it guard_time")
        return period
    if keys.heartbeat_ms:
        reason = "" if keys.heartbeat_producer else "the master notices when the drive dies"
        builder.write(PRODUCER, 0, keys.heartbeat_ms, "heartbeat_producer", reason)
    return keys.heartbeat_ms


def _plan_abort_reaction(builder: PlanBuilder, offset: int) -> None:
    """Let a lost master stop the motor: 0x6007 where it exists, else 0x1029:1 = stopped."""
    keys, od = builder.node.supervision, builder.od
    if keys.heartbeat_consumer is False and not keys.guarded:
        return
    index = ABORT_CONNECTION + offset
    if (index, 0) in od:
        if builder.asked_for(index):
            return
        builder.write(index, 0, FAULT_REACTION, "dcf", _STOPS)
        if builder.can_write(index, 0) or builder.default(index, 0):
            return
    asked = 1 in keys.error_behavior or builder.asked_for(ERROR_BEHAVIOUR)
    if not offset and (ERROR_BEHAVIOUR, 1) in od and not asked:
        builder.write(ERROR_BEHAVIOUR, 1, STOPPED, "error_behavior", _STOPS)


def _plan_sync_counter(builder: PlanBuilder, master: MasterConfig) -> None:
    if not master.sync_overflow or builder.asked_for(SYNC_OVERFLOW):
        return
    if (SYNC_OVERFLOW, 0) in builder.od:
        builder.write(SYNC_OVERFLOW, 0, master.sync_overflow, "dcf", "the master's SYNC carries a counter")
    else:
        builder.warn("dcf", f"0x1019 is not in {builder.file}, and SYNC carries a counter: it may answer EMCY 0x8240")


def _plan_downloads(builder: PlanBuilder) -> None:
    """Plan what a concise DCF or a DCF downloads, but the PDOs that bus.yml configures itself."""
    for index, subindex, data in builder.downloads:
        if not is_pdo_record(index):
            builder.write_raw(index, subindex, data, builder.download_reason)
    plan_downloaded_pdos(builder)


def _plan_sdo_list(builder: PlanBuilder) -> None:
    seen: dict[tuple[int, int], object] = {}
    for number, entry in enumerate(builder.node.boot.sdo):
        address = entry.index, entry.sub_index
        if seen.get(address) == entry.value:
            builder.warn(
                f"sdo[{number}].index",
                f"0x{address[0]:04X}:{address[1]:02X} is written twice; was one meant for another?",
            )
        seen[address] = entry.value
        builder.write(*address, _signature(entry.value), f"sdo[{number}]")


def _signature(value: object) -> object:
    """Return the signature that a word of store and restore (0x1010, 0x1011) stands for."""
    return {"save": 0x65766173, "load": 0x64616F6C}.get(value, value) if isinstance(value, str) else value
