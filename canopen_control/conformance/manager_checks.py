"""Checks of optional objects of CiA 302: NMT start-up, configuration manager, program download.

Nothing is downloaded to 0x1F50 and 0x1F51, because that would replace the firmware.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.conformance.check import CheckLevel, CheckList, CheckTouch, expect
from canopen_control.conformance.checked_node import NotApplicable
from canopen_control.errors import SdoAbort
from canopen_control.od.dcf import decode_concise

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode


MANAGER_CHECKS = CheckList("302")
_add = MANAGER_CHECKS.add
_SHOULD, _CONFIGURE = CheckLevel.SHOULD, CheckTouch.CONFIGURE
_STARTUP, _SLAVES, _REQUEST = 0x1F80, 0x1F81, 0x1F82
_CONCISE = 0x1F22
_PROGRAM, _CONTROL, _IDENTIFICATION, _FLASH = 0x1F50, 0x1F51, 0x1F56, 0x1F57
_NODES = 127
_STATES = (0, 1, 2, 3)  # of 0x1F51: stopped, running, reset, cleared
_OWN_STATES = 0x80  # states from here on are manufacturer-specific


@_add("G01", "302-2, object 0x1F80", "0x1F80 has four bytes, and its reserved bits 7 to 31 are 0")
def _startup(node: CheckedNode) -> None:
    data = node.optional(_STARTUP)
    expect(len(data) == 4, f"{len(data)} bytes", "4")
    value = int.from_bytes(data, "little")
    expect(not value >> 7, f"0x1F80 = 0x{value:08X}", "bits 7 to 31 = 0")


@_add("G01w", "302-2, object 0x1F80", "0x1F80 accepts its current value", touch=_CONFIGURE)
def _startup_written(node: CheckedNode) -> None:
    with node.kept(_STARTUP) as value:
        node.put(_STARTUP, 0, value, 4)


@_add("G02", "302-2, object 0x1F81", "0x1F81 has an entry of four bytes for each node id")
def _slaves(node: CheckedNode) -> None:
    count = node.number(_SLAVES)
    expect(count == _NODES, f"0x1F81:00 = {count}", f"{_NODES}")
    expect(len(node.read(_SLAVES, node.node_id)) == 4, f"another length in :{node.node_id:02X}", "4 bytes")


@_add("G03", "302-2, object 0x1F82", "0x1F82 has an entry for each node id, and one for all nodes", _SHOULD)
def _requests(node: CheckedNode) -> None:
    count = node.number(_REQUEST)
    expect(count == _NODES + 1, f"0x1F82:00 = {count}", f"{_NODES + 1}")


@_add("G04", "302-3, object 0x1F22", "each entry of 0x1F22 is empty, or a complete concise DCF")
def _concise_files(node: CheckedNode) -> None:
    count = node.number(_CONCISE)
    for subindex in range(1, min(count, _NODES) + 1):
        try:
            data = node.read(_CONCISE, subindex)
        except SdoAbort:  # no data available
            continue
        try:
            decode_concise(data or bytes(4))
        except ValueError as error:
            expect(good=False, actual=f"0x1F22:{subindex:02X}: {error}", expected="a concise DCF")


@_add("G05", "302-3, objects 0x1F50 and 0x1F51", "0x1F50 and 0x1F51 have the same number of programs")
def _programs(node: CheckedNode) -> None:
    data, control = node.number(_PROGRAM), node.number(_CONTROL)
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


@_add("G06", "302-3, object 0x1F51", "0x1F51 shows a state of the program")
def _program_states(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, _CONTROL):
        value = int.from_bytes(data, "little")
        good = len(data) == 1 and (value in _STATES or value >= _OWN_STATES)
        expect(good, f"0x1F51:{subindex:02X} = {data.hex().upper()}", "one byte: 0 to 3, or 0x80 and above")


@_add("G07", "302-3, object 0x1F57", "0x1F57 shows neither an error nor an operation at rest", _SHOULD)
def _flash_states(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, _FLASH):
        value = int.from_bytes(data, "little")
        expect(not value & 0xFF, f"0x1F57:{subindex:02X} = 0x{value:08X}", "bits 0 to 7 = 0")


@_add("G08", "302-3, object 0x1F56", "0x1F56 identifies each program by four bytes")
def _identification(node: CheckedNode) -> None:
    for subindex, data in _each_program(node, _IDENTIFICATION):
        expect(len(data) == 4, f"{len(data)} bytes in :{subindex:02X}", "4")
