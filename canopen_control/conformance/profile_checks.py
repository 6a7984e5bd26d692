"""Checks of a drive by CiA 402 that only read; drives with one axis, or the first of several."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cia402.state import decode_statusword
from canopen_control.conformance.check import CheckLevel, CheckList, expect
from canopen_control.conformance.checked_node import NotApplicable

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode


PROFILE_CHECKS = CheckList("402")
_add = PROFILE_CHECKS.add
_DRIVES = 402  # low word of 0x1000
# Option codes below 0 are the manufacturer's; above, CiA 402-2 lists these.
_OPTION_CODES = {
    0x605A: range(9),
    0x605B: range(2),
    0x605C: range(2),
    0x605D: range(5),
    0x605E: range(5),
    0x6007: range(4),
}


def _drive(node: CheckedNode) -> None:
    if int.from_bytes(node.read(0x1000)[:2], "little") != _DRIVES:
        raise NotApplicable("the low word of 0x1000 is not 402: no drive")


@_add("D01", "402-2, 6.3", "0x6041 shows one of the eight states")
def _state(node: CheckedNode) -> None:
    _drive(node)
    word = int.from_bytes(node.read(0x6041), "little")
    expect(decode_statusword(word) is not None, f"statusword 0x{word:04X}", "a state of CiA 402-2, table 30")


@_add("D02", "402-2, 8.4", "0x6502 has a mode of operation")
def _modes(node: CheckedNode) -> None:
    _drive(node)
    modes = node.number(0x6502)
    expect(modes != 0, "0x6502 = 0", "a bit for each supported mode")


@_add("D03", "402-2, 8.3", "0x6040 and 0x6061 can be read")
def _control(node: CheckedNode) -> None:
    _drive(node)
    for index, length in ((0x6040, 2), (0x6061, 1)):
        data = node.read(index)
        expect(len(data) == length, f"{len(data)} bytes in 0x{index:04X}", str(length))


@_add("D04", "402-2, 8.6", "the option codes have values that the profile lists", CheckLevel.SHOULD)
def _option_codes(node: CheckedNode) -> None:
    _drive(node)
    for index, legal in _OPTION_CODES.items():
        try:
            value = int.from_bytes(node.optional(index), "little", signed=True)
        except NotApplicable:
            continue
        expect(value < 0 or value in legal, f"0x{index:04X} = {value}", f"0 to {legal.stop - 1}, or below 0")
