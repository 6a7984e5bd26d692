"""The parameters of one node with its identity: read from the node, and as a DCF file (CiA 306-1).

The file is a complete DCF: the EDS of the node with a ParameterValue for each parameter, so that a bus.yml can name it
as `dcf` or `configuration_file`, and other tools read it. The section [Backup] says of which device and firmware it is,
and when it was made; a DCF without that section is read as well, its identity is then that of its objects.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import NO_RTR_BIT
from canopen_control.errors import EdsError
from canopen_control.od.codec import encode, zero_of
from canopen_control.od.dcf import dcf_text
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.eds_values import parse_number
from canopen_control.od.pdos import is_cob_id
from canopen_control.service.backup_choice import follows_node_id, parameters_of, without_unused_slots
from canopen_control.version import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value

__all__ = [
    "OBJECTS",
    "TEXTS",
    "DeviceIdentity",
    "ParameterSet",
    "backup_file_text",
    "backup_text",
    "identity_from",
    "lost_in_text",
    "parse_backup",
    "read_backup",
    "same_value",
]

SECTION: Final = "Backup"
NUMBERS: Final = {
    "DeviceType": "device_type",
    "VendorID": "vendor",
    "ProductCode": "product",
    "RevisionNumber": "revision",
    "SerialNumber": "serial",
}
TEXTS: Final = {"DeviceName": "name", "HardwareVersion": "hardware", "SoftwareVersion": "software"}
OBJECTS: Final = {
    "device_type": (0x1000, 0),
    "vendor": (0x1018, 1),
    "product": (0x1018, 2),
    "revision": (0x1018, 3),
    "serial": (0x1018, 4),
    "name": (0x1008, 0),
    "hardware": (0x1009, 0),
    "software": (0x100A, 0),
}
_DEFAULT_BITRATE: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class DeviceIdentity:
    """Who a device is: 0x1000, 0x1018 and the names 0x1008 to 0x100A; None and "" for what it does not tell."""

    device_type: int | None = None
    vendor: int | None = None
    product: int | None = None
    revision: int | None = None
    serial: int | None = None
    name: str = ""
    hardware: str = ""
    software: str = ""

    def strangers(self, other: DeviceIdentity) -> list[str]:
        """Return what tells that the two are different products: nothing of one is written into the other."""
        return self._differences(other, ("device_type", "vendor", "product"))

    def variations(self, other: DeviceIdentity) -> list[str]:
        """Return what differs between two devices of one product: revision and software; each has its serial number."""
        return self._differences(other, ("revision", "software"))

    def _differences(self, other: DeviceIdentity, names: tuple[str, ...]) -> list[str]:
        pairs = ((name, getattr(self, name), getattr(other, name)) for name in names)
        return [
            f"{name.replace('_', ' ')} {_shown(a)} and {_shown(b)}"
            for name, a, b in pairs
            if a != b and None not in (a, b) and "" not in (a, b)
        ]


def identity_from(numbers: Mapping[str, int | None], texts: Mapping[str, str]) -> DeviceIdentity:
    """Make the identity of its fields by name."""
    return DeviceIdentity(
        device_type=numbers.get("device_type"),
        vendor=numbers.get("vendor"),
        product=numbers.get("product"),
        revision=numbers.get("revision"),
        serial=numbers.get("serial"),
        name=texts.get("name", ""),
        hardware=texts.get("hardware", ""),
        software=texts.get("software", ""),
    )


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """`values` of the parameters of `node_id` by address, typed as `od` says; `where` is the node or file, for people.

    `date` is when a file was made (ISO 8601), "" where that is not known.
    """

    od: ObjectDictionary
    node_id: int
    identity: DeviceIdentity
    values: Mapping[Address, Value]
    where: str
    date: str = ""

    @property
    def relative(self) -> frozenset[Address]:
        """The addresses whose values follow the node id."""
        return frozenset(
            address for address, value in self.values.items() if follows_node_id(self.od[address], value, self.node_id)
        )

    def for_node(self, node_id: int) -> dict[Address, Value]:
        """Return the values as a node with another id has them."""
        shift, relative = node_id - self.node_id, self.relative
        return {
            address: value + shift if address in relative and isinstance(value, int) else value
            for address, value in self.values.items()
        }


def same_value(entry: Entry, a: Value, b: Value) -> bool:
    """Whether two values of an object are the same to the node: the same bytes; bit 30 of a PDO's COB-ID is its own."""
    if isinstance(a, int) and isinstance(b, int) and is_cob_id(*entry.address):
        return a & ~NO_RTR_BIT == b & ~NO_RTR_BIT
    try:
        return a == b or encode(a, entry.data_type) == encode(b, entry.data_type)
    except ValueError:  # of two files that do not agree about the type
        return False


def backup_text(
    parameters: ParameterSet, *, eds_name: str = "", bitrate: int | None = None, node_name: str = ""
) -> str:
    """Return the DCF of a backup, stamped with the present time.

    `bitrate` in bit/s is told where it is known, else that of the dictionary or 1 Mbit/s.
    """
    now = datetime.now(UTC)
    od = parameters.od
    sections = {title: lines for title, lines in od.sections.items() if title.lower() != SECTION.lower()}
    kept = next((title for title in sections if title.lower() == "fileinfo"), "FileInfo")
    info = {**sections.pop(kept, {})}
    info |= {"LastEDS": eds_name, "ModificationDate": f"{now:%m-%d-%Y}", "ModificationTime": f"{now:%I:%M%p}"}
    sections |= {kept: info, SECTION: _section(parameters, f"{now:%Y-%m-%dT%H:%M:%SZ}")}
    cleared = {address: replace(entry, parameter_value=None) for address, entry in od.entries.items()}
    plain = replace(od, sections=sections, entries=cleared)
    rate = bitrate or od.bitrate or _DEFAULT_BITRATE
    return dcf_text(
        plain, parameters.node_id, rate, parameters.values, node_name=node_name, relative=parameters.relative
    )


def _section(parameters: ParameterSet, date: str) -> dict[str, str]:
    identity = parameters.identity
    lines = {"Format": "1", "Date": date, "Tool": f"canopen-control {__version__}"}
    numbers = {key: getattr(identity, name) for key, name in NUMBERS.items()}
    lines |= {key: f"0x{value:08X}" for key, value in numbers.items() if value is not None}
    lines |= {key: getattr(identity, name) for key, name in TEXTS.items() if getattr(identity, name)}
    empty = [address for address, value in sorted(parameters.values.items()) if value in ("", b"")]
    if empty:  # a ParameterValue of nothing reads as none
        lines["Empty"] = " ".join(f"{index:04X}:{subindex:02X}" for index, subindex in empty)
    return lines


def read_backup(path: str | Path, node_id: int | None = None) -> ParameterSet:
    """Read a DCF: its parameters for `node_id`, or for the node id of the file; EdsError for what is none.

    Values that a backup would not hold are left out, so that a DCF of another tool moves nothing either.
    """
    return _backup_of(read_eds(path), str(path), node_id)


def parse_backup(data: bytes, name: str) -> ParameterSet:
    """Return the same of the bytes of a DCF; `name` is what sentences call it."""
    return _backup_of(parse_eds(data, name=name), name, None)


def _backup_of(file: EdsFile, path: str, node_id: int | None) -> ParameterSet:
    own = file.od.node_id
    if own is None:
        raise EdsError(path, 0, "has no node id ([DeviceComissioning]), so it is an EDS and no DCF of a node")
    od = file.od if node_id is None else file.od.for_node(node_id)
    chosen = {entry.address: entry.parameter_value for entry in parameters_of(od) if entry.parameter_value is not None}
    lines = next((texts for title, texts in od.sections.items() if title.lower() == SECTION.lower()), None)
    for address in _addresses(lines or {}):
        if (entry := od.get(*address)) is not None:
            chosen[address] = zero_of(entry.data_type)
    if not chosen:
        raise EdsError(path, 0, "holds no ParameterValue of a parameter, so there is nothing to compare or restore")
    identity = _told(lines, od) if lines is not None else _identity_of(od)
    date = "" if lines is None else _get(lines, "Date")
    values = without_unused_slots(dict(sorted(chosen.items())))
    return ParameterSet(od, node_id or own, identity, values, path, date)


def backup_file_text(parameters: ParameterSet, node_name: str = "") -> tuple[str, list[str]]:
    """Return the DCF of a backup, and what it cannot hold with the reason."""
    info = next((lines for title, lines in parameters.od.sections.items() if title.lower() == "fileinfo"), {})
    eds_name = next((value for key, value in info.items() if key.lower() == "filename"), "")
    text = backup_text(parameters, eds_name=eds_name, node_name=node_name)
    lost = lost_in_text(parameters, text)
    if not lost:
        return text, []
    kept = {address: value for address, value in parameters.values.items() if address not in lost}
    reasons = [f"0x{index:04X}:{subindex:02X}: a DCF cannot hold this text" for index, subindex in lost]
    return backup_text(replace(parameters, values=kept), eds_name=eds_name, node_name=node_name), reasons


def lost_in_text(parameters: ParameterSet, text: str) -> list[Address]:
    """Return the parameters that a file could not hold: text with line ends, or with blanks at its ends."""
    od = parse_eds(text.encode(), parameters.node_id).od
    return [
        address
        for address, value in parameters.values.items()
        if value not in ("", b"") and not _comes_back(od.get(*address), value)
    ]


def _comes_back(entry: Entry | None, value: Value) -> bool:
    found = None if entry is None else entry.parameter_value
    return entry is not None and found is not None and same_value(entry, found, value)


def _addresses(lines: Mapping[str, str]) -> list[Address]:
    words = (word.partition(":") for word in _get(lines, "Empty").split())
    try:
        return [(int(index, 16), int(subindex, 16)) for index, _, subindex in words]
    except ValueError:
        return []


def _get(lines: Mapping[str, str], wanted: str) -> str:
    return next((value for key, value in lines.items() if key.lower() == wanted.lower()), "")


def _told(lines: Mapping[str, str], od: ObjectDictionary) -> DeviceIdentity:
    """Return the identity of a [Backup] section; a number that is none is not known."""
    numbers: dict[str, int | None] = {}
    for key, name in NUMBERS.items():
        try:
            numbers[name] = parse_number(_get(lines, key)).value
        except ValueError:
            numbers[name] = getattr(_identity_of(od), name)
    return identity_from(numbers, {name: _get(lines, key) for key, name in TEXTS.items()})


def _identity_of(od: ObjectDictionary) -> DeviceIdentity:
    """Return what a file tells by its objects; a product or vendor of 0 is none."""
    entries = {name: od.get(*OBJECTS[name]) for name in NUMBERS.values()}
    values = {name: None if entry is None else entry.value for name, entry in entries.items()}
    known = {name: value if isinstance(value, int) and value else None for name, value in values.items()}
    device = {"vendor": od.device.vendor_number or None, "product": od.device.product_number or None}
    known |= {name: known[name] or device[name] for name in device}
    return identity_from(known, {})


def _shown(value: object) -> str:
    return f"0x{value:08X}" if isinstance(value, int) else repr(value)
