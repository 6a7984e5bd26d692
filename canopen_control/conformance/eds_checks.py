"""Offline checks of the EDS (CiA 306-1); nothing is sent. `T` in a comment is a case number of CiA's tool 3.0.3.

Most rules are those of `od.eds`, whose issues have codes; a check fails if there is an issue with one of its codes.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o
from canopen_control.conformance.check import CheckLevel, CheckList, expect
from canopen_control.conformance.checked_node import NotApplicable
from canopen_control.od.model import DeviceInfo

if TYPE_CHECKING:
    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.od.eds import EdsFile


EDS_CHECKS = CheckList("306")
_add = EDS_CHECKS.add
_MUST, _SHOULD = CheckLevel.MUST, CheckLevel.SHOULD
_SHOWN = 5  # issues in a result
_SHAPE = ("section-form", "section-repeated", "stray-line", "key-number", "key-repeated", "entry-repeated")
_ROWS = (
    ("E01", "file format", "the file has no syntax error", _MUST, _SHAPE),  # T 1.0
    ("E01i", "[DeviceInfo]", "[DeviceInfo] is complete", _MUST, ("device-info",)),
    ("E02", "lists of objects", "0x1000, 0x1001 and 0x1018 exist", _MUST, ("object-mandatory",)),
    (
        "E03",
        "lists of objects",
        "the lists of objects are complete",
        _MUST,
        ("list-count", "list-missing", "list-object"),
    ),
    ("E03s", "sections of objects", "each listed object has a section", _MUST, ("object-missing", "sub-missing")),
    (
        "E04",
        "sections of objects",
        "SubNumber and subindex 0 match the subindices",
        _MUST,
        ("sub-number", "sub0-missing", "sub0-count", "sub0-type"),
    ),
    (
        "E05",
        "sections of objects",
        "ObjectType, DataType and AccessType are legal",
        _MUST,
        ("object-type", "data-type", "access-type"),
    ),
    (
        "E06",
        "sections of objects",
        "values are within their type and limits",
        _MUST,
        ("value-form", "value-limit", "limit-order"),
    ),
    (
        "E06f",
        "sections of objects",
        "limits are numbers, and occur only where allowed",
        _SHOULD,
        ("limit-form", "limit-forbidden"),
    ),
    (
        "E08",
        "sections of objects",
        "each default mapping fits its PDO",
        _MUST,
        ("pdo-bits", "pdo-length", "pdo-direction", "pdo-target"),
    ),
    (
        "E08c",
        "sections of objects",
        "each PDO has both records, and the entries that it counts",
        _MUST,
        ("pdo-count", "pdo-record"),
    ),
    ("E08m", "sections of objects", "mapped objects have PDOMapping=1", _MUST, ("pdo-mappable",)),
    ("E09", "sections of objects", "COB-IDs are allowed identifiers, or off", _MUST, ("cob-id",)),
    ("E10", "[DeviceInfo]", "NrOfRXPDO and NrOfTXPDO are the numbers of records", _SHOULD, ("pdo-number",)),
    ("E12c", "sections of objects", "ObjectType is that of the standard (array or record)", _SHOULD, ("object-code",)),
    ("E13t", "sections of objects", "objects of CiA 402 have its types", _SHOULD, ("profile-type",)),
)


def _eds(node: CheckedNode) -> EdsFile:
    if node.eds is None:
        raise NotApplicable("there is no EDS; give one with --eds")
    return node.eds


def _without_issues(codes: tuple[str, ...], node: CheckedNode) -> None:
    issues = [issue for issue in _eds(node).issues if issue.code in codes]
    lines = "; ".join(f"line {issue.line}: {issue.text}" for issue in issues[:_SHOWN])
    more = f"; and {len(issues) - _SHOWN} more" if len(issues) > _SHOWN else ""
    expect(not issues, f"{lines}{more}", "none")


for _id, _section, _title, _level, _codes in _ROWS:
    _add(_id, f"306-1, {_section}", _title, _level)(partial(_without_issues, _codes))


@_add("E07", "306-1, sections of objects", "mappable objects have a direction: ro, wo, rwr or rww", _SHOULD)  # T 1.0
def _directions(node: CheckedNode) -> None:
    entries = [entry for entry in _eds(node).od if entry.pdo_mappable and entry.access == "rw"]
    names = ", ".join(f"0x{entry.index:04X}:{entry.subindex:02X}" for entry in entries[:_SHOWN])
    expect(not entries, f"rw: {names}", "rwr for a TPDO, rww for an RPDO")


@_add("E11", "306-1, [DeviceInfo]", "vendor, product and revision of [DeviceInfo] are the defaults of 0x1018", _SHOULD)
def _identity(node: CheckedNode) -> None:
    od = _eds(node).od
    device = od.device
    numbers = (device.vendor_number, device.product_number, device.revision_number)
    for subindex, number in enumerate(numbers, 1):
        entry = od.get(0x1018, subindex)
        if number is not None and entry is not None and isinstance(entry.default, int):
            expect(number == entry.default, f"{number} and {entry.default} in 0x1018:{subindex:02X}", "equal numbers")


@_add("E12", "306-1, [DeviceInfo]", "[DeviceInfo] names a bit rate", _SHOULD)
def _bit_rates(node: CheckedNode) -> None:
    device = _eds(node).od.device
    if device == DeviceInfo():
        raise NotApplicable("the file has no [DeviceInfo]")
    expect(bool(device.bit_rates), "none", "BaudRate_N=1 for each bit rate")


@_add("E13", "306-1, sections of objects", "a drive has 0x6040, 0x6041, 0x6060, 0x6061 and 0x6502", _SHOULD)
def _drive(node: CheckedNode) -> None:
    od = _eds(node).od
    entry = od.get(0x1000)
    if entry is None or not isinstance(entry.value, int) or entry.value & 0xFFFF != 402:
        raise NotApplicable("the low word of 0x1000 is not 402: no drive")
    required = (
        o.CONTROLWORD,
        o.STATUSWORD,
        o.MODES_OF_OPERATION,
        o.MODES_OF_OPERATION_DISPLAY,
        o.SUPPORTED_DRIVE_MODES,
    )
    missing = [f"0x{index:04X}" for index in required if od.get(index) is None]
    expect(not missing, f"{', '.join(missing)} missing", "all of them")
