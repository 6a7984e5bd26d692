"""The sections of an EDS or DCF file that speak of the device as a whole (CiA 306-1, 4.4 to 4.6.2).

[DeviceInfo], [DummyUsage], [Comments], [DeviceComissioning] (with one m, as the standard writes it, or two) and the
three object lists. None of them is needed to use the objects, so whatever is wrong here is at most a warning.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from canopen_control.od.eds_sections import clip, optional_number, read_number
from canopen_control.od.eds_values import parse_number
from canopen_control.od.model import Commissioning, DeviceInfo, ObjectDictionary

if TYPE_CHECKING:
    from canopen_control.od.eds_sections import Pair, Section, Sections
    from canopen_control.od.issues import Report

__all__ = [
    "COMMISSIONING",
    "DEVICE_COUNTS",
    "DEVICE_FLAGS",
    "DEVICE_NUMBERS",
    "DEVICE_TEXTS",
    "OBJECT_LISTS",
    "check_lists",
    "read_device",
]

DEVICE_TEXTS = {"vendorname": "vendor_name", "productname": "product_name", "ordercode": "order_code"}
DEVICE_NUMBERS = {
    "vendornumber": "vendor_number",
    "productnumber": "product_number",
    "revisionnumber": "revision_number",
}
DEVICE_FLAGS = {
    "simplebootupmaster": "simple_boot_up_master",
    "simplebootupslave": "simple_boot_up_slave",
    "groupmessaging": "group_messaging",
    "lss_supported": "lss_supported",
}
DEVICE_COUNTS = {
    "granularity": "granularity",
    "dynamicchannelssupported": "dynamic_channels",
    "nrofrxpdo": "rpdo_count",
    "nroftxpdo": "tpdo_count",
    "compactpdo": "compact_pdo",
}
COMMISSIONING = ("devicecomissioning", "devicecommissioning")
OBJECT_LISTS = ("mandatoryobjects", "optionalobjects", "manufacturerobjects")
_COUNT_DEFAULTS = {"granularity": 8}
_BIT_RATE = re.compile(r"baudrate_([0-9]{1,5})")
_DUMMY = re.compile(r"dummy([0-9a-f]{4})")
_COMMENT = re.compile(r"line([0-9]{1,9})")
_HIGHEST_KBITS = 10_000  # above this a Baudrate is bit/s, below it kbit/s as the standard says


def read_device(sections: Sections, node_id: int | None, report: Report) -> ObjectDictionary:
    """Return the dictionary without its objects; `node_id` goes before the commissioned one."""
    od = ObjectDictionary(node_id=node_id)
    info = sections.get("deviceinfo")
    if info is None:
        report.warning(0, "device-info", "there is no [DeviceInfo]; vendor, product and bit rates are not known")
    else:
        od.device = _device_info(info, report)
    od.dummy_usage = frozenset(_dummies(sections.get("dummyusage"), report))
    od.comments = _comments(sections.get("comments"))
    for name in COMMISSIONING:
        if (section := sections.get(name)) is not None:
            _commission(od, section, report)
            break
    return od


def _device_info(section: Section, report: Report) -> DeviceInfo:
    fields: dict[str, Any] = {field: section.get(key) for key, field in DEVICE_TEXTS.items()}
    fields |= {field: optional_number(section, key, report) for key, field in DEVICE_NUMBERS.items()}
    fields |= {field: read_number(section, key, 0, report) != 0 for key, field in DEVICE_FLAGS.items()}
    for key, field in DEVICE_COUNTS.items():
        fields[field] = read_number(section, key, _COUNT_DEFAULTS.get(key, 0), report)
    rates = [(key, match) for key in section.values if (match := _BIT_RATE.fullmatch(key)) is not None]
    fields["bit_rates"] = frozenset(
        int(match[1]) * 1000 for key, match in rates if read_number(section, key, 0, report)
    )
    return DeviceInfo(**fields)


def _dummies(section: Section | None, report: Report) -> list[int]:
    if section is None:
        return []
    matches = [(key, match) for key in section.values if (match := _DUMMY.fullmatch(key)) is not None]
    return [int(match[1], 16) for key, match in matches if read_number(section, key, 0, report)]


def _comments(section: Section | None) -> tuple[str, ...]:
    if section is None:
        return ()
    lines = [(int(match[1]), key) for key in section.values if (match := _COMMENT.fullmatch(key)) is not None]
    return tuple(section.get(key) for _, key in sorted(lines))


def _commission(od: ObjectDictionary, section: Section, report: Report) -> None:
    node_id = optional_number(section, "nodeid", report)
    if node_id is not None and not 1 <= node_id <= 127:
        text = f"NodeID={clip(section.get('nodeid'))} is not 1 to 127; ignored"
        report.warning(section.line_of("nodeid"), "commissioning", text)
    elif od.node_id is None:
        od.node_id = node_id
    od.bitrate = _bitrate(section, report)
    od.commissioning = Commissioning(
        node_name=section.get("nodename"),
        network_number=optional_number(section, "netnumber", report),
        network_name=section.get("networkname"),
        canopen_manager=read_number(section, "canopenmanager", 0, report) != 0,
        lss_serial_number=optional_number(section, "lss_serialnumber", report),
    )


def _bitrate(section: Section, report: Report) -> int | None:
    number = optional_number(section, "baudrate", report)
    if number is None or number <= 0:
        return None
    if number > _HIGHEST_KBITS:
        text = f"Baudrate={number} is taken as bit/s; CiA 306 wants kbit/s"
        report.warning(section.line_of("baudrate"), "commissioning", text)
        return number
    return number * 1000


def check_lists(od: ObjectDictionary, sections: Sections, report: Report) -> None:
    """Compare the three lists with the objects that the file describes."""
    lists = [section for name in OBJECT_LISTS if (section := sections.get(name)) is not None]
    if not lists:
        report.warning(0, "list-missing", "there are no object lists; the object sections alone count")
        return
    listed: dict[int, Pair] = {}
    for section in lists:
        _read_list(section, listed, report)
    for index, pair in listed.items():
        if index not in od.objects:
            report.warning(pair.line, "list-object", f"0x{index:04X} is listed but has no section")
    for index, info in od.objects.items():
        if index not in listed:
            report.note(info.line, "list-absent", f"0x{index:04X} ({clip(info.name)}) is in none of the object lists")


def _read_list(section: Section, listed: dict[int, Pair], report: Report) -> None:
    count = 0
    for pair in section.numbered():
        count += 1
        try:
            index = parse_number(pair.value)[0]
        except ValueError:
            report.warning(pair.line, "list-object", f"{pair.key}={clip(pair.value)} is no index; ignored")
            continue
        first = listed.setdefault(index, pair)
        if first is not pair:
            report.warning(pair.line, "list-object", f"0x{index:04X} is listed twice, first in line {first.line}")
    said = optional_number(section, "supportedobjects", report)
    if said != count:
        text = f"[{section.title}] has {count} entries, SupportedObjects says {'nothing' if said is None else said}"
        report.warning(section.line_of("supportedobjects"), "list-count", text)
