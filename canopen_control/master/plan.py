"""Configuration plan of a node: SDO writes and PDO mappings derived from bus.yml and EDS.

All decisions are made before the first frame is sent; an object missing from the EDS, a value outside the range of its
type, or a mapping of more than 64 bits is a configuration error, not a boot error.

The writes are in this order: objects of SYNC, the downloads of a `configuration_file` or the ParameterValues of a DCF,
RPDOs, TPDOs (`plan_pdos.py`), the `sdo:` list, and supervision. So bus.yml takes precedence over a file, and no write
can switch off the supervision of a node unnoticed: `NodePlan.unsupervised` is computed from the values in the node
after all writes. Writes that this package adds have a `reason`: the drive monitors the master (0x1016), stops when the
master is lost (0x1029 or 0x6007), interpolates over the SYNC period (0x60C2), and has no valid PDO that is not
configured.

The controlword of an axis is never written. Public bus.yml files enable a drive by their `sdo:` list (6, 7, 15), and a
DCF that a manufacturer's tool saved while the drive was enabled has 0x6040 = 0x000F.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from canopen_control.cia301.heartbeat import consumer_entry, parse_consumer_entry
from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.cia301.sync import PRODUCER_BIT, SYNC_COB_ID
from canopen_control.cia402.modes import mode_name
from canopen_control.cia402.motors import MODES, MotorMap, per_motor, problem_of
from canopen_control.cia402.objects import (
    ABORT_CONNECTION_OPTION,
    AXES,
    CONTROLWORD,
    FEED_CONSTANT,
    GEAR_RATIO,
    POLARITY,
    POSITION_ENCODER_RESOLUTION,
    STATUSWORD,
    TARGET_POSITION,
    TARGET_TORQUE,
    TARGET_VELOCITY,
    axis_index,
)
from canopen_control.frame import Service, cob_id, is_restricted
from canopen_control.master.plan_builder import (
    STORED,
    PlanBuilder,
    PlannedPdo,
    PlannedWrite,
)
from canopen_control.master.plan_identity import (
    check_identity,
    required_identity,
    warn_of_another_node,
    warn_of_bit_rate,
)
from canopen_control.master.plan_motion import add_feed_forward, plan_interpolation, plan_offsets
from canopen_control.master.plan_pdos import is_pdo_record, plan_downloaded_pdos, plan_pdos
from canopen_control.master.plan_signals import plan_signals, warn_of_unwatched_outputs
from canopen_control.od.codec import encode
from canopen_control.od.indices import (
    COB_ID_EMCY,
    COB_ID_SYNC,
    COB_ID_TIME,
    CYCLE_PERIOD,
    ERROR_BEHAVIOUR,
    GUARD_TIME,
    HEARTBEAT_CONSUMER,
    HEARTBEAT_PRODUCER,
    LIFE_FACTOR,
    STORE,
    SYNC_OVERFLOW,
)
from canopen_control.profiles import Profile, profile_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.cia301.pdo import MappedObject
    from canopen_control.master.keys import MasterConfig, NodeConfig, SdoEntry, SupervisionKeys
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.profiles import Signal
    from canopen_control.rpc.messages.robot import NodeIdentity


_INTERFACES = ("position", "velocity", "effort")
STOPPED = 2  # value of 0x1029: change to NMT state STOPPED
FAULT_REACTION = 1  # value of 0x6007: malfunction, with the fault reaction of 0x605E
SUPERVISION = frozenset((HEARTBEAT_CONSUMER, HEARTBEAT_PRODUCER, GUARD_TIME, LIFE_FACTOR, ERROR_BEHAVIOUR))
FACTORS = tuple((index, sub) for index in (POSITION_ENCODER_RESOLUTION, GEAR_RATIO, FEED_CONSTANT) for sub in (1, 2))
"""Objects that determine the position counts per turn."""
UNWATCHED = "it has neither a writable heartbeat consumer (0x1016) nor node guarding"
_MILLISECOND = 1_000_000
_STOPS = "a lost master stops the motor"
_NO_HEARTBEAT = "node guarding replaces the heartbeat, which would disable it"
_NOT_AT_BOOT = (
    "is not written, because a drive must not move before it is enabled: `canopen-control axis enable` and "
    "`canopen-control axis fault-reset` send the controlword"
)


@dataclass(frozen=True, slots=True)
class NodePlan:
    """Plan for the boot of a node; `axes` are the index offsets of its CiA 402 axes, empty for other devices.

    `guard` is (guard time in ns, life time factor) for a node supervised by guarding, else None. `restore` and `save`
    are subindices of 0x1011 and 0x1010, 0 for none. `software_version` is the required value of 0x1F56:01, 0 for any.
    `signals` are the signals of the device profile and of `signals` in bus.yml, by name; `reads` are the objects read
    for them during the boot. `master_timeout_ns` is the time after which the node detects the loss of the master, or 0.
    `unsupervised` is the reason why this loss would not stop the axes after all writes, else "". `expected` are objects
    on which the scales of bus.yml depend and that nothing writes (polarity, encoder, gear and feed), with the values of
    the EDS; `turns` maps each axis offset to the position counts per turn in bus.yml. `motors` maps the objects of a
    device with several motors in one object set: `rpdos`, `tpdos` and `axes` have the addresses of the axes' view,
    `writes` the addresses of the device.
    """

    name: str
    node_id: int
    source: str
    identity: NodeIdentity
    writes: tuple[PlannedWrite, ...]
    rpdos: tuple[PlannedPdo, ...]
    tpdos: tuple[PlannedPdo, ...]
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
    sdo_timeout_ns: int | None = None  # SDO timeout of the boot; None: as configured for the client
    profile: Profile = Profile.NONE
    signals: dict[str, Signal] = field(default_factory=dict)
    reads: tuple[MappedObject, ...] = ()
    master_timeout_ns: int = 0
    unsupervised: str = ""
    expected: tuple[PlannedWrite, ...] = ()
    turns: dict[int, float] = field(default_factory=dict)
    motors: MotorMap | None = None

    @property
    def supervision_ns(self) -> int:
        """Time in ns after which a silent node is considered lost, by heartbeat or guarding; 0 without supervision."""
        return self.heartbeat_timeout_ns or (self.guard[0] * self.guard[1] if self.guard else 0)

    def carried(self, pdos: Sequence[PlannedPdo]) -> set[tuple[int, int]]:
        """Return the addresses of all objects mapped into `pdos`; shared objects have one address per axis."""
        carried = {(mapped.index, mapped.subindex) for pdo in pdos for mapped in pdo.objects}
        shared = {} if self.motors is None else self.motors.shared
        return carried.union(*(shared.get(address, ()) for address in carried))

    def address(self, index: int, subindex: int = 0) -> tuple[int, int]:
        """Convert an axis object's address to its address in the device."""
        return (index, subindex) if self.motors is None else self.motors.address(index, subindex)


def plan_node(builder: PlanBuilder, master: MasterConfig, source: str) -> NodePlan:
    """Plan the configuration of a node; do not use the plan if `builder.complain` was called.

    `source` is the name of the EDS for messages.
    """
    node, od = builder.node, builder.od
    motors = _motors(builder)
    view = od if motors is None else motors.view
    _plan_communication(builder, master)
    profile = Profile(node.profile) if node.profile else profile_of(od)
    signals = plan_signals(builder, profile, tuple(_axes(od)))
    heartbeat_ms = _plan_values(builder, master)
    warn_of_another_node(builder)
    warn_of_bit_rate(builder, master.baudrate)
    guard = _guard(node.supervision) if node.supervision.guarded and not heartbeat_ms else None
    timeout_ms = _master_timeout_ms(builder, master, guarded=guard is not None)
    if not timeout_ms:
        warn_of_unwatched_outputs(builder, signals.values())
    return NodePlan(
        node.name,
        node.node_id,
        source,
        required_identity(node, od),
        builder.ordered_writes(),
        _of_axes(builder.layouts["rpdo"], motors),
        _of_axes(builder.layouts["tpdo"], motors),
        tuple(_axes(view)),
        round(heartbeat_ms * node.supervision.multiplier * _MILLISECOND),
        *_names(od, view),
        guard=guard,
        keep_alive=not node.boot.reset_communication,
        software_version=node.identity.software_version,
        software_file=node.identity.software_file,
        restore=_store_object(builder, 0x1011, node.boot.restore_configuration, "restore_configuration"),
        save=_store_object(builder, 0x1010, node.boot.save_configuration, "save_configuration"),
        boot_up_ns=node.boot.boot_timeout_ms * _MILLISECOND,
        sdo_timeout_ns=master.boot_timeout * _MILLISECOND if master.boot_timeout else None,
        profile=profile,
        signals=signals,
        reads=tuple(builder.reads),
        expected=tuple(_expected(builder)),
        turns=_turns(node, view),
        motors=motors,
        master_timeout_ns=timeout_ms * _MILLISECOND,
        unsupervised=_why_unsupervised(builder, master, monitors=timeout_ms > 0),
    )


def _names(od: ObjectDictionary, view: ObjectDictionary) -> tuple[dict[tuple[int, int], str], dict[int, str]]:
    """Return the names of all entries by address, and the names of the objects in the axes' view by index."""
    entries = {address: entry.name for dictionary in (od, view) for address, entry in dictionary.entries.items()}
    return entries, {index: info.name for index, info in view.objects.items()}


def _plan_communication(builder: PlanBuilder, master: MasterConfig) -> None:
    """Plan SYNC, EMCY, TIME and PDOs, and the downloads of a DCF or concise DCF."""
    node, od = builder.node, builder.od
    _plan_sync_counter(builder, master)
    _plan_services(builder, master)
    if node.boot.time_cob_id is not None:
        builder.write(COB_ID_TIME, 0, node.boot.time_cob_id, "time_cob_id")
    _plan_downloads(builder)
    add_feed_forward(builder, tuple(_axes(od)))
    for kind in ("rpdo", "tpdo"):
        plan_pdos(builder, kind)
    check_identity(builder)


def _plan_values(builder: PlanBuilder, master: MasterConfig) -> int:
    """Plan the `sdo` list, interpolation period, error control and 0x1010; return the heartbeat period in ms."""
    sdo = list(enumerate(builder.node.boot.sdo))
    storing = list(itertools.takewhile(lambda pair: pair[1].index == STORE, reversed(sdo)))[::-1]
    _plan_sdo_list(builder, sdo[: len(sdo) - len(storing)])
    plan_interpolation(builder, tuple(_axes(builder.od)), master.sync_period)
    plan_offsets(builder, tuple(_axes(builder.od)))
    heartbeat_ms = _plan_error_control(builder, master)
    _plan_sdo_list(builder, storing)  # last, so that the whole configuration is stored
    return heartbeat_ms


def _guard(keys: SupervisionKeys) -> tuple[int, int]:
    return keys.guard_time * _MILLISECOND, keys.life_factor


def _motors(builder: PlanBuilder) -> MotorMap | None:
    """Return the object map of a device whose motors share one object set (`motor_subindices`), or None."""
    subindices = builder.node.motion.motor_subindices
    if subindices is None:
        _warn_of_two_motors(builder)
        return None
    if problem := problem_of(builder.od, subindices):
        builder.complain("motor_subindices", f"{builder.file}: {problem}")
        return None
    for kind in _INTERFACES:
        mode = getattr(builder.node.motion, f"{kind}_mode")
        if mode is not None and mode > 0 and mode not in MODES:
            builder.complain(
                f"{kind}_mode",
                f"{mode_name(mode)} starts each motion with bits of the controlword, which is shared by all motors of "
                f"{builder.file} (motor_subindices); set velocity_mode: 3 (PV)",
            )
        if builder.node.motion.own_target(kind) is not None:
            text = "motor_subindices defines the targets of these motors; remove one of the two keys"
            builder.complain(f"{kind}_target", text)
    return MotorMap(builder.od, subindices)


def _of_axes(layouts: Sequence[PlannedPdo], motors: MotorMap | None) -> tuple[PlannedPdo, ...]:
    """Return the PDOs with the object addresses of the axes' view."""
    if motors is None:
        return tuple(layouts)
    return tuple(replace(layout, objects=motors.split(layout.objects)) for layout in layouts)


def _warn_of_two_motors(builder: PlanBuilder) -> None:
    """Warn about a drive with two motors in the subindices of one object set, and name the key for such drives."""
    motors = per_motor(builder.od)
    if not motors or any((builder.node.motion.own_target(name) or (0,))[0] in motors for name in _INTERFACES):
        return
    names = ", ".join(f"0x{index:04X}" for index in motors)
    problem = problem_of(builder.od, (1, 2))
    remedy = f"; they cannot be moved: {problem}" if problem else "; give `motor_subindices: [1, 2]` to move both"
    target = next((index for index in (TARGET_VELOCITY, TARGET_POSITION, TARGET_TORQUE) if index in motors), None)
    if target is not None:
        kind = {TARGET_POSITION: "position", TARGET_TORQUE: "effort"}.get(target, "velocity")
        remedy += f", or `{kind}_mode` with `{kind}_target: 0x{target:04X}:01` to move one of them without feedback"
    builder.warn(
        "dcf",
        f"{names} of {builder.file} have a subindex for each of two motors, behind one controlword (as ZLTECH's "
        f"ZLAC8015D){remedy}",
    )


def _turns(node: NodeConfig, od: ObjectDictionary) -> dict[int, float]:
    """Return the position counts per turn by axis offset; axes without a scale in bus.yml are omitted."""
    turns = {}
    for number, offset in enumerate(_axes(od)):
        if node.units.gives(number, "scale_pos_to_dev"):
            turns[offset] = node.units.counts_per_revolution or abs(node.units.of_axis(number)["pos_to_dev"]) * math.tau
    return turns


def _expected(builder: PlanBuilder) -> Iterator[PlannedWrite]:
    """Yield the unwritten objects for polarity and scaling, whose values must equal the defaults of the EDS.

    They are polarity (0x607E) and, with a scale in bus.yml, encoder, gear and feed (0x608F, 0x6091, 0x6092). The plan
    does not write them, because they describe motor and mechanics: a commissioned drive has the right values.
    """
    scaled = _turns(builder.node, builder.od)
    for offset in _axes(builder.od):
        factors = FACTORS if offset in scaled else ()
        for index, subindex in ((POLARITY, 0), *factors):
            entry = builder.od.get(index + offset, subindex)
            if entry is None or not entry.readable or not isinstance(entry.default, int):
                continue
            if builder.requested_value(index + offset, subindex) is None:
                data = encode(entry.default, entry.data_type)
                yield PlannedWrite(*entry.address, data, entry.name, STORED, data_type=entry.data_type)


def _axes(od: ObjectDictionary) -> Iterator[int]:
    for axis in range(AXES):
        controlword = axis_index(CONTROLWORD, axis)
        if (controlword, 0) in od and (axis_index(STATUSWORD, axis), 0) in od:
            yield controlword - CONTROLWORD


def _store_object(builder: PlanBuilder, index: int, subindex: int, key: str) -> int:
    # CiA 301, 7.5.2.13 and 7.5.2.14: a device may lack subindices of 0x1010 and 0x1011
    if subindex and (index, subindex) not in builder.od:
        builder.complain(key, f"0x{index:04X}:{subindex:02X} is not in {builder.file}")
    return subindex


def _plan_error_control(builder: PlanBuilder, master: MasterConfig) -> int:
    """Plan error control in both directions (0x1016, 0x1017, guarding, 0x1029, 0x6007).

    Return the heartbeat period of the node in ms. Keys of bus.yml take precedence over the `sdo:` list, the list over
    the defaults of this package, and these over a file.
    """
    keys = builder.node.supervision
    _plan_consumer(builder, master)
    period = _plan_producer(builder)
    guarded = keys.guarded and not period
    for key, index, value in (
        ("guard_time", GUARD_TIME, keys.guard_time),
        ("life_time_factor", LIFE_FACTOR, keys.life_time_factor),
    ):
        if value:
            builder.write(index, 0, value if guarded else 0, key)
    if guarded and not keys.life_time_factor:
        builder.write(LIFE_FACTOR, 0, keys.life_factor, "guard_time", "the node detects the loss of node guarding")
    for subindex, value in keys.error_behavior.items():
        builder.write(ERROR_BEHAVIOUR, subindex, value, "error_behavior")
    for subindex in builder.od.subindices(ERROR_BEHAVIOUR)[1:]:
        if subindex not in keys.error_behavior and subindex != 1:
            builder.write_downloaded(ERROR_BEHAVIOUR, subindex)
    _plan_reactions(builder)
    return period


def _plan_consumer(builder: PlanBuilder, master: MasterConfig) -> None:
    """Plan the consumer entry in 0x1016 for the master's heartbeat; entries for other nodes are kept.

    Devices refuse two entries for one node (CiA 301, 7.5.2.19), so an existing entry for the master is used.
    """
    keys, od = builder.node.supervision, builder.od
    subindices = od.subindices(HEARTBEAT_CONSUMER)[1:]
    if keys.heartbeat_consumer is False or not subindices:
        for subindex in subindices:
            builder.write_downloaded(HEARTBEAT_CONSUMER, subindex)
        if keys.heartbeat_consumer:
            _report_no_consumer(builder)
        return
    # CiA 301, 7.5.2.19: the heartbeat time is UNSIGNED16, in ms
    timeout = min(round(master.heartbeat_ms * keys.multiplier), 0xFFFF)
    listed = {entry.sub_index for entry in builder.node.boot.sdo if entry.index == HEARTBEAT_CONSUMER}
    entries = {
        subindex: parse_consumer_entry(builder.final(HEARTBEAT_CONSUMER, subindex) or 0) for subindex in subindices
    }
    if keys.heartbeat_consumer is None and any(
        entries[subindex][0] == master.node_id and entries[subindex][1] for subindex in listed & entries.keys()
    ):
        return  # the time is in the `sdo:` list
    overwrite = keys.heartbeat_consumer or not listed
    usable = [
        sub for sub in subindices if builder.can_write(HEARTBEAT_CONSUMER, sub) and (overwrite or sub not in listed)
    ]

    def fitness(subindex: int) -> tuple[bool, bool, bool]:
        node_id, ms = entries[subindex]
        return node_id != master.node_id, bool(ms and node_id), subindex in listed

    chosen = min(usable, key=fitness, default=subindices[0] if overwrite else None)
    if chosen is None:
        return
    for subindex in subindices:
        node_id, ms = entries[subindex]
        if subindex != chosen and subindex not in listed:
            if node_id == master.node_id and ms:
                reason = f"0x1016:{chosen:02X} monitors the master"
                builder.write(HEARTBEAT_CONSUMER, subindex, 0, "dcf", reason, optional=True)
            else:
                builder.write_downloaded(HEARTBEAT_CONSUMER, subindex)
    reason = "" if keys.heartbeat_consumer else "the node detects the loss of the master"
    builder.write(HEARTBEAT_CONSUMER, chosen, consumer_entry(master.node_id, timeout), "heartbeat_consumer", reason)
    builder.note_overruled(HEARTBEAT_CONSUMER, chosen, "heartbeat_consumer")


def _report_no_consumer(builder: PlanBuilder) -> None:
    """Report `heartbeat_consumer: true` of a node without 0x1016; a warning if nothing depends on it.

    For axes that nothing stops, the missing supervision is the error, which has the remedy.
    """
    text = f"0x1016:01 is not in {builder.file}, so the node cannot monitor the master"
    if builder.node.supervision.allow_unsupervised or builder.node.supervision.guarded:
        builder.warn("heartbeat_consumer", f"{text}; write false")
    elif not tuple(_axes(builder.od)):
        builder.complain("heartbeat_consumer", f"{text}; write false")


def _plan_producer(builder: PlanBuilder) -> int:
    """Plan the heartbeat producer time (0x1017); return the node's heartbeat period in ms, or 0 without a heartbeat.

    A file may give another period than the default, but a period of 0 in a file is ignored, because a DCF lists every
    object with its default.
    """
    keys = builder.node.supervision
    fixed = 0 if builder.can_write(HEARTBEAT_PRODUCER, 0) else builder.default(HEARTBEAT_PRODUCER, 0) or 0
    # CiA 301, 7.2.8.3.2: heartbeat or node guarding, not both
    if keys.guarded:
        if fixed:
            text = f"0x1017 is {fixed} ms and cannot be written: the node sends heartbeats, which disable guarding"
            builder.warn("guard_time", f"{text} (CiA 301, 7.2.8.3); the heartbeat is monitored instead")
        elif builder.can_write(HEARTBEAT_PRODUCER, 0):
            builder.write(HEARTBEAT_PRODUCER, 0, 0, "guard_time", _NO_HEARTBEAT)
            builder.note_overruled(HEARTBEAT_PRODUCER, 0, "guard_time")
        return fixed
    if not keys.heartbeat_producer:
        if (listed := builder.listed_value(HEARTBEAT_PRODUCER)) is not None:
            if not listed:
                builder.warn("sdo", "0x1017 is set to 0: the master cannot detect the loss of this node")
            return listed
        if fixed or not builder.can_write(HEARTBEAT_PRODUCER, 0):
            if not fixed:
                cannot = "cannot be written" if (HEARTBEAT_PRODUCER, 0) in builder.od else f"is not in {builder.file}"
                can_guard = builder.can_write(GUARD_TIME, 0) and builder.can_write(LIFE_FACTOR, 0)
                remedy = "set guard_time" if can_guard else "it has no node guarding (0x100C, 0x100D) either"
                builder.warn("dcf", f"0x1017 {cannot}: the master cannot detect the loss of this node; {remedy}")
            return fixed
        if period := builder.downloaded_value(HEARTBEAT_PRODUCER):
            builder.write_downloaded(HEARTBEAT_PRODUCER, 0)
            return period
    reason = "" if keys.heartbeat_producer else "the master detects the loss of the drive"
    builder.write(HEARTBEAT_PRODUCER, 0, keys.heartbeat_ms, "heartbeat_producer", reason)
    builder.note_overruled(HEARTBEAT_PRODUCER, 0, "heartbeat_producer" if keys.heartbeat_producer else "the default")
    return keys.heartbeat_ms


def _plan_reactions(builder: PlanBuilder) -> None:
    """Plan the axes' reaction to the loss of the master: 0x6007 if the axis has it, else 0x1029:1 = stopped.

    A value of 0x6007 in a file is kept unless it is 0, which means no reaction; a value of 0x1029:1 in a file is kept
    only if no axis depends on it.
    """
    keys = builder.node.supervision
    monitors = keys.heartbeat_consumer is not False or keys.guarded
    by_nmt = False  # whether an axis is stopped by the NMT state alone
    # CiA 402-2: 0x6007, the reaction to the loss of communication; CiA 301, 7.5.2.32: 0x1029
    for offset in _axes(builder.od):
        index = ABORT_CONNECTION_OPTION + offset
        if (index, 0) not in builder.od:
            by_nmt = True
            continue
        if builder.listed_value(index) is None:
            if builder.downloaded_value(index) or not monitors:
                builder.write_downloaded(index, 0)
            else:
                builder.write(index, 0, FAULT_REACTION, "dcf", _STOPS)
                builder.note_overruled(index, 0, "the default")
        by_nmt = by_nmt or not (builder.can_write(index, 0) or builder.default(index, 0))
    is_configured = 1 in keys.error_behavior or builder.listed_value(ERROR_BEHAVIOUR, 1) is not None
    if is_configured or (ERROR_BEHAVIOUR, 1) not in builder.od:
        return
    if by_nmt and monitors:
        builder.write(ERROR_BEHAVIOUR, 1, STOPPED, "error_behavior", _STOPS)
        builder.note_overruled(ERROR_BEHAVIOUR, 1, "the default")
    else:
        builder.write_downloaded(ERROR_BEHAVIOUR, 1)


def _master_timeout_ms(builder: PlanBuilder, master: MasterConfig, *, guarded: bool) -> int:
    """Return the time after which a node detects the loss of the master, or 0; warn if the timeout is too short."""
    # CiA 301, 7.5.2.11 and 7.5.2.12: a product of 0 disables life guarding
    if guarded and (life := (builder.final(GUARD_TIME, 0) or 0) * (builder.final(LIFE_FACTOR, 0) or 0)):
        return life
    consumers = [
        parse_consumer_entry(builder.final(HEARTBEAT_CONSUMER, sub) or 0)
        for sub in builder.od.subindices(HEARTBEAT_CONSUMER)[1:]
    ]
    times = [ms for node_id, ms in consumers if node_id == master.node_id and ms]
    cycle_ms = master.sync_period / 1000  # heartbeats are sent at the edges of the cycle
    beat_ms = math.ceil(master.heartbeat_ms / cycle_ms) * cycle_ms if cycle_ms else master.heartbeat_ms
    if times and min(times) <= beat_ms:
        every = "" if beat_ms == master.heartbeat_ms else ", with this sync_period,"
        builder.warn(
            "heartbeat_consumer",
            f"the consumer time in 0x1016 is {min(times)} ms, the heartbeat period of the master{every} {beat_ms:g} "
            "ms: the node repeatedly reports the master as lost; set the time of three heartbeats",
        )
    return min(times, default=0)


def _why_unsupervised(builder: PlanBuilder, master: MasterConfig, *, monitors: bool) -> str:
    """Return why the loss of the master would not stop a node's axes after the boot, or "" if it would."""
    axes = tuple(_axes(builder.od))
    if not axes:
        return ""
    if not monitors:
        if (listed := builder.listed_value(HEARTBEAT_CONSUMER, 1)) is not None:
            return f"the sdo: list sets 0x1016:01 to 0x{listed:08X}, which does not monitor node {master.node_id}"
        if builder.node.supervision.heartbeat_consumer is False and builder.can_write(HEARTBEAT_CONSUMER, 1):
            return "heartbeat_consumer is false, so that it does not monitor the master"
        return UNWATCHED
    for offset in axes:
        index = ABORT_CONNECTION_OPTION + offset
        if (index, 0) in builder.od:
            if not builder.final(index, 0):
                return f"it detects the loss, but 0x{index:04X} = 0 lets the motor continue to turn"
        elif (ERROR_BEHAVIOUR, 1) in builder.od and builder.final(ERROR_BEHAVIOUR, 1) != STOPPED:
            value = builder.final(ERROR_BEHAVIOUR, 1)
            return f"it has no 0x{index:04X}, and 0x1029:01 = {value} lets the motor continue to turn; 2 stops it"
    return ""


def _plan_sync_counter(builder: PlanBuilder, master: MasterConfig) -> None:
    if not master.sync_overflow or builder.is_requested(SYNC_OVERFLOW):
        return
    if (SYNC_OVERFLOW, 0) in builder.od:
        period = builder.default(CYCLE_PERIOD, 0) if builder.can_write(CYCLE_PERIOD, 0) else 0
        if period:  # 0x1019 is refused while it is not 0 (CiA 301, 7.5.2.22)
            builder.write(CYCLE_PERIOD, 0, 0, "dcf", "0x1019 can be written only while 0x1006 is 0", optional=True)
        builder.write(SYNC_OVERFLOW, 0, master.sync_overflow, "dcf", "the master's SYNC contains a counter")
        if period:
            builder.write(CYCLE_PERIOD, 0, period, "dcf", "the former value", optional=True)
    else:
        builder.warn(
            "dcf", f"0x1019 is not in {builder.file}, but SYNC contains a counter: the node may send EMCY 0x8240"
        )


def _plan_services(builder: PlanBuilder, master: MasterConfig) -> None:
    """Plan writes of the COB-IDs of SYNC (0x1005) and EMCY (0x1014).

    A different value in the `sdo:` list is kept, with a warning. With `sync_producer: other`, 0x1005 of a node that
    produces SYNC (bit 30) is not changed.
    """
    if master.sync_producer != "other" or not (builder.default(COB_ID_SYNC, 0) or 0) & PRODUCER_BIT:
        _plan_service(builder, COB_ID_SYNC, SYNC_COB_ID, "the COB-ID of the master's SYNC")
    _plan_service(
        builder, COB_ID_EMCY, cob_id(Service.EMCY, builder.node.node_id), "the COB-ID on which the master receives EMCY"
    )


def _plan_service(builder: PlanBuilder, index: int, identifier: int, purpose: str) -> None:
    """Plan the COB-ID of a service (object `index`) if the node has that object; `purpose` names it in messages."""
    if (index, 0) not in builder.od:
        return
    listed = builder.listed_value(index)
    if listed is not None:
        if listed & 0x7FF != identifier:  # bits 30 and 31 may differ: a node that sends SYNC, or no EMCY
            builder.warn("sdo", f"0x{index:04X} = 0x{listed:X} is not {purpose}, 0x{identifier:03X}")
        return
    default = builder.default(index, 0)
    if not builder.can_write(index, 0):
        if default is not None and default & 0x7FF != identifier:
            builder.warn(
                "dcf",
                f"0x{index:04X} = 0x{default:X} in {builder.file} cannot be written, and is not {purpose}, "
                f"0x{identifier:03X}",
            )
        return
    if default is not None and not default & INVALID_BIT and is_restricted(default & 0x7FF):
        builder.remark(
            "dcf",
            f"0x{index:04X} = 0x{default:X} in {builder.file} is not a valid COB-ID; 0x{identifier:03X} is written",
        )
    same = default is not None and default & (0x7FF | INVALID_BIT if index == COB_ID_EMCY else 0xFFFFFFFF) == identifier
    value = default if same else identifier
    builder.write(index, 0, value, "dcf", STORED if same else purpose, optional=True)
    builder.note_overruled(index, 0, purpose)


def _plan_downloads(builder: PlanBuilder) -> None:
    """Plan the downloads of a DCF or concise DCF, except SYNC, EMCY, error control and PDOs that bus.yml configures."""
    axes = tuple(_axes(builder.od))
    supervision = SUPERVISION | {COB_ID_SYNC, COB_ID_EMCY} | {ABORT_CONNECTION_OPTION + offset for offset in axes}
    for index, subindex, data in builder.downloads:
        if index - CONTROLWORD in axes:
            if word := int.from_bytes(data, "little"):
                key = "configuration_file" if builder.node.boot.configuration_file else "dcf"
                builder.remark(key, f"0x{index:04X} = 0x{word:X} {builder.download_reason} {_NOT_AT_BOOT}")
        elif not is_pdo_record(index) and index not in supervision:
            builder.write_raw(index, subindex, data, builder.download_reason)
    plan_downloaded_pdos(builder)


def _plan_sdo_list(builder: PlanBuilder, entries: Sequence[tuple[int, SdoEntry]]) -> None:
    axes = tuple(_axes(builder.od))
    written: dict[tuple[int, int], object] = {}
    for number, entry in entries:
        if entry.index - CONTROLWORD in axes:
            builder.warn(f"sdo[{number}]", f"0x{entry.index:04X} = {_number(entry.value)} {_NOT_AT_BOOT}; remove it")
            continue
        if is_pdo_record(entry.index) and (entry.index, entry.sub_index) in builder.od:
            continue  # planned together with the PDO
        address = entry.index, entry.sub_index
        if written.get(address) == entry.value:
            builder.warn(
                f"sdo[{number}].index",
                f"0x{address[0]:04X}:{address[1]:02X} is written twice; was another object meant?",
            )
        written[address] = entry.value
        builder.write(*address, _signature(entry.value), f"sdo[{number}]")


def _number(value: object) -> str:
    return f"0x{value:X}" if isinstance(value, int) else str(value)


def _signature(value: object) -> object:
    """Replace `save` and `load` by the signatures for 0x1010 and 0x1011 (CiA 301, 7.5.2.13); keep other values."""
    return {"save": 0x65766173, "load": 0x64616F6C}.get(value, value) if isinstance(value, str) else value
