"""Checks of a drive without motion: objects, modes and the power state machine (CiA 402-2, 6 and 8).

Only the first axis of a drive is checked. The checks of the power state machine switch on the power
stage, in a mode and with a set-point in which the motor is at standstill.
"""

from __future__ import annotations

from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtCommand
from canopen_control.cia301.pdo import parse_mapping_entry
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import HALT_BIT, State, decode_statusword
from canopen_control.conformance.check import CheckLevel, CheckList, CheckTouch, expect
from canopen_control.conformance.checked_node import NotApplicable
from canopen_control.conformance.drive_steps import (
    FAULT,
    LIMIT_S,
    OE,
    ON,
    QSA,
    RTSO,
    SOD,
    control,
    drive_at,
    expect_bits,
    go,
    is_drive,
    option,
    reaches,
    reset_fault,
    select_standstill_mode,
    set_mode,
    signed,
    statusword,
    stays,
)
from canopen_control.conformance.nmt_checks import boot, emergencies, other_node_id
from canopen_control.conformance.pdo_checks import CountedSync, first_pdo, present_values
from canopen_control.errors import SdoAbort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.checked_node import CheckedNode


DRIVE_CHECKS = CheckList("402")
_add = DRIVE_CHECKS.add
_MUST, _SHOULD = CheckLevel.MUST, CheckLevel.SHOULD
_CONFIGURE, _MOTION = CheckTouch.CONFIGURE, CheckTouch.MOTION
_POWER = "402-2, 6.3 (power state machine)"
_QUICK_S = 0.3  # usual timeout of a master for a transition
# Negative option codes are manufacturer-specific; the others are listed in CiA 402-2.
_OPTION_CODES = {
    0x605A: range(9),
    0x605B: range(2),
    0x605C: range(2),
    0x605D: range(5),
    0x605E: range(5),
    0x6007: range(4),
}


# -- objects


@_add("D01", "402-2, 6.3 (object 0x6041)", "0x6041 shows one of the eight states")
def _state(node: CheckedNode) -> None:
    is_drive(node)
    word = statusword(node)
    expect(decode_statusword(word) is not None, f"statusword 0x{word:04X}", "a state of CiA 402-2, table 30")


@_add("D02", "402-2, 8.4 (object 0x6502)", "0x6502 lists a mode of operation")
def _modes(node: CheckedNode) -> None:
    is_drive(node)
    modes = int.from_bytes(node.read(o.SUPPORTED_DRIVE_MODES), "little")
    expect(modes != 0, "0x6502 = 0", "a bit for each supported mode")


@_add("D03", "402-2, 8.3 (object 0x6040)", "0x6040 can be read and has two bytes")
def _control(node: CheckedNode) -> None:
    is_drive(node)
    expect(len(node.read(o.CONTROLWORD)) == 2, f"{len(node.read(o.CONTROLWORD))} bytes", "2")


@_add("D03m", "402-2, 8.3 (object 0x6061)", "0x6061 can be read and has one byte")
def _display(node: CheckedNode) -> None:
    is_drive(node)
    data = node.read(o.MODES_OF_OPERATION_DISPLAY)
    expect(len(data) == 1, f"{len(data)} bytes", "1")


@_add("D04", "402-2, 8.6", "the option codes have values defined in the profile", _SHOULD)
def _option_codes(node: CheckedNode) -> None:
    is_drive(node)
    for index, legal in _OPTION_CODES.items():
        try:
            value = signed(node, index)
        except NotApplicable:
            continue
        expect(value < 0 or value in legal, f"0x{index:04X} = {value}", f"0 to {legal.stop - 1}, or below 0")


def _positive(node: CheckedNode, index: int) -> None:
    is_drive(node)
    value = node.number(index)
    expect(value > 0, f"0x{index:04X} = 0", "above 0")


for _id, _index, _name in (
    ("D05", o.QUICK_STOP_DECELERATION, "the ramp of a quick stop"),
    ("D05a", o.PROFILE_ACCELERATION, "the ramp of the profile modes"),
):
    _title = f"0x{_index:04X}, {_name}, is above 0"
    _add(_id, f"402-2, object 0x{_index:04X}", _title, _SHOULD)(partial(_positive, index=_index))


@_add("D05l", "402-2, object 0x607D", "0x607D:01 is not above 0x607D:02", _SHOULD)
def _position_limits(node: CheckedNode) -> None:
    is_drive(node)
    low, high = signed(node, o.SOFTWARE_POSITION_LIMIT, 1), signed(node, o.SOFTWARE_POSITION_LIMIT, 2)
    expect(low <= high, f"{low} and {high}", "minimum, maximum")


def _of_the_eds(node: CheckedNode, index: int) -> None:
    is_drive(node)
    if node.described(index) is None:
        raise NotApplicable(f"the EDS does not list 0x{index:04X}")
    node.read(index)


for _index, _name in ((0x603F, "the error code"), (0x606C, "the actual velocity"), (0x6064, "the actual position")):
    _add(
        f"D09{_index & 0xFF:02x}",
        f"402-2, object 0x{_index:04X}",
        f"0x{_index:04X}, {_name}, exists if the EDS lists it",
    )(partial(_of_the_eds, index=_index))


@_add("D06", "402-2, object 0x606C", "0x606C is 0 while 0x6064 does not change", _SHOULD)
def _at_rest(node: CheckedNode) -> None:
    is_drive(node)
    before = signed(node, o.POSITION_ACTUAL)
    node.listen(0.2)
    moved = signed(node, o.POSITION_ACTUAL) - before
    velocity = signed(node, o.VELOCITY_ACTUAL)
    expect(bool(moved) or velocity == 0, f"0x606C = {velocity} at rest", "0")


def _bit(number: int, value: int, why: str, node: CheckedNode) -> None:
    is_drive(node)
    expect_bits(node, 1 << number, value << number, f"bit {number} = {value}: {why}")


for _id, _number, _value, _title, _why in (
    ("D08", 9, 1, "bit 9 of 0x6041 (remote) is 1", "the drive obeys 0x6040"),
    ("D08w", 7, 0, "bit 7 of 0x6041 (warning) is 0", "no warning"),
    ("D08l", 11, 0, "bit 11 of 0x6041 (internal limit) is 0", "no limit is active at rest"),
):
    _add(_id, "402-2, object 0x6041", _title, _SHOULD)(partial(_bit, _number, _value, _why))


@_add("D08m", "402-2, object 0x6041", "0x6041 does not change without a command", _SHOULD)
def _stable(node: CheckedNode) -> None:
    is_drive(node)
    words = set()
    for _ in range(40):
        words.add(statusword(node))
        node.listen(0.025)
    shown = ", ".join(f"0x{word:04X}" for word in sorted(words))
    expect(len(words) == 1, shown, "one value")


# -- modes


def _shown_mode(node: CheckedNode, mode: int, seconds: float) -> int:
    shown = 0
    for _ in range(round(seconds / 0.02)):
        shown = signed(node, o.MODES_OF_OPERATION_DISPLAY)
        if shown == mode:
            break
        node.listen(0.02)
    return shown


def _each_mode(node: CheckedNode, seconds: float) -> None:
    is_drive(node)
    modes = node.number(o.SUPPORTED_DRIVE_MODES)
    with node.operational(), node.kept(o.MODES_OF_OPERATION):
        for mode in (number for number in range(1, 17) if modes >> (number - 1) & 1):
            node.put(o.MODES_OF_OPERATION, 0, mode, 1)
            shown = _shown_mode(node, mode, seconds)
            expect(shown == mode, f"0x6061 = {shown} after {seconds:g} s", f"{mode}, which 0x6502 lists")


for _id, _title, _level, _seconds in (
    ("D11", "each mode of 0x6502 is shown in 0x6061 within 1 s", _MUST, 1.0),
    ("D11t", "each mode is shown within 0.1 s", _SHOULD, 0.1),
):
    _add(_id, "402-2, objects 0x6060 and 0x6061", _title, _level, _CONFIGURE)(partial(_each_mode, seconds=_seconds))


def _accepted_modes(node: CheckedNode, modes: range) -> list[int]:
    accepted = []
    with node.operational(), node.kept(o.MODES_OF_OPERATION):
        for mode in modes:
            try:
                node.put(o.MODES_OF_OPERATION, 0, mode & 0xFF, 1)
            except SdoAbort:
                continue
            if _shown_mode(node, mode, 0.1) == mode:
                accepted.append(mode)
    return accepted


@_add("D12", "402-2, objects 0x6060 and 0x6502", "a mode that 0x6502 does not list is not selected", touch=_CONFIGURE)
def _unknown_mode(node: CheckedNode) -> None:
    is_drive(node)
    modes = node.number(o.SUPPORTED_DRIVE_MODES)
    accepted = [mode for mode in _accepted_modes(node, range(1, 17)) if not modes >> (mode - 1) & 1]
    expect(not accepted, f"0x6061 shows {', '.join(map(str, accepted))}", "abort 0x06090030, or an unchanged 0x6061")


@_add("D12n", "402-2, object 0x6060", "bits 16 to 31 of 0x6502 announce the manufacturer's modes", _SHOULD, _CONFIGURE)
def _own_modes(node: CheckedNode) -> None:
    is_drive(node)
    if node.number(o.SUPPORTED_DRIVE_MODES) >> 16:
        raise NotApplicable("0x6502 announces modes of the manufacturer")
    accepted = _accepted_modes(node, range(-10, 0))
    expect(not accepted, f"mode {', '.join(map(str, accepted))} was accepted", "a bit in 16 to 31 of 0x6502")


# -- parameters


def _read_back(node: CheckedNode, index: int, subindex: int, value: int, size: int) -> None:
    is_drive(node)
    with node.kept(index, subindex):
        node.put(index, subindex, value, size)
        shown = node.number(index, subindex)
        expect(shown == value, f"{shown}", f"{value}, or an abort")


@_add("D15p", "402-2, object 0x60C2", "an interpolation time of 10 ms is stored unchanged", touch=_CONFIGURE)
def _period(node: CheckedNode) -> None:
    is_drive(node)
    with node.kept(o.INTERPOLATION_TIME_PERIOD, 2):
        node.put(o.INTERPOLATION_TIME_PERIOD, 2, 0xFD, 1)
        _read_back(node, o.INTERPOLATION_TIME_PERIOD, 1, 10, 1)


def _ramp_stored(node: CheckedNode, index: int) -> None:
    is_drive(node)
    _read_back(node, index, 0, max(2 * node.number(index), 5000), 4)


for _id, _index, _name in (
    ("D13", o.PROFILE_ACCELERATION, "an acceleration"),
    ("D13d", o.PROFILE_DECELERATION, "a deceleration"),
):
    _add(_id, f"402-2, object 0x{_index:04X}", f"{_name} is stored unchanged, or refused", touch=_CONFIGURE)(
        partial(_ramp_stored, index=_index)
    )
_add("D65m", "402-2, object 0x6098", "homing method 0 (none) is accepted", _SHOULD, _CONFIGURE)(
    partial(_read_back, index=o.HOMING_METHOD, subindex=0, value=0, size=1)
)


@_add("D42", _POWER, "OPERATION ENABLED is not entered in PRE-OPERATIONAL", _SHOULD, _MOTION)
def _enabled_in_preop(node: CheckedNode) -> None:
    is_drive(node)
    with node.kept(o.MODES_OF_OPERATION):
        select_standstill_mode(node)
        try:
            for word in (0x06, 0x07, 0x0F):
                control(node, word)
                node.listen(0.1)
            state = decode_statusword(statusword(node))
            expect(state is not OE, OE.name, "no power in PRE-OPERATIONAL")
        finally:
            control(node, 0)
            node.listen(0.1)


def _state_after_reset(node: CheckedNode, seconds: float) -> None:
    is_drive(node)
    boot(node)
    reaches(node, SOD, seconds)


_add("D20", _POWER, "after a reset the drive is in SWITCH ON DISABLED", touch=_CONFIGURE)(
    partial(_state_after_reset, seconds=LIMIT_S)
)
_add("D20t", _POWER, "after a reset SWITCH ON DISABLED is reached within 1 s", _SHOULD, _CONFIGURE)(
    partial(_state_after_reset, seconds=1.0)
)


# -- the power state machine: every transition by every command, by SDO and by RPDO

_ARROWS = (
    ("D21", 2, SOD, 0x06, RTSO),
    ("D22", 3, RTSO, 0x07, ON),
    ("D23", 4, ON, 0x0F, OE),
    ("D24", 5, OE, 0x07, ON),
    ("D25", 6, ON, 0x06, RTSO),
    ("D26", 7, RTSO, 0x00, SOD),
    ("D26q", 7, RTSO, 0x02, SOD),
    ("D27", 8, OE, 0x06, RTSO),
    ("D28", 9, OE, 0x00, SOD),
    ("D29", 10, ON, 0x00, SOD),
    ("D29q", 10, ON, 0x02, SOD),
)
_FORBIDDEN = (
    ("D33a", SOD, 0x07),
    ("D33b", SOD, 0x0F),
    ("D33c", SOD, 0x02),
    ("D34", SOD, 0x80),  # a fault reset without a fault
    ("D34r", RTSO, 0x86),
    ("D33h", RTSO, 0x06),
)


def _by_rpdo(node: CheckedNode, word: int) -> None:
    """Send a controlword in the first RPDO, other objects unchanged; raise NotApplicable if it does not map 0x6040."""
    record = first_pdo(node)
    image, shift = int.from_bytes(present_values(node, record), "little"), 0
    for entry in record.entries:
        index, _, bits = parse_mapping_entry(entry)
        if index == o.CONTROLWORD:
            image = image & ~(0xFFFF << shift) | word << shift
            break
        shift += bits
    else:
        raise NotApplicable("the first RPDO does not map 0x6040")
    node.send(record.can_id, image.to_bytes(record.length, "little"))


def _arrow(node: CheckedNode, source: State, word: int, target: State, seconds: float, *, rpdo: bool = False) -> None:
    with drive_at(node, source):
        if rpdo:
            _by_rpdo(node, word)
        else:
            control(node, word)
        elapsed = reaches(node, target, seconds)
        node.notes.append(f"{elapsed * 1000:.0f} ms")


def _no_arrow(node: CheckedNode, source: State, word: int) -> None:
    with drive_at(node, source):
        control(node, word)
        stays(node, source, 0.2)


for _id, _arrow_number, _source, _word, _target in _ARROWS:
    _title = f"transition {_arrow_number}: {_source.name} and 0x{_word:02X} lead to {_target.name}"
    _add(_id, _POWER, _title, touch=_MOTION)(
        partial(_arrow, source=_source, word=_word, target=_target, seconds=LIMIT_S)
    )
    _add(f"{_id}r", _POWER, f"{_title}, by RPDO", touch=_MOTION)(
        partial(_arrow, source=_source, word=_word, target=_target, seconds=LIMIT_S, rpdo=True)
    )
    _add(f"{_id}t", _POWER, f"{_title} within {_QUICK_S:g} s", _SHOULD, _MOTION)(
        partial(_arrow, source=_source, word=_word, target=_target, seconds=_QUICK_S)
    )
for _id, _source, _word in _FORBIDDEN:
    _add(_id, _POWER, f"0x{_word:02X} has no effect in {_source.name}", touch=_MOTION)(
        partial(_no_arrow, source=_source, word=_word)
    )


@_add("D44", _POWER, "the drive stays in SWITCHED ON without a command", _SHOULD, _MOTION)
def _lasting(node: CheckedNode) -> None:
    with drive_at(node, ON):
        stays(node, ON, 4.0)


@_add("D23v", "402-2, object 0x6041", "bit 4 of 0x6041 (voltage enabled) is 1 in OPERATION ENABLED", touch=_MOTION)
def _voltage(node: CheckedNode) -> None:
    with drive_at(node, OE):
        expect_bits(node, 0x10, 0x10, "bit 4 = 1")


@_add("D46", _POWER, "OPERATION ENABLED is entered even with mode 0", _SHOULD, _MOTION)
def _without_mode(node: CheckedNode) -> None:
    with drive_at(node, SOD):
        try:
            node.put(o.MODES_OF_OPERATION, 0, 0, 1)
        except SdoAbort as error:
            raise NotApplicable(f"0x6060 refuses 0: 0x{error.code:08X}") from None
        go(node, ON)
        control(node, 0x0F)
        reaches(node, OE, 1.0)


@_add("D39", _POWER, "enabling causes no motion, whatever the value of 0x607A", touch=_MOTION)
def _old_target(node: CheckedNode) -> None:
    with drive_at(node, ON, OperationMode.PP):
        position = signed(node, o.POSITION_ACTUAL)
        window = max(node.number(o.POSITION_WINDOW), 10)
        with node.kept(o.TARGET_POSITION):
            node.put(o.TARGET_POSITION, 0, position + 100 * window & 0xFFFFFFFF, 4)
            control(node, 0x0F)
            reaches(node, OE)
            node.listen(0.3)
            moved = signed(node, o.POSITION_ACTUAL) - position
            expect(abs(moved) <= window, f"moved by {moved}", "no motion until bit 4 commands a set-point")


# -- quick stop


@_add("D30", "402-2, 6.3 (object 0x605A)", "a quick stop with 0x605A = 6 stays in QUICK STOP ACTIVE", touch=_MOTION)
def _quick_stop(node: CheckedNode) -> None:
    is_drive(node)
    with option(node, o.QUICK_STOP_OPTION, 6), drive_at(node, OE):
        control(node, 0x02)
        reaches(node, QSA, 1.0)
        stays(node, QSA, 0.5)
        control(node, 0x00)
        reaches(node, SOD)


@_add("D30e", "402-2, 6.3 (object 0x605A)", "a quick stop with 0x605A = 2 ends in SWITCH ON DISABLED", touch=_MOTION)
def _quick_stop_ends(node: CheckedNode) -> None:
    is_drive(node)
    with option(node, o.QUICK_STOP_OPTION, 2), drive_at(node, OE):
        control(node, 0x02)
        reaches(node, SOD, 5.0)


@_add("D31", "402-2, 6.3 (object 0x605A)", "transition 16: 0x0F ends a quick stop with 0x605A = 6", _SHOULD, _MOTION)
def _resumed(node: CheckedNode) -> None:
    is_drive(node)
    with option(node, o.QUICK_STOP_OPTION, 6), drive_at(node, OE):
        control(node, 0x02)
        reaches(node, QSA, 1.0)
        control(node, 0x0F)
        reaches(node, OE, 1.0)


# -- faults: provoked by the loss of a heartbeat that the drive watches


@contextmanager
def _faulted(node: CheckedNode, word: int = 0x0F) -> Iterator[list[int]]:
    """Context in which the drive is in FAULT and the cause is removed; yields the error codes of the EMCY messages."""
    is_drive(node)
    other = other_node_id(node)
    can_id = node.number(0x1014) & 0x7FF
    # with 0x6007 = 1 (fault signal) a lost heartbeat leads to FAULT (CiA 402-2)
    with option(node, o.ABORT_CONNECTION_OPTION, 1), drive_at(node, OE):
        control(node, word)
        with node.kept(0x1016, 1):
            node.put(0x1016, 1, other << 16 | 100, 4)
            for _ in range(3):
                node.send(ERROR_CONTROL_COB_ID + other, b"\5")
                node.listen(0.05)
            codes = emergencies(node, can_id, 0.4)
        node.nmt(NmtCommand.START)
        node.listen(0.02)
        reaches(node, FAULT, 5.0)
        yield codes


@_add("D35", _POWER, "a lost heartbeat with 0x6007 = 1 leads to FAULT, with an EMCY", touch=_MOTION)
def _fault(node: CheckedNode) -> None:
    with _faulted(node) as codes:
        expect(bool(codes), "no EMCY", "an EMCY with the cause")


@_add("D35c", "402-2, object 0x603F", "0x603F contains the error code of the fault's EMCY", touch=_MOTION)
def _fault_code(node: CheckedNode) -> None:
    with _faulted(node) as codes:
        code = node.number(o.ERROR_CODE)
        expect(code in codes, f"0x603F = 0x{code:04X}", ", ".join(f"0x{code:04X}" for code in codes) or "an EMCY")


def _reset_leads_on(node: CheckedNode, seconds: float) -> None:
    with _faulted(node):
        reset_fault(node)
        reaches(node, SOD, seconds)


for _id, _title, _level, _seconds in (
    ("D36", "transition 15: the edge of bit 7 leads from FAULT to SWITCH ON DISABLED", _MUST, LIMIT_S),
    ("D36t", f"FAULT is left within {_QUICK_S:g} s of the edge of bit 7", _SHOULD, _QUICK_S),
):
    _add(_id, _POWER, _title, _level, _MOTION)(partial(_reset_leads_on, seconds=_seconds))


@_add("D36l", _POWER, "a constant bit 7 = 1 does not reset a fault", touch=_MOTION)
def _held_reset(node: CheckedNode) -> None:
    with _faulted(node, 0x8F):
        stays(node, FAULT, 1.5)


@_add("D33f", _POWER, "0x06, 0x07 and 0x0F have no effect in FAULT", touch=_MOTION)
def _commands_in_fault(node: CheckedNode) -> None:
    with _faulted(node):
        for word in (0x06, 0x07, 0x0F):
            control(node, word)
            stays(node, FAULT, 0.05)


@_add("D38", _POWER, "a fault reset does not lead to OPERATION ENABLED", touch=_MOTION)
def _reset_and_enable(node: CheckedNode) -> None:
    with _faulted(node):
        control(node, 0x0F)
        control(node, 0x8F)
        for _ in range(20):
            state = decode_statusword(statusword(node))
            expect(state is not OE, OE.name, "SWITCH_ON_DISABLED until the next command")
            node.listen(0.02)


@_add("D38e", _POWER, "the drive is enabled within 1 s after a fault reset", _SHOULD, _MOTION)
def _enabled_after_reset(node: CheckedNode) -> None:
    with _faulted(node):
        reset_fault(node)
        reaches(node, SOD)
        begin = node.reactor.now()
        go(node, OE)
        seconds = (node.reactor.now() - begin) / 1e9
        expect(seconds < 1.0, f"{seconds:.1f} s", "less than 1 s")


# -- NMT and modes while the drive is enabled


@_add("D41", _POWER, "NMT stop in OPERATION ENABLED switches the drive off", touch=_MOTION)
def _nmt_stop(node: CheckedNode) -> None:
    with drive_at(node, OE):
        node.nmt(NmtCommand.STOP)
        node.listen(1.0)
        node.nmt(NmtCommand.START)
        node.listen(0.02)
        state = decode_statusword(statusword(node))
        expect(state is not OE, OE.name, "a stop, by 0x6007")


def _mode_change(node: CheckedNode, word: int) -> None:
    with drive_at(node, OE, OperationMode.PV):
        control(node, word)
        node.listen(0.1)
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
        node.put(o.MODES_OF_OPERATION, 0, OperationMode.PP, 1)
        shown = _shown_mode(node, OperationMode.PP, 0.5)
        expect(shown == OperationMode.PP, f"0x6061 = {shown}", "1 (PP)")


for _id, _title, _word in (
    ("D68e", "the mode changes in OPERATION ENABLED at standstill", 0x0F),
    ("D68h", "the mode changes while the halt bit is set", 0x0F | HALT_BIT),
):
    _add(_id, "402-2, object 0x6060", _title, _SHOULD, _MOTION)(partial(_mode_change, word=_word))


@_add("D65w", "402-2, object 0x6098", "the homing method can be written in OPERATION ENABLED", _SHOULD, _MOTION)
def _method_enabled(node: CheckedNode) -> None:
    with drive_at(node, OE), node.kept(o.HOMING_METHOD) as method:
        node.put(o.HOMING_METHOD, 0, method, 1)


# -- set-points at the present position, by which nothing moves


@contextmanager
def _set_point_here(node: CheckedNode) -> Iterator[None]:
    """Context with the drive enabled in PP, after bit 4 has commanded a set-point at the current position."""
    with drive_at(node, OE, OperationMode.PP), node.kept(o.TARGET_POSITION):
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
        control(node, 0x1F)
        node.listen(0.1)
        yield


@_add("D54e", "402-2, 10 (profile position)", "PP: bit 12 is 0 before the first set-point", touch=_MOTION)
def _none_acknowledged(node: CheckedNode) -> None:
    with drive_at(node, OE, OperationMode.PP):
        expect_bits(node, 0x1000, 0, "bit 12 = 0 without a set-point")


@_add("D54", "402-2, 10 (profile position)", "PP: bit 12 acknowledges a set-point commanded by bit 4", touch=_MOTION)
def _acknowledged(node: CheckedNode) -> None:
    with _set_point_here(node):
        expect_bits(node, 0x1000, 0x1000, "bit 12 = 1")
        control(node, 0x0F)
        node.listen(0.1)
        expect_bits(node, 0x1000, 0, "bit 12 = 0 after bit 4 = 0")


@_add("D56", "402-2, 10 (profile position)", "PP: bit 10 is 1 at the target", touch=_MOTION)
def _reached(node: CheckedNode) -> None:
    with _set_point_here(node):
        control(node, 0x0F)
        node.listen(1.0)
        expect_bits(node, 0x0400, 0x0400, "bit 10 = 1")


@_add("D59", "402-2, 12 (cyclic position)", "CSP: missing set-points cause no fault at standstill", _SHOULD, _MOTION)
def _missing_set_points(node: CheckedNode) -> None:
    sync = CountedSync(node)
    with drive_at(node, ON):
        set_mode(node, OperationMode.CSP)
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
        control(node, 0x0F)
        reaches(node, OE)
        for _ in range(50):
            sync.send()
            node.listen(0.01)
        reaches(node, OE, 0.0)
