"""Checks of NMT, of error control and of LSS (CiA 301, 7.2.8 and 7.3.2; CiA 305), and of optional objects of CiA 302.

The objects of CiA 302 are NMT start-up, configuration manager and program download. Nothing is downloaded to 0x1F50 and
0x1F51, because that would replace the firmware.

`T` in a comment is the number of the case in CiA's conformance test tool 3.0.3. No check sends an NMT command to node
id 0, because that would reach every node on the bus.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia301.lss import FAST_SCAN_START, MASTER_COB_ID, SLAVE_COB_ID, LssCommand, LssMode, lss_frame
from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NMT_COB_ID, NmtCommand, NmtState
from canopen_control.cia301.sdo_codec import ANSWER_BASE
from canopen_control.conformance.check import (
    CheckLevel,
    CheckList,
    CheckTouch,
    answer_text,
    expect,
    expect_emergency,
    expect_refused,
    expect_silence,
    upload_request,
)
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.errors import SdoAbort
from canopen_control.od.dcf import decode_concise
from canopen_control.od.indices import (
    CONCISE_DCF,
    FLASH_STATUS,
    NMT_STARTUP,
    PROGRAM_CONTROL,
    PROGRAM_DATA,
    PROGRAM_ID,
    REQUEST_NMT,
    SLAVE_ASSIGNMENT,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.frame import CanFrame


NMT_CHECKS = CheckList("301")
LSS_CHECKS = CheckList("305")
MANAGER_CHECKS = CheckList("302")
_add, _add_lss, _add_302 = NMT_CHECKS.add, LSS_CHECKS.add, MANAGER_CHECKS.add
_SHOULD, _CONFIGURE = CheckLevel.SHOULD, CheckTouch.CONFIGURE
_PERIOD_MS = 50  # heartbeat period while a check monitors the NMT state
_BOOT_S = 5.0  # longest time to the boot-up message
HEARTBEAT_LOST = 0x8130  # EMCY error code of a lost heartbeat or life guarding (CiA 301, 7.2.7)
_LIFE_S = 0.1


@contextmanager
def beating(node: CheckedNode, period_ms: int = _PERIOD_MS) -> Iterator[None]:
    """Context in which the node sends heartbeats; raise NotApplicable for a device without 0x1017."""
    with node.kept(0x1017):
        node.put(0x1017, 0, period_ms, 2)
        yield


def nmt_state(node: CheckedNode) -> NmtState | None:
    """Return the NMT state in the next heartbeat, or None; requires the context `beating`."""
    return node.heartbeat(4 * _PERIOD_MS / 1000)


def _expect_state(node: CheckedNode, expected: NmtState) -> None:
    state = nmt_state(node)
    if state is not expected:
        state = nmt_state(node)  # the first heartbeat may be from before the command
    expect(state is expected, "no heartbeat" if state is None else state.text, expected.text)


def _heartbeats(node: CheckedNode, seconds: float) -> list[tuple[int, CanFrame]]:
    return node.frames(ERROR_CONTROL_COB_ID + node.node_id, seconds)


def emergency_id(node: CheckedNode) -> int:
    """Return the COB-ID of the node's EMCY messages; raise NotApplicable if EMCY is disabled."""
    value = node.number(0x1014)
    if value >> 31:
        raise NotApplicable("bit 31 of 0x1014 disables EMCY")
    return value & 0x1FFFFFFF


def emergencies(node: CheckedNode, can_id: int, seconds: float) -> list[int]:
    """Return the error codes of the EMCY messages received in the next `seconds`."""
    return [int.from_bytes(frame.data[:2], "little") for _, frame in node.frames(can_id, seconds)]


def boot(node: CheckedNode, command: NmtCommand = NmtCommand.RESET_NODE) -> float:
    """Reset the node and return the time in s to its boot-up message; raise CheckFailed if none is received."""
    seconds = node.reset(command)
    if seconds is None:
        raise CheckFailed("no boot-up message within 10 s", f"{ERROR_CONTROL_COB_ID + node.node_id:03X} 00")
    return seconds


# -- NMT


@_add("N01", "7.3.2.2.1", "reset node is followed by one boot-up message", touch=_CONFIGURE)  # T 9.1
def _reset_node(node: CheckedNode) -> None:
    boot(node)
    more = [frame for _, frame in _heartbeats(node, 0.2) if frame.data == b"\0"]
    expect(not more, f"{1 + len(more)} boot-up messages", "one")


@_add("N02", "7.3.2.2.1", "reset communication restores the power-on value of 0x1017", touch=_CONFIGURE)  # T 10.1
def _reset_communication(node: CheckedNode) -> None:
    with node.kept(0x1017):
        boot(node)
        before = node.read(0x1017)
        node.put(0x1017, 0, int.from_bytes(before, "little") + 500, 2)
        boot(node, NmtCommand.RESET_COMMUNICATION)
        after = node.read(0x1017)
        expect(after == before, f"0x1017 = {int.from_bytes(after, 'little')}", str(int.from_bytes(before, "little")))


@_add("N08", "7.3.2.2.1", f"the boot-up message comes within {_BOOT_S:g} s of a reset", _SHOULD, _CONFIGURE)
def _boot_time(node: CheckedNode) -> None:
    seconds = boot(node)
    node.notes.append(f"boot-up message {seconds:.3f} s after reset node")
    expect(seconds < _BOOT_S, f"{seconds:.1f} s", f"less than {_BOOT_S:g} s")


@_add("N09", "7.3.2.2.2", "SDO requests are answered from the boot-up message on", touch=_CONFIGURE)
def _sdo_after_boot(node: CheckedNode) -> None:
    boot(node)
    answer = node.ask(upload_request(0x1000))
    expect(answer is not None, f"no answer within {node.timeout_s:g} s", "an answer in PRE-OPERATIONAL")


@_add("N10", "7.3.2.2", "the node is PRE-OPERATIONAL after the boot-up message", touch=_CONFIGURE)
def _state_after_boot(node: CheckedNode) -> None:
    try:
        if not node.number(NMT_STARTUP) & 4:
            raise NotApplicable("0x1F80 makes the node start by itself")
    except NotApplicable as reason:
        if "cannot be read" not in str(reason):
            raise
    boot(node)
    with beating(node):
        _expect_state(node, NmtState.PRE_OPERATIONAL)


@_add("N11", "7.3.2", "NMT start is accepted right after the boot-up message", touch=_CONFIGURE)
def _start_after_boot(node: CheckedNode) -> None:
    boot(node)
    with node.operational(), beating(node):
        _expect_state(node, NmtState.OPERATIONAL)


@_add("N12", "7.3.2", "a request sent during the boot is not answered after the boot", _SHOULD, _CONFIGURE)
def _old_request(node: CheckedNode) -> None:
    node.read(0x1000)
    node.nmt(NmtCommand.RESET_NODE)
    node.request(upload_request(0x1018, 1))
    if node.wait_for(ERROR_CONTROL_COB_ID + node.node_id, 10.0) is None:
        raise CheckFailed("no boot-up message within 10 s", "boot-up")
    late = node.frames(ANSWER_BASE + node.node_id, 0.3)
    expect(not late, late[0][1].data.hex(" ").upper() if late else "", "silence: the transfer ended with the reset")


@_add("N03", "7.3.2.2.2", "in PRE-OPERATIONAL the heartbeat is 7F, and SDO is answered", touch=_CONFIGURE)  # T 9.2
def _pre_operational(node: CheckedNode) -> None:
    with beating(node):
        node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        _expect_state(node, NmtState.PRE_OPERATIONAL)
        node.read(0x1000)


@_add("N04", "7.3.2.2.3", "in OPERATIONAL the heartbeat is 05, and SDO is answered", touch=_CONFIGURE)  # T 9.3
def _operational(node: CheckedNode) -> None:
    with beating(node), node.operational():
        _expect_state(node, NmtState.OPERATIONAL)
        node.read(0x1000)


@_add("N05", "7.3.2.2.4", "in STOPPED the heartbeat is 04, and SDO is not answered", touch=_CONFIGURE)  # T 9.4
def _stopped(node: CheckedNode) -> None:
    with beating(node):
        node.nmt(NmtCommand.STOP)
        try:
            _expect_state(node, NmtState.STOPPED)
            answer = node.ask(upload_request(0x1000))
            expect_silence(answer)
        finally:
            node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)


@_add("N05s", "7.3.2.2.4", "STOPPED is left by NMT start, and by enter PRE-OPERATIONAL", touch=_CONFIGURE)
def _from_stopped(node: CheckedNode) -> None:
    with beating(node):
        for command, expected in (
            (NmtCommand.START, NmtState.OPERATIONAL),
            (NmtCommand.ENTER_PRE_OPERATIONAL, NmtState.PRE_OPERATIONAL),
        ):
            node.nmt(NmtCommand.STOP)
            node.listen(0.01)
            node.nmt(command)
            try:
                _expect_state(node, expected)
            finally:
                node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)


def _unchanged(node: CheckedNode, command: int, length: int) -> None:
    """Send an NMT frame of `length` bytes and check that the node stays in PRE-OPERATIONAL."""
    with beating(node):
        node.send(NMT_COB_ID, bytes((command, node.node_id, 0))[:length])
        try:
            _expect_state(node, NmtState.PRE_OPERATIONAL)
        finally:
            node.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)


for _id, _title, _level, _command, _length in (
    ("N06", "an unknown NMT command has no effect", CheckLevel.MUST, 0x03, 2),
    ("N06s", "an NMT frame of one byte has no effect", CheckLevel.MUST, NmtCommand.START, 1),
    ("N06l", "an NMT frame of three bytes has no effect", _SHOULD, NmtCommand.START, 3),
):
    _add(_id, "7.2.8.2", _title, _level, _CONFIGURE)(partial(_unchanged, command=_command, length=_length))


# -- heartbeat


@_add("H00", "7.2.8.2", "the device supports heartbeats (0x1017)", _SHOULD)
def _has_heartbeat(node: CheckedNode) -> None:
    try:
        node.number(0x1017)
    except NotApplicable as reason:
        raise CheckFailed(str(reason), "0x1017, which CiA recommends instead of guarding") from None


@_add("H01", "7.5.2.20 (object 0x1017)", "0x1017 = 100 causes ten heartbeats per second", touch=_CONFIGURE)  # T 7.101
def _period(node: CheckedNode) -> None:
    with beating(node, 100):
        frames = _heartbeats(node, 1.0)
    expect(9 <= len(frames) <= 11, f"{len(frames)} heartbeats in 1 s", "9 to 11")
    wrong = [frame for _, frame in frames if frame.data != b"\x7f"]
    expect(not wrong, wrong[0].data.hex(" ") if wrong else "", "7F: PRE-OPERATIONAL with toggle bit 0")


@_add("H02", "7.5.2.20 (object 0x1017)", "0x1017 = 0 disables the heartbeat", touch=_CONFIGURE)  # T 7.103
def _no_heartbeat(node: CheckedNode) -> None:
    with node.kept(0x1017):
        node.put(0x1017, 0, 0, 2)
        count = len(_heartbeats(node, 1.5))
    expect(not count, f"{count} heartbeats", "none")


@_add("H02d", "7.5.2.20 (object 0x1017)", "0x1017 after a reset is the default of the EDS", _SHOULD, _CONFIGURE)
def _default_period(node: CheckedNode) -> None:
    entry = node.described(0x1017)
    if entry is None or not isinstance(entry.default, int):
        raise NotApplicable("the EDS has no default for 0x1017")
    boot(node)
    value = node.number(0x1017)
    expect(value == entry.default, f"{value}", f"{entry.default}, unless another value is stored")


@_add("H02b", "7.2.8.2", "heartbeats after the boot-up message have the period of 0x1017", _SHOULD, _CONFIGURE)
def _heartbeats_after_boot(node: CheckedNode) -> None:
    node.optional(0x1017)
    boot(node)
    count = len(_heartbeats(node, 0.2))
    period = node.number(0x1017)
    expected = 200 // period + 1 if period else 0
    expect(count <= expected, f"{count} heartbeats within 0.2 s", f"at most {expected}: 0x1017 = {period}")


def other_node_id(node: CheckedNode) -> int:
    """Return a node-ID other than the device's, for the heartbeats that a check sends."""
    return 126 if node.node_id != 126 else 125


@contextmanager
def _watching(node: CheckedNode, timeout_ms: int = 100) -> Iterator[int]:
    """Context in which the device monitors the heartbeat of another node; yields that node's id."""
    other = other_node_id(node)
    with node.kept(0x1016, 1):
        node.put(0x1016, 1, other << 16 | timeout_ms, 4)
        yield other


def _beat(node: CheckedNode, other: int, times: int = 1) -> None:
    for _ in range(times):
        node.send(ERROR_CONTROL_COB_ID + other, b"\x7f")
        node.listen(0.05)


@_add("H03", "7.5.2.19", "a second entry of 0x1016 for the same node is refused", touch=_CONFIGURE)  # T 7.104
def _same_node_twice(node: CheckedNode) -> None:
    if node.number(0x1016) < 2:
        raise NotApplicable("0x1016 has one entry")
    with node.kept(0x1016, 2), _watching(node) as other:
        data = (other << 16 | 200).to_bytes(4, "little")
        expect_refused(node, 0x1016, 2, data, AbortCode.PARAMETER_INCOMPATIBLE)


@_add("H03r", "7.5.2.19", "a time written to 0x1016 is read back", touch=_CONFIGURE)
def _consumer_time(node: CheckedNode) -> None:
    with _watching(node, 150) as other:
        value = node.number(0x1016, 1)
        expect(value == other << 16 | 150, f"0x{value:08X}", f"0x{other << 16 | 150:08X}")


@_add("H04", "7.2.8.2", "a heartbeat in time raises no EMCY", touch=_CONFIGURE)  # T 7.105
def _heartbeat_in_time(node: CheckedNode) -> None:
    can_id = emergency_id(node)
    codes: list[int] = []
    with _watching(node, 200) as other:
        for _ in range(6):
            node.send(ERROR_CONTROL_COB_ID + other, b"\x7f")
            codes += emergencies(node, can_id, 0.05)
    expect(not codes, ", ".join(f"EMCY 0x{code:04X}" for code in codes), "none")


@_add("H05", "7.2.8.2", "the loss of a monitored heartbeat raises EMCY 0x8130", touch=_CONFIGURE)  # T 7.106
def _heartbeat_lost(node: CheckedNode) -> None:
    can_id = emergency_id(node)
    with _watching(node) as other:
        _beat(node, other, 2)
        codes = emergencies(node, can_id, 0.5)
    expect_emergency(codes, HEARTBEAT_LOST)


@_add("H06", "7.2.8.2", "the monitoring of a node starts with its first heartbeat", touch=_CONFIGURE)
def _before_first_heartbeat(node: CheckedNode) -> None:
    can_id = emergency_id(node)
    with _watching(node):
        codes = emergencies(node, can_id, 0.4)
    expect(HEARTBEAT_LOST not in codes, f"EMCY 0x{HEARTBEAT_LOST:04X}", "none: the supervision starts with a heartbeat")


@_add("N13", "7.3.2", "NMT start is accepted while 0x1001 reports an error", _SHOULD, _CONFIGURE)
def _start_with_error(node: CheckedNode) -> None:
    with beating(node), _watching(node) as other:
        _beat(node, other, 2)
        node.listen(0.3)
        if not node.number(0x1001):
            raise NotApplicable("a missing heartbeat sets no bit of 0x1001")
        with node.operational():
            _expect_state(node, NmtState.OPERATIONAL)


# -- guarding


def _guard(node: CheckedNode) -> int:
    """Return the response to a node guarding request; raise NotApplicable without a response."""
    frame = node.ask_remote(ERROR_CONTROL_COB_ID + node.node_id, 0.2)
    if frame is None or len(frame.data) != 1:
        raise NotApplicable("the device does not answer a remote frame of guarding")
    return frame.data[0]


@_add("H07", "7.2.8.2", "guarding: the toggle bit alternates, and shows the state", touch=_CONFIGURE)  # T 7.1
def _toggles(node: CheckedNode) -> None:
    with node.kept(0x1017):
        node.put(0x1017, 0, 0, 2)
        first, second, third = (_guard(node) for _ in range(3))
    expect(
        first ^ second == 0x80 and first == third, f"{first:02X}, {second:02X}, {third:02X}", "7F and FF alternating"
    )
    expect(first & 0x7F == NmtState.PRE_OPERATIONAL, f"{first & 0x7F:02X}", "7F: PRE-OPERATIONAL")


@_add("H07z", "7.2.8.2", "guarding: the toggle bit of the first answer after a reset is 0", touch=_CONFIGURE)  # T 7.2
def _first_guard(node: CheckedNode) -> None:
    with node.kept(0x1017):
        boot(node, NmtCommand.RESET_COMMUNICATION)
        node.put(0x1017, 0, 0, 2)
        value = _guard(node)
    expect(value < 0x80, f"{value:02X}", "7F")


@_add("H07l", "7.5.2.12 (object 0x100D)", "the end of life guarding raises EMCY 0x8130", touch=_CONFIGURE)  # T 7.4
def _life_guarding(node: CheckedNode) -> None:
    can_id = emergency_id(node)
    with node.kept(0x1017), node.kept(0x100C), node.kept(0x100D):
        node.put(0x1017, 0, 0, 2)
        node.put(0x100C, 0, round(_LIFE_S * 1000), 2)
        node.put(0x100D, 0, 2, 1)
        for _ in range(3):
            _guard(node)
            node.listen(_LIFE_S / 2)
        codes = emergencies(node, can_id, 5 * _LIFE_S)
    expect_emergency(codes, HEARTBEAT_LOST)


@_add("H08", "7.2.8.2", "the heartbeat continues during node guarding", touch=_CONFIGURE)  # T 7.201
def _both(node: CheckedNode) -> None:
    with beating(node):
        node.ask_remote(ERROR_CONTROL_COB_ID + node.node_id, 0.02)
        _expect_state(node, NmtState.PRE_OPERATIONAL)


# -- LSS


def _lss(node: CheckedNode) -> None:
    if node.eds is None or not node.eds.od.device.lss_supported:
        raise NotApplicable("the EDS has no LSS_Supported=1")


def _ask_lss(node: CheckedNode, command: int, value: int = 0, *, tail: bytes = b"") -> bytes | None:
    """Send a frame as LSS master and return the slave's response, or None."""
    return node.exchange(MASTER_COB_ID, lss_frame(command, value, tail=tail).data, SLAVE_COB_ID, 0.2)


def _select(node: CheckedNode, identity: list[int]) -> bytes | None:
    for part, value in enumerate(identity[:3]):
        node.send(MASTER_COB_ID, lss_frame(LssCommand.SWITCH_SELECTIVE + part, value).data)
    return _ask_lss(node, LssCommand.SWITCH_SELECTIVE + 3, identity[3])


def _identity(node: CheckedNode) -> list[int]:
    return [node.number(0x1018, part) for part in range(1, 5)]


def _wait_again(node: CheckedNode) -> None:
    node.send(MASTER_COB_ID, lss_frame(LssCommand.SWITCH_GLOBAL, LssMode.WAITING).data)
    node.listen(0.01)


@_add_lss("L01", "305, 3.8", "an inquiry in the waiting state is not answered")
def _inquiry_while_waiting(node: CheckedNode) -> None:
    _lss(node)
    answer = _ask_lss(node, LssCommand.INQUIRE)
    expect_silence(answer)


@_add_lss("L02", "305, 3.5", "switch state selective with the identity of 0x1018 is confirmed", touch=_CONFIGURE)
def _selective(node: CheckedNode) -> None:
    _lss(node)
    answer = _select(node, _identity(node))
    try:
        observed = answer_text(answer)
        expect(answer is not None and answer[0] == LssCommand.SWITCHED, observed, f"{LssCommand.SWITCHED:02X}")
    finally:
        _wait_again(node)


@_add_lss("L02w", "305, 3.5", "switch state selective with another serial number is not answered", touch=_CONFIGURE)
def _other_serial(node: CheckedNode) -> None:
    _lss(node)
    *parts, serial = _identity(node)
    answer = _select(node, [*parts, serial ^ 1])
    _wait_again(node)
    expect_silence(answer)


@_add_lss("L04", "305, 3.8", "an inquiry in the configuration state returns identity and node-ID", touch=_CONFIGURE)
def _inquiry(node: CheckedNode) -> None:
    _lss(node)
    identity = _identity(node)
    _select(node, identity)
    try:
        for part, value in enumerate([*identity, node.node_id]):
            answer = _ask_lss(node, LssCommand.INQUIRE + part)
            observed = answer_text(answer)
            width = 4 if part < 4 else 1
            matches = answer is not None and int.from_bytes(answer[1 : 1 + width], "little") == value
            expect(matches, observed, f"0x{value:X}")
    finally:
        _wait_again(node)


@_add_lss("L03", "305, 3.10", "a node with a node-ID does not answer fast scan", touch=_CONFIGURE)
def _fast_scan(node: CheckedNode) -> None:
    _lss(node)
    answer = _ask_lss(node, LssCommand.FAST_SCAN, 0, tail=bytes((FAST_SCAN_START, 0, 0)))
    _wait_again(node)
    expect_silence(answer, "silence: the node has an id")


_NODES = 127
_STATES = (0, 1, 2, 3)  # states of 0x1F51: stopped, running, reset, cleared
_OWN_STATES = 0x80  # states from here on are manufacturer-specific


@_add_302("G01", "302-2, object 0x1F80", "0x1F80 has four bytes, and its reserved bits 7 to 31 are 0")
def _startup(node: CheckedNode) -> None:
    data = node.optional(NMT_STARTUP)
    expect(len(data) == 4, f"{len(data)} bytes", "4")
    value = int.from_bytes(data, "little")
    expect(not value >> 7, f"0x1F80 = 0x{value:08X}", "bits 7 to 31 = 0")


@_add_302("G01w", "302-2, object 0x1F80", "0x1F80 accepts its current value", touch=_CONFIGURE)
def _startup_written(node: CheckedNode) -> None:
    with node.kept(NMT_STARTUP) as value:
        node.put(NMT_STARTUP, 0, value, 4)


@_add_302("G02", "302-2, object 0x1F81", "0x1F81 has an entry of four bytes for each node-ID")
def _slaves(node: CheckedNode) -> None:
    count = node.number(SLAVE_ASSIGNMENT)
    expect(count == _NODES, f"0x1F81:00 = {count}", f"{_NODES}")
    expect(len(node.read(SLAVE_ASSIGNMENT, node.node_id)) == 4, f"another length in :{node.node_id:02X}", "4 bytes")


@_add_302("G03", "302-2, object 0x1F82", "0x1F82 has an entry for each node-ID, and one for all nodes", _SHOULD)
def _requests(node: CheckedNode) -> None:
    count = node.number(REQUEST_NMT)
    expect(count == _NODES + 1, f"0x1F82:00 = {count}", f"{_NODES + 1}")


@_add_302("G04", "302-3, object 0x1F22", "each entry of 0x1F22 is empty, or a complete concise DCF")
def _concise_files(node: CheckedNode) -> None:
    count = node.number(CONCISE_DCF)
    for subindex in range(1, min(count, _NODES) + 1):
        try:
            data = node.read(CONCISE_DCF, subindex)
        except SdoAbort:  # no data available
            continue
        try:
            decode_concise(data or bytes(4))
        except ValueError as error:
            expect(good=False, actual=f"0x1F22:{subindex:02X}: {error}", expected="a concise DCF")


@_add_302("G05", "302-3, objects 0x1F50 and 0x1F51", "0x1F50 and 0x1F51 have the same number of programs")
def _programs(node: CheckedNode) -> None:
    data, control = node.number(PROGRAM_DATA), node.number(PROGRAM_CONTROL)
    expect(data == control, f"{data} and {control}", "the same number")


def _each_program(node: CheckedNode, index: int) -> list[tuple[int, bytes]]:
    count = node.number(index)
    values = []
    for subindex in range(1, min(count, 254) + 1):
        try:
            values.append((subindex, node.read(index, subindex)))
        except SdoAbort:
            continue
    if not values:
        raise NotApplicable(f"no program of 0x{index:04X} can be read")
    return values


@_add_302("G06", "302-3, object 0x1F51", "0x1F51 shows a state of the program")
def _program_states(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, PROGRAM_CONTROL):
        value = int.from_bytes(data, "little")
        good = len(data) == 1 and (value in _STATES or value >= _OWN_STATES)
        expect(good, f"0x1F51:{subindex:02X} = {data.hex().upper()}", "one byte: 0 to 3, or 0x80 and above")


@_add_302("G07", "302-3, object 0x1F57", "0x1F57 shows neither an error nor an operation at rest", _SHOULD)
def _flash_states(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, FLASH_STATUS):
        value = int.from_bytes(data, "little")
        expect(not value & 0xFF, f"0x1F57:{subindex:02X} = 0x{value:08X}", "bits 0 to 7 = 0")


@_add_302("G08", "302-3, object 0x1F56", "0x1F56 identifies each program by four bytes")
def _identification(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, PROGRAM_ID):
        expect(len(data) == 4, f"{len(data)} bytes in :{subindex:02X}", "4")
