"""Writer of EDS and DCF files (CiA 306-1), and codec of the concise DCF (CiA 302-3).

A text that was read from a file is written unchanged if its value is still that of the dictionary; all other texts are
written from the dictionary. Reading the written file therefore gives an equal dictionary, with the keys and sections
that this package does not use. Only comment lines are lost. Entries of CompactSubObj are written in full; the three
object lists and SubNumber are computed.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.codec import encode
from canopen_control.od.eds_sections import (
    COMMISSIONING,
    DEVICE_COUNTS,
    DEVICE_FLAGS,
    DEVICE_NUMBERS,
    DEVICE_TEXTS,
    EntryReader,
    Section,
    read_device,
)
from canopen_control.od.eds_values import format_value, parse_number, real_bits
from canopen_control.od.issues import Report
from canopen_control.od.model import (
    BIT_RATES,
    SCALAR_CODES,
    DataType,
    DeviceInfo,
    Entry,
    ObjectCode,
    ObjectDictionary,
    ObjectInfo,
)

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping

    from canopen_control.od.model import Address, Value


# Concise DCF: the downloads to a node as one byte string (CiA 302-3; object 0x1F22). A 32-bit count, then for each
# download index (16 bit), subindex (8 bit), size (32 bit) and data, all little-endian.


_COUNT = struct.Struct("<I")
_HEAD = struct.Struct("<HBI")
_REFUSES_DOWNLOAD = 1  # bit of ObjFlags (CiA 306-1)


class ConciseEntry(NamedTuple):
    """Download in a concise DCF: address and data."""

    index: int  # type: ignore[assignment] # hides tuple.index, which addresses do not need
    subindex: int
    data: bytes


def encode_concise(entries: Iterable[tuple[int, int, bytes]]) -> bytes:
    """Return the concise DCF of the downloads; raise ValueError for an address out of range."""
    parts = []
    for index, subindex, data in entries:
        if not (0 <= index <= 0xFFFF and 0 <= subindex <= 0xFF):
            raise ValueError(f"0x{index:X}:{subindex:X} is not an address of an object dictionary")
        parts.append(_HEAD.pack(index, subindex, len(data)) + data)
    return _COUNT.pack(len(parts)) + b"".join(parts)


def decode_concise(data: bytes) -> list[ConciseEntry]:
    """Return the downloads of a concise DCF; raise ValueError if it is truncated or too long."""
    if len(data) < _COUNT.size:
        raise ValueError(f"a concise DCF begins with a count of 4 bytes, but has only {len(data)} bytes")
    (count,) = _COUNT.unpack_from(data)
    entries: list[ConciseEntry] = []
    offset = _COUNT.size
    while len(entries) < count:
        start = offset + _HEAD.size
        if start > len(data):
            raise ValueError(f"the concise DCF ends after {len(entries)} of {count} entries")
        index, subindex, size = _HEAD.unpack_from(data, offset)
        offset = start + size
        if offset > len(data):
            raise ValueError(f"0x{index:04X}:{subindex:02X} has only {len(data) - start} of {size} bytes")
        entries.append(ConciseEntry(index, subindex, data[start:offset]))
    if offset != len(data):
        raise ValueError(f"the concise DCF has {len(data) - offset} bytes after its {count} entries")
    return entries


def concise_of(od: ObjectDictionary) -> list[ConciseEntry]:
    """Return the downloads of all ParameterValues of a DCF, in ascending order of addresses.

    Entries that cannot be written and entries whose ObjFlags refuse a download are omitted. PDO parameters need another
    order (disable the COB-ID, mapping, enable the COB-ID), which the caller must apply.
    """
    downloads = (
        entry
        for entry in od
        if entry.parameter_value is not None and entry.writable and not entry.obj_flags & _REFUSES_DOWNLOAD
    )
    return [
        ConciseEntry(entry.index, entry.subindex, encode(entry.parameter_value, entry.data_type))
        for entry in sorted(downloads, key=lambda entry: entry.address)
        if entry.parameter_value is not None
    ]


_Lines = dict[str, str]
_SPELLING = {
    name.lower(): name
    for name in (
        *("ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "PDOMapping", "SubNumber"),
        *("LowLimit", "HighLimit", "ObjFlags", "ParameterValue"),
        *("VendorName", "VendorNumber", "ProductName", "ProductNumber", "RevisionNumber", "OrderCode"),
        *("SimpleBootUpMaster", "SimpleBootUpSlave", "Granularity", "DynamicChannelsSupported", "GroupMessaging"),
        *("NrOfRXPDO", "NrOfTXPDO", "LSS_Supported", "CompactPDO"),
        *("FileName", "FileVersion", "FileRevision", "EDSVersion", "Description", "CreationTime", "CreationDate"),
        *("CreatedBy", "ModificationTime", "ModificationDate", "ModifiedBy", "LastEDS"),
        *(f"BaudRate_{rate}" for rate in BIT_RATES),
        *("NodeID", "NodeName", "Baudrate", "NetNumber", "NetworkName", "CANopenManager", "LSS_SerialNumber"),
    )
}
_DEVICE_ORDER = (
    *("vendorname", "vendornumber", "productname", "productnumber", "revisionnumber", "ordercode", "baudrate"),
    *("simplebootupmaster", "simplebootupslave", "granularity", "dynamicchannelssupported", "compactpdo"),
    *("groupmessaging", "nrofrxpdo", "nroftxpdo", "lss_supported"),
)
_FIRST = ("fileinfo", "deviceinfo", "dummyusage", "comments")
_TITLES = dict(zip(_FIRST, ("FileInfo", "DeviceInfo", "DummyUsage", "Comments"), strict=True))
_COMPACT_KEYS = (
    *("compactsubobj", "datatype", "accesstype", "defaultvalue", "pdomapping", "lowlimit", "highlimit"),
    "parametervalue",
)
_MANDATORY = (0x1000, 0x1001, 0x1018)
_MANUFACTURER = range(0x2000, 0x6000)


def eds_text(od: ObjectDictionary) -> str:
    """Return the text of an EDS file; values relative to $NODEID remain relative."""
    return _text(_sections(od))


def dcf_text(
    od: ObjectDictionary,
    node_id: int,
    bitrate: int | None,
    values: Mapping[Address, Value] | None = None,
    *,
    node_name: str = "",
    relative: Container[Address] = (),
) -> str:
    """Return the text of the DCF of node `node_id` at `bitrate` bit/s (if known), with `values` as ParameterValues.

    Values at the `relative` addresses are written as $NODEID plus an offset, so that the file is valid for other
    node-IDs. Raise ValueError for a value that has no entry or does not fit its type.
    """
    od = configured(od.for_node(node_id), values or {}, relative)
    commissioning = replace(od.commissioning, node_name=node_name or od.commissioning.node_name)
    return _text(_sections(replace(od, bitrate=bitrate, commissioning=commissioning), is_dcf=True))


def write_dcf(
    path: str | Path,
    od: ObjectDictionary,
    node_id: int,
    bitrate: int,
    values: Mapping[Address, Value] | None = None,
    *,
    node_name: str = "",
) -> None:
    """Write the text of `dcf_text` to a file in UTF-8."""
    Path(path).write_text(dcf_text(od, node_id, bitrate, values, node_name=node_name), encoding="utf-8", newline="")


def configured(
    od: ObjectDictionary, values: Mapping[Address, Value], relative: Container[Address] = ()
) -> ObjectDictionary:
    """Return a copy with `values` as ParameterValues; raise ValueError for an unknown address or a wrong type.

    `relative` contains the addresses of values that depend on the node-ID.
    """
    entries = dict(od.entries)
    for (index, subindex), value in values.items():
        entry = entries.get((index, subindex))
        if entry is None:
            raise ValueError(f"0x{index:04X}:{subindex:02X} is not in the object dictionary")
        encode(value, entry.data_type)
        follows = (index, subindex) in relative
        entries[index, subindex] = replace(entry, parameter_value=value, parameter_relative=follows)
    return replace(od, entries=entries)


def _text(sections: Iterable[tuple[str, _Lines]]) -> str:
    blocks = []
    for title, lines in sections:
        body = "".join(f"{key}={_one_line(value)}\n" for key, value in lines.items())
        blocks.append(f"[{title}]\n{body}")
    return "\n".join(blocks)


def _one_line(value: str) -> str:
    return value.replace("\r\n", " ").replace("\r", " ").replace("\n", " ")


def _sections(od: ObjectDictionary, *, is_dcf: bool = False) -> Iterator[tuple[str, _Lines]]:
    by_title = {title.lower(): title for title in od.sections}
    device_sections = _device_sections(od)
    for name in _FIRST:
        if name in device_sections:
            yield device_sections[name]
        elif name in by_title:
            yield _TITLES[name], _respelled(od.sections[by_title[name]])
    yield from _commissioning(od, by_title, is_dcf)
    compact = _compact_companions(od)
    for name, title in by_title.items():
        if name not in _FIRST and name not in COMMISSIONING and name not in compact:
            yield title, od.sections[title]
    yield from _lists(od)
    yield from object_sections(od)


def _respelled(lines: _Lines) -> _Lines:
    """Return the lines with the keys spelled as in CiA 306-1, since some readers are case-sensitive."""
    return {_SPELLING.get(key.lower(), key): value for key, value in lines.items()}


def _compact_companions(od: ObjectDictionary) -> set[str]:
    """Return the names of the [xxxxName] and [xxxxValue] sections, which are not written separately."""
    compact = [index for index, info in od.objects.items() if _get(info.texts, "compactsubobj")]
    return {f"{index:04x}{suffix}" for index in compact for suffix in ("name", "value")}


def _get(texts: Mapping[str, str], name: str) -> str:
    return next((value for key, value in texts.items() if key.lower() == name), "")


def _section(title: str, texts: Mapping[str, str]) -> Section:
    return Section(title.lower(), title, 0, {key.lower(): value for key, value in texts.items()}, dict(texts))


# --- Device sections ---


def _device_sections(od: ObjectDictionary) -> dict[str, tuple[str, _Lines]]:
    """Return the device sections that must be written from the dictionary, by lower-case name."""
    sections = {title.lower(): _section(title, texts) for title, texts in od.sections.items()}
    parsed = read_device(sections, None, Report(""))
    new_sections: dict[str, tuple[str, _Lines]] = {}
    if parsed.device != od.device or (od.device == DeviceInfo() and "deviceinfo" not in sections):
        new_sections["deviceinfo"] = "DeviceInfo", _device_info(od, sections.get("deviceinfo"))
    if parsed.dummy_usage != od.dummy_usage or "dummyusage" not in sections:
        new_sections["dummyusage"] = "DummyUsage", {f"Dummy{i:04X}": str(int(i in od.dummy_usage)) for i in range(1, 8)}
    if parsed.comments != od.comments or "comments" in sections:
        lines = {f"Line{number}": line for number, line in enumerate(od.comments, 1)}
        count = {"Lines": str(len(lines)), **lines}
        new_sections["comments"] = "Comments", count | _unknown(sections.get("comments"), count)
    return new_sections


def _device_info(od: ObjectDictionary, old: Section | None) -> _Lines:
    fields = DEVICE_TEXTS | DEVICE_NUMBERS | DEVICE_FLAGS | DEVICE_COUNTS
    lines: _Lines = {}
    for key in _DEVICE_ORDER:
        if key == "baudrate":
            kbits = sorted({*BIT_RATES, *(bits // 1000 for bits in od.device.bit_rates)})
            lines |= {f"BaudRate_{rate}": str(int(rate * 1000 in od.device.bit_rates)) for rate in kbits}
        elif (value := getattr(od.device, fields[key])) is not None:
            lines[_SPELLING[key]] = _device_text(key, value)
    return lines | _unknown(old, lines)


def _device_text(key: str, value: str | int) -> str:
    if isinstance(value, str):
        return value
    return f"0x{value:08X}" if key in DEVICE_NUMBERS else str(int(value))


def _unknown(old: Section | None, lines: _Lines) -> _Lines:
    known_keys = {key.lower() for key in lines}
    return {} if old is None else {key: value for key, value in old.texts().items() if key.lower() not in known_keys}


def _commissioning(od: ObjectDictionary, section: dict[str, str], is_dcf: bool) -> Iterator[tuple[str, _Lines]]:
    name = next((name for name in COMMISSIONING if name in section), None)
    old = od.sections[section[name]] if name is not None else None
    if not is_dcf:
        if name is not None and old is not None:
            yield section[name], old
        return
    more = od.commissioning
    lines: dict[str, object] = {
        "NodeID": od.node_id,
        "NodeName": more.node_name,
        "Baudrate": None if od.bitrate is None else od.bitrate // 1000,
        "NetNumber": more.network_number,
        "NetworkName": more.network_name,
        "CANopenManager": int(more.canopen_manager),
        "LSS_SerialNumber": more.lss_serial_number,
    }
    # an unknown value gets no line: dcfgen would use a serial number of 0 instead of the one in 0x1018
    texts = {key: str(value) for key, value in lines.items() if value is not None}
    yield "DeviceComissioning", texts | _unknown(_section("", old) if old is not None else None, texts)


# --- Object sections ---


def _lists(od: ObjectDictionary) -> Iterator[tuple[str, _Lines]]:
    lists: dict[str, list[int]] = {"MandatoryObjects": [], "OptionalObjects": [], "ManufacturerObjects": []}
    for index in sorted(od.objects):
        if index in _MANDATORY:
            lists["MandatoryObjects"].append(index)
        else:
            lists["ManufacturerObjects" if index in _MANUFACTURER else "OptionalObjects"].append(index)
    for title, indices in lists.items():
        numbered = {str(number): f"0x{index:04X}" for number, index in enumerate(indices, 1)}
        yield title, {"SupportedObjects": str(len(indices)), **numbered}


def object_sections(od: ObjectDictionary) -> Iterator[tuple[str, _Lines]]:
    """Yield the section title and lines of each object and subindex, in ascending order."""
    subindices: dict[int, list[int]] = {index: [] for index in od.objects}
    for index, subindex in od.entries:
        subindices.setdefault(index, []).append(subindex)
    for index in sorted(od.objects):
        info, subs = od.objects[index], sorted(subindices[index])
        is_compact = bool(_get(info.texts, "compactsubobj"))
        if subs[:1] == [0] and not is_compact and _is_one(info, od[index, 0]):
            yield f"{index:04X}", _entry(od, od[index, 0], info.code)
            subs = subs[1:]
        else:
            yield f"{index:04X}", _object(info, len(subs), is_compact)
        for subindex in subs:
            entry = od[index, subindex]
            code = ObjectCode.DOMAIN if entry.data_type is DataType.DOMAIN else ObjectCode.VAR
            yield f"{index:04X}sub{subindex:X}", _entry(od, entry, code)


def _is_one(info: ObjectInfo, entry: Entry) -> bool:
    """Whether one section describes both the object and its value."""
    if info.code not in SCALAR_CODES or info.name != entry.name:
        return False
    return not (info.texts and entry.texts) or info.texts == entry.texts


def _object(info: ObjectInfo, count: int, is_compact: bool) -> _Lines:
    lines = {
        "ParameterName": info.name,
        "ObjectType": _code_text(info),
        "SubNumber": str(count),
    }
    texts = {key: value for key, value in info.texts.items() if not (is_compact and key.lower() in _COMPACT_KEYS)}
    return lines | _unknown(_section("", texts), lines)


def _code_text(info: ObjectInfo) -> str:
    """Return the ObjectType in the file, or the object's code if the file has another valid code."""
    text = _get(info.texts, "objecttype")
    try:
        number = parse_number(text)[0]
    except ValueError:
        number = -1
    is_code = number in {int(code) for code in ObjectCode}
    return text if text and (number == info.code or not is_code) else f"0x{info.code:X}"


def _entry(od: ObjectDictionary, entry: Entry, code: ObjectCode) -> _Lines:
    """Return the lines of an entry, with the text of the file for each key whose value is unchanged."""
    section = _section("", entry.texts)
    reader = EntryReader(od.node_id, Report(""))
    name = section.get("parametername") or entry.name
    parsed = reader.read(section, entry.index, entry.subindex, name, code) if entry.texts else None
    keys = _entry_keys(entry, parsed, code, od.node_id or 0)
    lines: _Lines = {}
    for key, (text, same) in keys.items():
        if same and key in section.values:
            lines[_SPELLING[key]] = section.get(key)
        elif not same and text:
            lines[_SPELLING[key]] = text
    return lines | _unknown(section, lines | dict.fromkeys(keys, ""))


def _entry_keys(entry: Entry, parsed: Entry | None, code: ObjectCode, node_id: int) -> dict[str, tuple[str, bool]]:
    """Return, for each key, the text of the field, and whether the file has the same value."""

    def value_text(value: Value | None, relative: bool) -> str:
        if value is None:
            return ""
        if relative and isinstance(value, int):
            return f"$NODEID+0x{value - node_id:X}"
        if isinstance(value, float) and entry.data_type.is_real:
            return real_bits(value, entry.data_type)
        return format_value(value, entry.data_type)

    def same(*fields: str) -> bool:
        return parsed is not None and all(getattr(parsed, field) == getattr(entry, field) for field in fields)

    return {
        "parametername": (entry.name, same("name")),
        "objecttype": (f"0x{code:X}", parsed is not None),
        "datatype": (f"0x{entry.data_type:04X}", same("data_type")),
        "accesstype": (entry.access, same("access")),
        "defaultvalue": (value_text(entry.default, entry.relative), same("default", "relative")),
        "lowlimit": (value_text(entry.low, entry.low_relative), same("low", "low_relative")),
        "highlimit": (value_text(entry.high, entry.high_relative), same("high", "high_relative")),
        "pdomapping": (str(int(entry.pdo_mappable)), same("pdo_mappable")),
        "objflags": (f"0x{entry.obj_flags:X}" if entry.obj_flags else "", same("obj_flags")),
        "parametervalue": (
            value_text(entry.parameter_value, entry.parameter_relative),
            same("parameter_value", "parameter_relative"),
        ),
    }
