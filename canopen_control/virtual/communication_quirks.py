"""Quirks of SDO, PDOs, NMT, error control and EMCY (CiA 301)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.nmt import NmtCommand, NmtState
from canopen_control.cia301.sdo_server import SdoServerAbort
from canopen_control.frame import CanFrame
from canopen_control.od.indices import TPDO
from canopen_control.virtual.fault_effects import (
    is_heartbeat,
    is_sdo_answer,
    is_sdo_request,
    refuses_blocks,
    refuses_mapping,
    refusing,
    start_by_itself,
)
from canopen_control.virtual.quirk_base import (
    Quirk,
    Strength,
    apply_switch,
    filter_frames,
    hide_objects,
    in_seconds,
    pdo_mappings,
    pdo_records,
    whole,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.object_store import Guard
    from canopen_control.virtual.quirk_base import NodeAct, QuirkHooks, Sent
    from canopen_control.virtual.virtual_node import VirtualNode


_MS, _S = 1_000_000, 1_000_000_000
_SDO = "CiA 301, 7.2.4.3 (SDO)"
_NMT = "CiA 301, 7.3.2 (NMT)"
_EMCY = "CiA 301, 7.2.7 (EMCY)"
_MAPPING = "CiA 301, 7.5.2.36 and 7.5.2.38"
_RECORD = "CiA 301, 7.5.2.35 and 7.5.2.37"
_CONSUMER = "CiA 301, 7.5.2.19 (0x1016)"
_STORE = "CiA 301, 7.5.2.13 (0x1010)"
_KINCO = "CANOpenRobotController: KincoDrive.cpp"


# -- SDO


def _emergencies(change: Callable[[CanFrame], CanFrame]) -> NodeAct:
    """Return a quirk action that changes the EMCY messages."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [(0, change(frame) if frame.can_id == node.emcy.cob_id and len(frame.data) == 8 else frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


def _answers(change: Callable[[CanFrame], CanFrame]) -> NodeAct:
    """Return a quirk action that changes the responses of the SDO server."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [(0, change(frame) if is_sdo_answer(node, frame) else frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


def _is_boot(node: VirtualNode, frame: CanFrame) -> bool:
    return is_heartbeat(node, frame) and frame.data == b"\0"


def _booted(hooks: QuirkHooks) -> Callable[[], int]:
    """Return a getter for the time of the last boot-up message in ns (a very early time if none was sent)."""
    times = [-(1 << 62)]

    def outgoing(node: VirtualNode, frame: CanFrame, now: int) -> Sent:
        if _is_boot(node, frame):
            times[0] = now
        return [(0, frame)]

    hooks.outgoing.append(outgoing)
    return lambda: times[0]


def _sized(command: int) -> int:
    """Return the data size in the command byte of an expedited upload if it is 1 to 3 bytes, else 0."""
    return {0x4F: 1, 0x4B: 2, 0x47: 3}.get(command, 0)


def _four_bytes(frame: CanFrame) -> CanFrame:
    return CanFrame(frame.can_id, b"\x43" + frame.data[1:]) if _sized(frame.data[0]) else frame


def _size_unsaid(frame: CanFrame) -> CanFrame:
    expedited = _sized(frame.data[0]) or frame.data[0] == 0x43
    return CanFrame(frame.can_id, b"\x42" + frame.data[1:]) if expedited else frame


def _garbage_behind(frame: CanFrame) -> CanFrame:
    size = _sized(frame.data[0])
    return CanFrame(frame.can_id, frame.data[: 4 + size] + b"\xa5\x8f\xaf"[: 4 - size]) if size else frame


def _more_bytes(frame: CanFrame) -> CanFrame:
    last = frame.data[0] & 0xE1 == 0x01
    return CanFrame(frame.can_id, bytes((frame.data[0] & 0xF1,)) + frame.data[1:]) if last else frame


def _acknowledged_with_data(frame: CanFrame) -> CanFrame:
    return CanFrame(frame.can_id, frame.data[:4] + b"\xde\xad\xbe\xef") if frame.data[0] == 0x60 else frame


def _short(frame: CanFrame) -> CanFrame:
    size = 4 if frame.data[0] == 0x60 else 4 + _sized(frame.data[0]) if _sized(frame.data[0]) else 8
    return CanFrame(frame.can_id, frame.data[:size])


def _aborted_with(code: int) -> Callable[[CanFrame], CanFrame]:
    abort = code.to_bytes(4, "little")
    return lambda frame: CanFrame(frame.can_id, frame.data[:4] + abort) if frame.data[0] == 0x80 else frame


def _sdo_after_boot(hooks: QuirkHooks, seconds: float) -> None:
    boot = _booted(hooks)

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        return None if is_sdo_request(node, frame) and now - boot() < seconds * _S else frame

    hooks.incoming.append(incoming)


def _sdo_late(hooks: QuirkHooks, seconds: float) -> None:
    hooks.outgoing.append(lambda node, frame, _now: [(round(seconds * _S) if is_sdo_answer(node, frame) else 0, frame)])


def _sdo_stale(hooks: QuirkHooks, _strength: float) -> None:
    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        if not _is_boot(node, frame):
            return [(0, frame)]
        answer = CanFrame(node.sdo.answer_cob_id, bytes.fromhex("4300100092010200"))
        stale = [((20 + 3 * count) * _MS, answer) for count in range(3)]
        return [(0, frame), *stale, (25 * _MS, CanFrame(node.emcy.cob_id, bytes.fromhex("1081110000000000")))]

    hooks.outgoing.append(outgoing)


def _sdo_first_lost(hooks: QuirkHooks, _strength: float) -> None:
    boot, last_request = _booted(hooks), [-(1 << 62)]

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        if not is_sdo_request(node, frame) or last_request[0] >= boot():
            return frame
        last_request[0] = now
        return None

    hooks.incoming.append(incoming)


def _mapped_not_written(hooks: QuirkHooks, _strength: float) -> None:
    pdos = hooks.node.pdos

    def matches(command: int, index: int) -> bool:
        brought = (rpdo for rpdo in pdos.rpdos.values() if rpdo.consumer.running)
        return command >> 5 in (1, 6) and any(
            entry.index == index for rpdo in brought for entry in rpdo.entries if entry
        )

    hooks.incoming.append(refusing(AbortCode.DEVICE_STATE, matches))


def _storing_silent(hooks: QuirkHooks, seconds: float) -> None:
    until = [-(1 << 62)]
    wait = round(seconds * _S)

    def incoming(node: VirtualNode, frame: CanFrame, now: int) -> CanFrame | None:
        if now < until[0] and frame.can_id:
            return None
        if is_sdo_request(node, frame) and frame.data[0] >> 5 == 1 and frame.data[1:3] == b"\x10\x10":
            until[0] = now + wait
        return frame

    def outgoing(node: VirtualNode, frame: CanFrame, now: int) -> Sent:
        if now >= until[0]:
            return [(0, frame)]
        return [(until[0] - now, frame)] if is_sdo_answer(node, frame) else []

    hooks.incoming.append(incoming)
    hooks.outgoing.append(outgoing)


_SDO_QUIRKS: Final[tuple[Quirk, ...]] = (
    Quirk(
        "sdo_after_boot",
        "answers SDO requests only some time after its boot-up message",
        _NMT,
        "canopen#401 (Nanotec CL4-E)",
        node=_sdo_after_boot,
        strength=in_seconds(2.0),
    ),
    Quirk("sdo_late", "answers SDO requests late", _SDO, "unsourced", node=_sdo_late, strength=in_seconds(0.1, 10.0)),
    Quirk(
        "sdo_first_lost",
        "does not answer the first SDO request after its boot-up message",
        _SDO,
        "ros_canopen#347",
        node=_sdo_first_lost,
    ),
    Quirk(
        "mapped_not_written",
        "refuses SDO downloads to objects that are mapped in an RPDO while it is OPERATIONAL",
        _SDO,
        "SOEM#567 (STF06-EC)",
        node=_mapped_not_written,
    ),
    Quirk(
        "sdo_stale",
        "sends answers to old SDO requests and EMCY 0x8110 after its boot-up message",
        _NMT,
        "ros2_canopen#36 (Ingenia)",
        node=_sdo_stale,
    ),
    Quirk(
        "sdo_four_bytes",
        "answers expedited uploads of every size with 4 bytes",
        _SDO,
        "canopen#395",
        node=_answers(_four_bytes),
        group="size of uploads",
    ),
    Quirk(
        "sdo_size_unsaid",
        "does not indicate the size in expedited uploads (0x42)",
        _SDO,
        "espp#762",
        node=_answers(_size_unsaid),
        group="size of uploads",
    ),
    Quirk(
        "sdo_garbage",
        "fills the unused bytes of expedited uploads with garbage",
        _SDO,
        "ros_canopen#259",
        node=_answers(_garbage_behind),
        group="size of uploads",
    ),
    Quirk(
        "sdo_more_bytes",
        "sends more bytes in the last segment than it announced",
        _SDO,
        "ros_canopen: canopen_master/src/sdo.cpp (Elmo)",
        node=_answers(_more_bytes),
    ),
    Quirk(
        "sdo_acknowledges_with_data",
        "repeats the data in the answer to a download",
        _SDO,
        "unsourced",
        node=_answers(_acknowledged_with_data),
    ),
    Quirk(
        "sdo_short_frames",
        "answers SDO requests with frames of fewer than 8 bytes",
        _SDO,
        "unsourced",
        node=_answers(_short),
        group="size of uploads",
    ),
    Quirk(
        "sdo_aborts_general",
        "aborts SDO transfers with 0x08000000 for every reason",
        _SDO,
        "unsourced",
        node=_answers(_aborted_with(0x08000000)),
        group="abort codes",
    ),
    Quirk(
        "sdo_aborts_zero",
        "aborts SDO transfers with the code 0",
        _SDO,
        "unsourced",
        node=_answers(_aborted_with(0)),
        group="abort codes",
    ),
    Quirk("sdo_no_block", "does not support SDO block transfer", _SDO, "unsourced", node=filter_frames(refuses_blocks)),
    Quirk(
        "storing_silent",
        "neither receives nor sends frames for some time while it stores parameters",
        _STORE,
        "unsourced",
        node=_storing_silent,
        strength=in_seconds(4.0),
    ),
)


# -- process data


def _refuses(
    code: AbortCode,
    when: Callable[[VirtualNode, Entry, int, float], bool],
    indices: Callable[[VirtualNode], Iterable[int]],
) -> NodeAct:
    """Return a quirk action that refuses writes with `code` while `when` is true."""

    def act(hooks: QuirkHooks, strength: float) -> None:
        def check(entry: Entry, value: Value, before: Guard) -> Value:
            if when(hooks.node, entry, int(value), strength):
                raise SdoServerAbort(code)
            return before(entry, value)

        hooks.guard(indices(hooks.node), check)

    return act


def _cob_id_fixed(hooks: QuirkHooks, _strength: float) -> None:
    hooks.attribute(hooks.node.pdos.records, "remaps_valid", True)
    refuses = _refuses(AbortCode.READ_ONLY, lambda _node, entry, _value, _n: entry.subindex == 1, pdo_records)
    refuses(hooks, 0.0)


def _inhibit_time(hooks: QuirkHooks, seconds: float) -> None:
    minimum = round(seconds * 10_000)
    for number in hooks.node.pdos.tpdos:
        if hooks.node.store.number(TPDO + number, 3) < minimum:
            hooks.preset(TPDO + number, 3, minimum)

    def check(entry: Entry, value: Value, before: Guard) -> Value:
        return before(entry, max(minimum, int(value)) if entry.subindex == 3 else value)

    hooks.guard([TPDO + number for number in hooks.node.pdos.tpdos], check)


def _mapping_swapped(hooks: QuirkHooks, _strength: float) -> None:
    store = hooks.node.store
    first, second = TPDO + 0x200, TPDO + 0x201
    values = [
        (index, sub, store.number(swapped, sub))
        for index, swapped in ((first, second), (second, first))
        for sub in store.od.subindices(index)
    ]
    for index, sub, value in values:
        hooks.preset(index, sub, value)


def _cob_ids_of_node(hooks: QuirkHooks, node_id: float) -> None:
    store, own_id = hooks.node.store, hooks.node.node_id
    for record in pdo_records(hooks.node):
        value = store.number(record, 1)
        if value & 0x7F == own_id:
            hooks.preset(record, 1, value & ~0x7F | int(node_id))


def _cob_id_not_stored(hooks: QuirkHooks, _strength: float) -> None:
    store = hooks.node.store

    def check(entry: Entry, value: Value, before: Guard) -> Value:
        cob_ids = {record: store.power_on.get((record, 1)) for record in pdo_records(hooks.node)}
        answer = before(entry, value)
        for record, cob_id in cob_ids.items():
            store.power_on.pop((record, 1), None)
            if cob_id is not None:
                store.power_on[record, 1] = cob_id
        return answer

    hooks.guard([0x1010], check)


_PROCESS_DATA: Final[tuple[Quirk, ...]] = (
    Quirk(
        "mapping_count_first",
        "refuses mapping entries with 0x06010000 unless the count is 0",
        "",
        "canopen#3 (Copley)",
        node=_refuses(
            AbortCode.UNSUPPORTED_ACCESS,
            lambda node, entry, _value, _n: bool(entry.subindex and node.store.number(entry.index)),
            pdo_mappings,
        ),
    ),
    Quirk(
        "mapping_fixed",
        "has a PDO mapping that cannot be written",
        _MAPPING,
        "unsourced",
        node=filter_frames(refuses_mapping),
    ),
    Quirk(
        "mapping_in_preop",
        "accepts changes of PDO parameters only in PRE-OPERATIONAL",
        _MAPPING,
        f"ros_canopen#425 (Schneider LXM28A); {_KINCO}",
        node=_refuses(
            AbortCode.DEVICE_STATE,
            lambda node, _entry, _value, _n: node.nmt.state is not NmtState.PRE_OPERATIONAL,
            lambda node: [*pdo_records(node), *pdo_mappings(node)],
        ),
    ),
    Quirk(
        "mapping_short",
        "accepts only a few objects in a PDO",
        _MAPPING,
        "linuxcnc-ethercat#512, #343 (Inovance)",
        node=_refuses(
            AbortCode.MAPPING_TOO_LONG,
            lambda _node, entry, value, maximum: entry.subindex == 0 and value > maximum,
            pdo_mappings,
        ),
        strength=whole("objects", 2, 1, 8),
    ),
    Quirk(
        "cob_id_fixed",
        "has PDO COB-IDs that cannot be written, not even bit 31; the mapping can be written",
        _RECORD,
        "ros_canopen#151 (Elmo)",
        node=_cob_id_fixed,
        group="COB-ID",
    ),
    Quirk(
        "cob_id_not_stored",
        "does not store the COB-IDs of PDOs through 0x1010",
        _STORE,
        "c-open#51",
        node=_cob_id_not_stored,
    ),
    Quirk(
        "cob_ids_of_node",
        "starts with the COB-IDs of another node (the strength is its node-ID)",
        _RECORD,
        "maxon_epos4_ros1; canopen#317",
        node=_cob_ids_of_node,
        strength=whole("node-ID", 1, 1, 127),
        group="COB-ID",
    ),
    Quirk(
        "foreign_pdo_unmappable",
        "refuses a mapping with 0x06040041 while the COB-ID belongs to another node",
        _MAPPING,
        "maxon_epos4_ros1#1 (EPOS4)",
        node=_refuses(
            AbortCode.NOT_MAPPABLE,
            lambda node, entry, _value, _n: node.store.number(entry.index - 0x200, 1) & 0x7F != node.node_id,
            pdo_mappings,
        ),
    ),
    Quirk(
        "mapping_swapped",
        "starts with the mappings of its first two TPDOs exchanged, contrary to its EDS",
        _MAPPING,
        "ros_canopen#425; canopen#554; maxon_epos4_ros1#1",
        node=_mapping_swapped,
    ),
    Quirk(
        "tpdo_by_event",
        "refuses transmission types of TPDOs below 254",
        _RECORD,
        "unsourced",
        node=_refuses(
            AbortCode.INVALID_VALUE,
            lambda _node, entry, value, _n: entry.subindex == 2 and value < 254,
            lambda node: [TPDO + number for number in node.pdos.tpdos],
        ),
    ),
    Quirk(
        "inhibit_time",
        "sends a TPDO at most once in this time",
        _RECORD,
        "yarp-devices#232 (iPOS: 30 ms)",
        node=_inhibit_time,
        strength=in_seconds(0.03, 6.0),
    ),
    Quirk(
        "rpdo_late",
        "receives RPDOs late",
        "CiA 402-2, 12 to 15 (cyclic modes)",
        "unsourced",
        node=lambda hooks, seconds: hooks.healthy(hooks.node.pdos.input.delay_ns, round(seconds * _S)),
        strength=in_seconds(0.003, 1.0),
    ),
    Quirk(
        "length_error_8220",
        "reports an RPDO of the wrong length with EMCY 0x8220",
        "CiA 301, 7.2.7 (EMCY codes)",
        "ros2_canopen#36 (Ingenia)",
        node=_emergencies(
            lambda frame: (
                CanFrame(frame.can_id, b"\x20\x82" + frame.data[2:]) if frame.data[:2] == b"\x10\x82" else frame
            )
        ),
    ),
)


# -- NMT, error control, EMCY


def _consumer_rounded(hooks: QuirkHooks, seconds: float) -> None:
    step = round(seconds * 1000)

    def check(entry: Entry, value: Value, before: Guard) -> Value:
        number = int(value)
        if entry.subindex:
            number = number & ~0xFFFF | min(0xFFFF, -(-(number & 0xFFFF) // step) * step)
        return before(entry, number)

    hooks.guard([0x1016], check)


def _after_boot(frames: Callable[[VirtualNode], list[tuple[int, CanFrame]]]) -> NodeAct:
    """Return a quirk action that sends frames after the boot-up message."""

    def outgoing(node: VirtualNode, frame: CanFrame, _now: int) -> Sent:
        return [(0, frame), *frames(node)] if _is_boot(node, frame) else [(0, frame)]

    return lambda hooks, _strength: hooks.outgoing.append(outgoing)


def _boot_unsaid(hooks: QuirkHooks, _strength: float) -> None:
    hooks.outgoing.append(lambda node, frame, _now: [] if _is_boot(node, frame) else [(0, frame)])


def _is_start(frame: CanFrame) -> bool:
    return frame.can_id == 0 and frame.data[:1] == bytes((NmtCommand.START,))


def _start_without_errors(hooks: QuirkHooks, _strength: float) -> None:
    hooks.incoming.append(lambda node, frame, _now: None if _is_start(frame) and node.emcy.error_register else frame)


def _start_after_boot(hooks: QuirkHooks, seconds: float) -> None:
    boot = _booted(hooks)
    hooks.incoming.append(lambda _node, frame, now: None if _is_start(frame) and now - boot() < seconds * _S else frame)


def _boot_delay(hooks: QuirkHooks, seconds: float) -> None:
    node = hooks.node
    hooks.later(lambda: node.set_reset_delay(0, node.clock.now))
    node.set_reset_delay(round(seconds * _S), node.clock.now)


def _clock_drift(hooks: QuirkHooks, ppm: float) -> None:
    hooks.later(lambda: hooks.node.set_clock_drift(0.0))
    hooks.node.set_clock_drift(ppm)


_NETWORK: Final[tuple[Quirk, ...]] = (
    Quirk(
        "boot_delay",
        "sends its boot-up message some time after a reset",
        _NMT,
        "unsourced",
        node=_boot_delay,
        strength=in_seconds(5.0),
    ),
    Quirk("boot_unsaid", "does not send a boot-up message", _NMT, "unsourced", node=_boot_unsaid),
    Quirk(
        "already_operational", "is OPERATIONAL without a command", _NMT, "unsourced", node=apply_switch(start_by_itself)
    ),
    Quirk(
        "start_without_errors",
        "obeys NMT start only while 0x1001 is 0",
        _NMT,
        "CANopenNode#297, #26",
        node=_start_without_errors,
    ),
    Quirk(
        "start_after_boot",
        "obeys NMT start only some time after its boot-up message",
        _NMT,
        "unsourced",
        node=_start_after_boot,
        strength=in_seconds(3.0),
    ),
    Quirk(
        "heartbeat_absent",
        "does not support heartbeats: it has neither 0x1016 nor 0x1017",
        "CiA 301, 7.2.8.2 (error control)",
        "ros_canopen#106, #367",
        node=hide_objects(0x1016, 0x1017),
        group="heartbeat",
    ),
    Quirk(
        "heartbeat_at_start",
        "sends heartbeats with this period after its boot-up message",
        "CiA 301, object 0x1017",
        "unsourced",
        node=lambda hooks, seconds: hooks.preset(0x1017, 0, round(seconds * 1000)),
        strength=in_seconds(1.0),
        group="heartbeat",
    ),
    Quirk(
        "heartbeats_at_boot",
        "sends four heartbeats within 4 ms of its boot-up message",
        "CiA 301, 7.2.8.2 (error control)",
        "CANopenNode#30",
        node=_after_boot(
            lambda node: [(count * _MS, CanFrame(0x700 + node.node_id, b"\x7f")) for count in range(1, 5)]
        ),
    ),
    Quirk(
        "consumer_rounded",
        "rounds the times in 0x1016 up to a multiple of the strength",
        _CONSUMER,
        "unsourced",
        node=_consumer_rounded,
        strength=in_seconds(0.1, 10.0),
        group="0x1016",
    ),
    Quirk(
        "consumer_refused",
        "refuses to write 0x1016",
        _CONSUMER,
        "unsourced",
        node=_refuses(AbortCode.READ_ONLY, lambda _node, entry, _value, _n: entry.subindex > 0, lambda _node: [0x1016]),
        group="0x1016",
    ),
    Quirk(
        "sync_counter_absent",
        "has no 0x1019",
        "CiA 301, object 0x1019",
        "ros_canopen#349: canopen_master/CHANGELOG",
        node=hide_objects(0x1019),
    ),
    Quirk(
        "clock_drift",
        "has a clock that is fast by the strength, or slow if negative",
        "",
        "unsourced",
        node=_clock_drift,
        strength=Strength("ppm", 100.0, -1000.0, 1000.0),
    ),
    Quirk(
        "emcy_own_register",
        "sends a manufacturer-specific error register in bytes 3 and 4 of an EMCY",
        _EMCY,
        "Faulhaber, MC 5010 manual, p. 25",
        node=_emergencies(lambda frame: CanFrame(frame.can_id, frame.data[:3] + b"\x02\x00\x00\x00\x00")),
        group="EMCY",
    ),
    Quirk(
        "emcy_own_data",
        "sends manufacturer-specific data in bytes 3 to 7 of every EMCY",
        _EMCY,
        "ros2_canopen#298 (Leadshine iSV2)",
        node=_emergencies(lambda frame: CanFrame(frame.can_id, frame.data[:3] + bytes.fromhex("0000007008"))),
        group="EMCY",
    ),
    Quirk(
        "emcy_at_boot",
        "sends EMCY 0x1000 and then EMCY 0x0000 after its boot-up message",
        _EMCY,
        "c-open#51",
        node=_after_boot(
            lambda node: [
                (0, CanFrame(node.emcy.cob_id, bytes.fromhex("0010810000000000"))),
                (_MS, CanFrame(node.emcy.cob_id, bytes(8))),
            ]
        ),
    ),
    Quirk(
        "emcy_zeros_at_boot",
        "sends an EMCY that contains only zeros after its boot-up message",
        _EMCY,
        "unsourced",
        node=_after_boot(lambda node: [(0, CanFrame(node.emcy.cob_id, bytes(8)))]),
    ),
)


COMMUNICATION_QUIRKS: Final[tuple[Quirk, ...]] = (*_SDO_QUIRKS, *_PROCESS_DATA, *_NETWORK)
