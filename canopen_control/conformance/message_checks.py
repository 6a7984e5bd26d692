"""Checks of SYNC, EMCY, storing of parameters and identifiers (CiA 301, 7.2.5, 7.2.7, 7.3.5 and 7.5.2).

`T` in a comment is the number of the case in CiA's conformance test tool 3.0.3.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.abort import AbortCode, abort_text
from canopen_control.cia301.emcy import EMCY_COB_ID
from canopen_control.cia301.nmt import NmtCommand
from canopen_control.conformance.check import (
    GENERAL_ERROR,
    CheckLevel,
    CheckList,
    CheckTouch,
    expect,
    expect_emergency,
    expect_refused,
)
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.conformance.nmt_checks import boot, emergencies, emergency_id
from canopen_control.conformance.pdo_checks import SYNC_PERIOD_S, first_pdo, present_values
from canopen_control.errors import SdoAbort
from canopen_control.frame import EXTENDED_BIT, is_restricted
from canopen_control.od.indices import RPDO, TPDO

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode


MESSAGE_CHECKS = CheckList("301")
_add = MESSAGE_CHECKS.add
_SHOULD, _CONFIGURE, _STORE = CheckLevel.SHOULD, CheckTouch.CONFIGURE, CheckTouch.STORE
# CiA 301, 7.3.5: one identifier of each restricted range
_RESTRICTED = (0x001, 0x07F, 0x101, 0x180, 0x581, 0x601, 0x6E0, 0x701)
_IDS = (1 << 29) - 1
_OFF = 1 << 31  # bit 31 of a COB-ID
_SAVE, _LOAD, _WRONG = b"save", b"load", b"evas"  # the signature in the wrong order of bytes


# -- SYNC


@_add("Y01", "7.5.2.5 (object 0x1005)", "0x1005 has a legal identifier")  # T 6.1
def _sync_id(node: CheckedNode) -> None:
    value = node.number(0x1005)
    legal = bool(value & EXTENDED_BIT) or not is_restricted(value & 0x7FF)
    expect(legal, f"0x{value:08X}", "an identifier outside the restricted ranges; 0x80 is the default")


@_add("Y02", "7.5.2.6 (object 0x1006)", "a SYNC producer keeps the period of 0x1006", touch=_CONFIGURE)  # T 6.2
def _sync_producer(node: CheckedNode) -> None:
    with node.kept(0x1005) as value, node.kept(0x1006):
        if value & 1 << 30:
            raise NotApplicable("the node is producing SYNC already")
        node.put(0x1006, 0, 100_000, 4)
        try:
            node.put(0x1005, 0, value | 1 << 30, 4)
        except SdoAbort as error:
            raise NotApplicable(f"the device cannot produce SYNC: 0x{error.code:08X}") from None
        count = len(node.frames(value & 0x7FF, 1.0))
        node.put(0x1005, 0, value, 4)
        expect(9 <= count <= 11, f"{count} SYNC in 1 s", "9 to 11")
        count = len(node.frames(value & 0x7FF, 0.3))
        expect(not count, f"{count} SYNC after bit 30 of 0x1005 was cleared", "none")


@_add("Y02r", "7.5.2.6 (object 0x1006)", "a period written to 0x1006 is read back", touch=_CONFIGURE)
def _sync_period(node: CheckedNode) -> None:
    with node.kept(0x1006):
        node.put(0x1006, 0, 20_000, 4)
        value = node.number(0x1006)
        expect(value == 20_000, f"{value}", "20000")


def _overflow_refused(node: CheckedNode, values: tuple[int, ...]) -> None:
    with node.kept(0x1019), node.kept(0x1006):
        node.put(0x1006, 0, 0, 4)
        for value in values:
            codes = AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH, AbortCode.VALUE_TOO_LOW
            expect_refused(node, 0x1019, 0, bytes((value,)), *codes)


for _id, _title, _values in (  # T 6.5
    ("Y04", "0x1019 refuses 1, which is reserved", (1,)),
    ("Y04h", "0x1019 refuses 241 and 255, which are reserved", (241, 255)),
):
    _add(_id, "7.5.2.22 (object 0x1019)", _title, touch=_CONFIGURE)(partial(_overflow_refused, values=_values))


@_add("Y05", "7.5.2.22 (object 0x1019)", "0x1019 accepts 0, 2 and 240", touch=_CONFIGURE)  # T 6.6
def _overflow_legal(node: CheckedNode) -> None:
    with node.kept(0x1019), node.kept(0x1006):
        node.put(0x1006, 0, 0, 4)
        for value in (2, 240, 0):
            node.put(0x1019, 0, value, 1)
            shown = node.number(0x1019)
            expect(shown == value, f"{shown}", f"{value}")


@_add("Y05e", "7.5.2.22 (object 0x1019)", "0x1019 exists if the EDS lists it")
def _overflow_present(node: CheckedNode) -> None:
    if node.described(0x1019) is None:
        raise NotApplicable("the EDS does not list 0x1019")
    node.read(0x1019)


@_add("Y06", "7.5.2.22 (object 0x1019)", "0x1019 is refused while 0x1006 is not 0", touch=_CONFIGURE)  # T 6.9
def _overflow_while_running(node: CheckedNode) -> None:
    with node.kept(0x1019) as value, node.kept(0x1006):
        node.put(0x1006, 0, 10_000, 4)
        expect_refused(node, 0x1019, 0, bytes((10 if value != 10 else 11,)), AbortCode.DEVICE_STATE)


@_add("Y08", "7.2.5.2", "a SYNC of a wrong length raises EMCY 0x8240", _SHOULD, _CONFIGURE)
def _sync_length(node: CheckedNode) -> None:
    sync, can_id = node.number(0x1005) & 0x7FF, emergency_id(node)
    with node.kept(0x1019), node.kept(0x1006):
        node.put(0x1006, 0, 0, 4)
        node.put(0x1019, 0, 10, 1)
        with node.operational():
            node.send(sync, b"\1")
            node.listen(SYNC_PERIOD_S)
            node.send(sync, b"\1\2\3")
            codes = emergencies(node, can_id, 0.1)
            node.send(sync, b"\2")
            node.listen(SYNC_PERIOD_S)
    expect_emergency(codes, 0x8240)


# -- EMCY


@_add("M01", "7.5.2.17 (object 0x1014)", "0x1014 has a legal identifier")  # T 5.1
def _emergency_id(node: CheckedNode) -> None:
    value = node.number(0x1014)
    off = value >> 31 == 1
    default = EMCY_COB_ID + node.node_id
    node.notes.extend([] if off or value == default else [f"0x1014 = 0x{value:08X}, not 0x{default:X}"])
    legal = off or bool(value & EXTENDED_BIT) or not is_restricted(value & 0x7FF)
    expect(legal, f"0x{value:08X}", f"0x{default:X}, or bit 31")


@_add("M02", "7.5.2.2 (object 0x1001)", "0x1001 has one byte")  # T 5.2
def _error_register(node: CheckedNode) -> None:
    data = node.read(0x1001)
    expect(len(data) == 1, f"{len(data)} bytes", "1")


@_add("M03", "7.5.2.4 (object 0x1003)", "an upload of 0x1003:01 from an empty history is refused")  # T 5.3
def _empty_history(node: CheckedNode) -> None:
    if node.number(0x1003):
        raise NotApplicable("the error history is not empty")
    codes = AbortCode.NO_DATA, AbortCode.NO_SUBINDEX, GENERAL_ERROR
    try:
        data = node.read(0x1003, 1)
    except SdoAbort as error:
        expect(error.code in codes, f"abort 0x{error.code:08X} ({abort_text(error.code)})", "abort 0x08000024")
    else:
        raise CheckFailed(f"{data.hex(' ').upper()}", "abort 0x08000024: no data available")


def _provoked(node: CheckedNode) -> list[bytes]:
    """Send a short RPDO in OPERATIONAL; return the last EMCY, the error register, the history entry and later EMCYs."""
    can_id, rpdo = emergency_id(node), first_pdo(node)
    data = present_values(node, rpdo)
    with node.operational():
        node.listen(0.02)
        node.send(rpdo.can_id, data[:-1])
        frames = [frame.data for _, frame in node.frames(can_id, 0.1) if any(frame.data)]
        if not frames:
            raise NotApplicable("a short RPDO raises no EMCY, and no other error can be provoked")
        register = node.number(0x1001)
        node.notes.append(f"0x1001 = 0x{register:02X} after EMCY {frames[-1].hex(' ').upper()}")
        history = node.read(0x1003, 1) if node.described(0x1003, 1) is not None else b""
        node.send(rpdo.can_id, data)
        after = [frame.data for _, frame in node.frames(can_id, 0.1)]
    return [frames[-1], bytes((register,)), history, *after]


@_add("M04", "7.2.7", "an EMCY has eight bytes; byte 2 is 0x1001, with the generic bit", touch=_CONFIGURE)  # T 5.4
def _emergency(node: CheckedNode) -> None:
    message, register, *_ = _provoked(node)
    expect(len(message) == 8, f"{len(message)} bytes", "8 bytes")
    expect(message[2] == register[0], f"0x{message[2]:02X} in byte 2", f"0x1001 = 0x{register[0]:02X}")
    expect(bool(register[0] & 1), f"0x1001 = 0x{register[0]:02X}", "bit 0 (generic) while there is an error")


@_add("M04b", "7.5.2.2 (object 0x1001)", "a communication error sets bit 4 of 0x1001", _SHOULD, _CONFIGURE)
def _error_class(node: CheckedNode) -> None:
    message, register, *_ = _provoked(node)
    if message[1] != 0x82 and message[1] != 0x81:
        raise NotApplicable("the error is not a communication error")
    expect(bool(register[0] & 0x10), f"0x1001 = 0x{register[0]:02X}", "bit 4")


@_add("M04h", "7.5.2.4 (object 0x1003)", "0x1003:01 contains the code of the last EMCY", touch=_CONFIGURE)
def _history(node: CheckedNode) -> None:
    message, _, history, *_ = _provoked(node)
    if not history:
        raise NotApplicable("the device has no 0x1003:01")
    expect(history[:2] == message[:2], history.hex(" ").upper(), message[:2].hex(" ").upper())


@_add("M07", "7.2.7", "the end of an error is reported by EMCY 0x0000", _SHOULD, _CONFIGURE)
def _error_reset(node: CheckedNode) -> None:
    _, _, _, *after = _provoked(node)
    observed = "; ".join(data.hex(" ").upper() for data in after) or "no EMCY"
    expect(any(data[:2] == b"\0\0" for data in after), observed, "EMCY 0x0000")


@_add("M09", "7.2.7", "bytes 3 to 7 of an EMCY are 0 unless documented", _SHOULD, _CONFIGURE)
def _manufacturer_bytes(node: CheckedNode) -> None:
    message, *_ = _provoked(node)
    expect(not any(message[3:]), message.hex(" ").upper(), "zeros, or the bytes that the manual describes")


@_add("M08", "7.2.7", "no EMCY follows the boot-up message without an error", _SHOULD, _CONFIGURE)
def _emergency_at_boot(node: CheckedNode) -> None:
    can_id = emergency_id(node)
    boot(node)
    message = node.wait_for(can_id, 0.3)
    if node.number(0x1001):
        raise NotApplicable("0x1001 reports an error")
    expect(message is None, "" if message is None else message.data.hex(" ").upper(), "none: 0x1001 = 0")


@_add("M05", "7.5.2.4 (object 0x1003)", "writing 0 to 0x1003:00 clears the history", touch=_CONFIGURE)  # T 2.8
def _clear_history(node: CheckedNode) -> None:
    node.optional(0x1003)
    node.put(0x1003, 0, 0, 1)
    count = node.number(0x1003)
    expect(count == 0, f"{count} errors", "0")


@_add("M05v", "7.5.2.4 (object 0x1003)", "0x1003:00 refuses every other value")
def _history_count(node: CheckedNode) -> None:
    node.optional(0x1003)
    codes = AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH
    for value in (1, 0xFF):
        expect_refused(node, 0x1003, 0, bytes((value,)), *codes)


# -- storing of parameters


def _signature_refused(node: CheckedNode, index: int) -> None:
    node.optional(index)
    node.optional(index, 1)
    codes = AbortCode.CANNOT_STORE, AbortCode.LOCAL_CONTROL, AbortCode.DEVICE_STATE, AbortCode.INVALID_VALUE
    expect_refused(node, index, 1, _WRONG, *codes)


_add("R01", "7.5.2.13 (object 0x1010)", "0x1010:01 refuses a wrong signature")(  # T 8.1
    partial(_signature_refused, index=0x1010)
)
_add("R01l", "7.5.2.14 (object 0x1011)", "0x1011:01 refuses a wrong signature")(  # T 8.3
    partial(_signature_refused, index=0x1011)
)


@_add("R01b", "7.5.2.13 (object 0x1010)", "0x1010:01 indicates how the device stores", _SHOULD)
def _storing(node: CheckedNode) -> None:
    value = node.number(0x1010, 1)
    expect(value & ~3 == 0, f"0x{value:08X}", "only bits 0 and 1")


def _value_after_saving(node: CheckedNode, index: int, subindex: int, old: int, new: int, size: int) -> int:
    """Return the value of an object after a new value was saved and the device was reset; save the old value again."""
    try:
        node.put(index, subindex, new, size)
        node.write(0x1010, 1, _SAVE)
        boot(node)
        return node.number(index, subindex)
    finally:
        node.put(index, subindex, old, size)
        node.write(0x1010, 1, _SAVE)


@_add("R02", "7.5.2.13 (object 0x1010)", "a saved value persists after a reset", touch=_STORE)  # T 8.2
def _saved(node: CheckedNode) -> None:
    node.optional(0x1010, 1)
    with node.kept(0x1017) as value:
        shown = _value_after_saving(node, 0x1017, 0, value, value ^ 0x0102, 2)
        expect(shown == value ^ 0x0102, f"0x1017 = {shown}", f"{value ^ 0x0102}")


@_add("R02c", "7.5.2.13 (object 0x1010)", "a saved COB-ID of an RPDO persists after a reset", touch=_STORE)
def _saved_cob_id(node: CheckedNode) -> None:
    node.optional(0x1010, 1)
    record = first_pdo(node)
    changed = record.cob_id | _OFF
    with node.kept(record.index, 1):
        shown = _value_after_saving(node, record.index, 1, record.cob_id, changed, 4)
        expect(shown == changed, f"0x{record.index:04X}:01 = 0x{shown:08X}", f"0x{changed:08X}")


@_add("R02t", "7.5.2.13 (object 0x1010)", "SDO requests are answered after saving", _SHOULD, _STORE)
def _answers_after_saving(node: CheckedNode) -> None:
    node.optional(0x1010, 1)
    node.write(0x1010, 1, _SAVE)
    node.read(0x1000)


@_add("R03", "7.5.2.14 (object 0x1011)", "restored defaults take effect after a reset", touch=_STORE)  # T 8.4
def _restored(node: CheckedNode) -> None:
    node.optional(0x1011, 1)
    entry = node.described(0x1017)
    if entry is None or not isinstance(entry.default, int):
        raise NotApplicable("the EDS has no default for 0x1017")
    with node.kept(0x1017) as value:
        try:
            node.put(0x1017, 0, entry.default ^ 0x0102, 2)
            node.write(0x1010, 1, _SAVE)
            node.write(0x1011, 1, _LOAD)
            boot(node)
            shown = node.number(0x1017)
            expect(shown == entry.default, f"0x1017 = {shown}", f"{entry.default}, the default of the EDS")
        finally:
            node.put(0x1017, 0, value, 2)


@_add("R04", "7.5.2.23 (object 0x1020)", "a change of a parameter sets 0x1020 to 0", _SHOULD, _CONFIGURE)  # T 8.9
def _verification(node: CheckedNode) -> None:
    with node.kept(0x1020, 1), node.kept(0x1020, 2), node.kept(0x1017) as period:
        node.put(0x1020, 1, 1, 4)
        node.put(0x1020, 2, 1, 4)
        node.put(0x1017, 0, period ^ 1, 2)
        value = node.number(0x1020, 1)
        expect(value == 0, f"0x1020:01 = {value}", "0")


@_add("R06", "7.3.2.2.1", "a parameter that was not saved is lost at a reset", touch=_CONFIGURE)
def _not_saved(node: CheckedNode) -> None:
    with node.kept(0x1017):
        boot(node)
        before = node.number(0x1017)
        node.put(0x1017, 0, before ^ 0x0102, 2)
        boot(node, NmtCommand.RESET_NODE)
        after = node.number(0x1017)
        expect(after == before, f"0x1017 = {after}", f"{before}")


# -- identifiers


def _restricted_refused(node: CheckedNode, index: int, subindex: int) -> None:
    """Check that the device refuses restricted identifiers; restore the old value after each accepted download."""
    accepted = []
    with node.kept(index, subindex) as value:
        for can_id in _RESTRICTED:
            try:
                node.put(index, subindex, value & ~_IDS & ~(1 << 31) | can_id, 4)
            except SdoAbort as error:
                codes = AbortCode.INVALID_VALUE, AbortCode.VALUE_TOO_HIGH, AbortCode.VALUE_TOO_LOW, GENERAL_ERROR
                expect(error.code in codes, f"abort 0x{error.code:08X} for 0x{can_id:X}", "abort 0x06090030")
            else:
                accepted.append(f"0x{can_id:X}")
                node.put(index, subindex, value, 4)
    expect(not accepted, f"{', '.join(accepted)} accepted by 0x{index:04X}:{subindex:02X}", "abort 0x06090030")


for _id, _index, _subindex, _name in (  # T 8.10
    ("R05s", 0x1005, 0, "0x1005"),
    ("R05t", 0x1012, 0, "0x1012"),
    ("R05e", 0x1014, 0, "0x1014"),
    ("R05r", RPDO, 1, "RPDO 1"),
    ("R05p", TPDO, 1, "TPDO 1"),
):
    _add(_id, f"7.3.5 (object 0x{_index:04X})", f"{_name} refuses restricted identifiers", _SHOULD, _CONFIGURE)(
        partial(_restricted_refused, index=_index, subindex=_subindex)
    )


@_add("R05d", "7.5.2.33 (object 0x1200)", "0x1200 refuses other identifiers of the default SDO", touch=_CONFIGURE)
def _server_fixed(node: CheckedNode) -> None:
    value = node.number(0x1200, 1)
    data = (value ^ 1).to_bytes(4, "little")
    try:
        expect_refused(
            node, 0x1200, 1, data, AbortCode.READ_ONLY, AbortCode.UNSUPPORTED_ACCESS, AbortCode.INVALID_VALUE
        )
    except CheckFailed:
        node.put(0x1200, 1, value, 4)
        raise
