"""Parameters of one node with the device's identity, read from the node or from a DCF file (CiA 306-1).

The file is a complete DCF: the EDS of the node with a ParameterValue for each parameter. A bus.yml can therefore name
the file as `dcf` or `configuration_file`, and other tools can read the file. The section [Backup] names the device, its
firmware and the time. A DCF without that section is accepted too; then the objects of the file give the identity.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import NO_RTR_BIT
from canopen_control.cia402.objects import (
    DIGITAL_OUTPUTS,
    HOME_OFFSET,
    MODES_OF_OPERATION,
    MOTION,
    TOUCH_PROBE_FUNCTION,
    axis_of,
)
from canopen_control.commissioning.identity import OBJECTS, DeviceIdentity
from canopen_control.commissioning.node_session import is_abort
from canopen_control.errors import CanopenError, EdsError, SdoLengthError
from canopen_control.frame import is_restricted
from canopen_control.od.codec import encode, zero_of
from canopen_control.od.dcf import dcf_text
from canopen_control.od.eds import parse_eds, read_eds
from canopen_control.od.eds_values import format_value, parse_number
from canopen_control.od.model import SCALAR_CODES, DataType
from canopen_control.od.pdos import COUNT, MAPPING, is_cob_id
from canopen_control.profiles import profile_of, profile_signals
from canopen_control.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    from canopen_control.commissioning.node_session import NodeSession
    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value

    ProgressCallback = Callable[[int, int], None]


# Selection of the objects in a backup: which objects are parameters, which belong to one device only, and which depend
# on the node-ID.
#
# An EDS does not define which objects are volatile. A parameter is readable and writable (rw, rww, rwr) and none of:
#
# - objects that ObjFlags exclude from writing or reading by tools (CiA 306-1, bits 0 and 1);
# - commands and process values, by CiA 301, CiA 302 and CiA 402, or by the manufacturer; outputs of the device profile;
# - counts of records and arrays, except those of PDO mappings; DOMAINs.
#
# Protected parameters belong to one device: node-ID and bit rate, and the calibration to the device's own encoder.


_MAPPINGS: Final = tuple(range(first, first + COUNT) for first in MAPPING.values())
_MAX_MAPPED: Final = 64  # a higher count identifies an MPDO (CiA 301, 7.5.2.36)
_NO_TRANSFER: Final = 0b11  # ObjFlags: not written in a download, not read in a scan (CiA 306-1)
# error history, store, restore, time stamp and OS commands of CiA 301; requests of CiA 302
_COMMANDS: Final = frozenset((0x1003, 0x1010, 0x1011, 0x1013, *range(0x1023, 0x1027), 0x1F25, 0x1F82, 0x1F83))
_PROGRAM: Final = range(0x1F50, 0x1F59)  # program download (CiA 302-3)
_DRIVE_COMMANDS: Final = (MOTION | {TOUCH_PROBE_FUNCTION}) - {MODES_OF_OPERATION}
_VENDOR_COMMANDS: Final = {
    0x286: frozenset((0x210B, 0x2700, 0x2701)),  # Trinamic: position of the motion controller, store and restore
}
_OWN_TO_THE_DEVICE: Final = {HOME_OFFSET: "is calibrated to the encoder of the original drive"}
_VENDOR_OWN: Final = {0x286: dict.fromkeys((0x2704, 0x2705, 0x2706), "is the node-ID or the bit rate")}
_MANUFACTURER: Final = range(0x2000, 0x6000)
_OWN_NAMES: Final = re.compile(r"node[ _-]?id\b|baud|bit[ _-]?rate|serial[ _-]?(number|no\b|nr\b)", re.IGNORECASE)
_EMCY: Final = (0x1014, 0)
_NODE_BITS: Final = 0x7F  # node-ID in an identifier of the predefined connection set (CiA 301, 7.3.3)
_IDENTIFIER: Final = 0x1FFF_FFFF


def parameters_of(od: ObjectDictionary) -> list[Entry]:
    """Return the parameters in a backup of a node with this object dictionary, sorted by address."""
    signals = profile_signals(od, profile_of(od)).values()
    outputs = frozenset(signal.index for signal in signals if signal.output)
    commands = outputs | _VENDOR_COMMANDS.get(_vendor(od), frozenset())
    chosen = (entry for entry in od if _can_be_kept(od, entry) and not _is_command(entry, commands))
    return sorted(chosen, key=lambda entry: entry.address)


def protection_of(od: ObjectDictionary, entry: Entry, *, same_device: bool = False) -> str:
    """Return why a parameter must not be written to another device, or "" if it may be written.

    With `same_device` calibration data may be written; node-ID, bit rate and serial number never.
    """
    index = axis_of(entry.index)[0]
    reason = _VENDOR_OWN.get(_vendor(od), {}).get(index, "")
    if not reason and not same_device:
        reason = _OWN_TO_THE_DEVICE.get(index, "")
    info = od.objects.get(entry.index)
    names = f"{entry.name}\n{info.name if info is not None else ''}"
    if not reason and index in _MANUFACTURER and _OWN_NAMES.search(names):
        return "has the name of a node-ID, bit rate or serial number"
    return reason


def without_unused_slots(values: Mapping[Address, Value]) -> dict[Address, Value]:
    """Return the values without mapping entries beyond the number of mapped objects, which have no meaning."""
    used = {}
    for (index, subindex), value in values.items():
        count = values.get((index, 0)) if any(index in records for records in _MAPPINGS) else None
        if not (isinstance(count, int) and count <= _MAX_MAPPED and subindex > count):
            used[index, subindex] = value
    return used


def follows_node_id(entry: Entry, value: Value, node_id: int) -> bool:
    """Whether a value depends on the node-ID, so that a node with another id needs another value.

    True for values that the EDS writes with $NODEID, and for COB-IDs of the predefined connection set of this node.
    """
    if not isinstance(value, int) or entry.data_type is not DataType.UNSIGNED32:
        return False
    if entry.relative and isinstance(entry.default, int) and not (value - entry.default) & _IDENTIFIER:
        return True
    of_messages = is_cob_id(*entry.address) or entry.address == _EMCY
    identifier = value & _IDENTIFIER
    is_own = identifier & _NODE_BITS == node_id and 0x80 < identifier < 0x600
    return of_messages and is_own and (entry.address == _EMCY or not is_restricted(identifier))


def _can_be_kept(od: ObjectDictionary, entry: Entry) -> bool:
    if not (entry.readable and entry.writable) or entry.data_type is DataType.DOMAIN or entry.obj_flags & _NO_TRANSFER:
        return False
    info = od.objects.get(entry.index)
    is_count = entry.subindex == 0 and (info is None or info.code not in SCALAR_CODES)
    return not is_count or any(entry.index in records for records in _MAPPINGS)


def _is_command(entry: Entry, commands: frozenset[int]) -> bool:
    index, _ = axis_of(entry.index)
    if entry.index in _COMMANDS or entry.index in _PROGRAM or entry.index in commands or index in _DRIVE_COMMANDS:
        return True
    return (index, entry.subindex) == (DIGITAL_OUTPUTS, 1)


def _vendor(od: ObjectDictionary) -> int:
    entry = od.get(0x1018, 1)
    value = entry.value if entry is not None and entry.value is not None else od.device.vendor_number
    return value if isinstance(value, int) else 0


SECTION: Final = "Backup"
_NUMBERS: Final = {
    "DeviceType": "device_type",
    "VendorID": "vendor_id",
    "ProductCode": "product_code",
    "RevisionNumber": "revision_number",
    "SerialNumber": "serial_number",
}
_NAMES: Final = {"DeviceName": "device_name", "HardwareVersion": "hardware", "SoftwareVersion": "software"}
_DEFAULT_BITRATE: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """Parameter values of `node_id` by address, with types from `od`; `where` is the node or file in messages.

    `date` is the time at which the file was written (ISO 8601), "" if unknown. `foreign` are objects to which a file
    gives a value other than the default although they are not parameters: read-only objects, commands, process values.
    """

    od: ObjectDictionary
    node_id: int
    identity: DeviceIdentity
    values: Mapping[Address, Value]
    where: str
    date: str = ""
    foreign: tuple[Address, ...] = ()

    @property
    def relative(self) -> frozenset[Address]:
        """Addresses whose values depend on the node-ID."""
        return frozenset(
            address for address, value in self.values.items() if follows_node_id(self.od[address], value, self.node_id)
        )

    def for_node(self, node_id: int) -> dict[Address, Value]:
        """Return the values converted for a node with another id."""
        shift, relative = node_id - self.node_id, self.relative
        return {
            address: value + shift if address in relative and isinstance(value, int) else value
            for address, value in self.values.items()
        }


def same_value(entry: Entry, a: Value, b: Value) -> bool:
    """Whether two values of an object have equal bytes, ignoring bit 30 of a PDO's COB-ID."""
    if isinstance(a, int) and isinstance(b, int) and is_cob_id(*entry.address):
        return a & ~NO_RTR_BIT == b & ~NO_RTR_BIT
    try:
        return a == b or encode(a, entry.data_type) == encode(b, entry.data_type)
    except ValueError:  # two files with different data types
        return False


def backup_text(
    parameters: ParameterSet, *, eds_name: str = "", bitrate: int | None = None, node_name: str = ""
) -> str:
    """Return the text of a backup as a DCF, stamped with the current time.

    `bitrate` is in bit/s; the default is the bit rate of the object dictionary, else 1 Mbit/s.
    """
    now = datetime.now(UTC)
    od = parameters.od
    sections = {title: lines for title, lines in od.sections.items() if title.lower() != SECTION.lower()}
    section = next((title for title in sections if title.lower() == "fileinfo"), "FileInfo")
    info = {**sections.pop(section, {})}
    info |= {"LastEDS": eds_name, "ModificationDate": f"{now:%m-%d-%Y}", "ModificationTime": f"{now:%I:%M%p}"}
    sections |= {section: info, SECTION: _section(parameters, f"{now:%Y-%m-%dT%H:%M:%SZ}")}
    cleared = {address: replace(entry, parameter_value=None) for address, entry in od.entries.items()}
    plain = replace(od, sections=sections, entries=cleared)
    rate = bitrate or od.bitrate or _DEFAULT_BITRATE
    return dcf_text(
        plain, parameters.node_id, rate, parameters.values, node_name=node_name, relative=parameters.relative
    )


def _section(parameters: ParameterSet, date: str) -> dict[str, str]:
    identity = parameters.identity
    lines = {"Format": "1", "Date": date, "Tool": f"canopen-control {__version__}"}
    numbers = {key: getattr(identity, name) for key, name in _NUMBERS.items()}
    lines |= {key: f"0x{value:08X}" for key, value in numbers.items() if value is not None}
    lines |= {key: getattr(identity, name) for key, name in _NAMES.items() if getattr(identity, name)}
    empty = [address for address, value in sorted(parameters.values.items()) if value in ("", b"")]
    if empty:  # an empty ParameterValue would be read as a missing one
        lines["Empty"] = " ".join(f"{index:04X}:{subindex:02X}" for index, subindex in empty)
    return lines


def read_backup(path: str | Path, node_id: int | None = None) -> ParameterSet:
    """Read a DCF, converted to `node_id` unless None; raise EdsError if the file is not a valid DCF.

    Values that a backup would not contain are ignored, so that a DCF from another tool cannot move a drive.
    """
    return _backup_of(read_eds(path), str(path), node_id)


def parse_backup(data: bytes, name: str) -> ParameterSet:
    """Return the parameters in the bytes of a DCF; `name` is its name in messages."""
    return _backup_of(parse_eds(data, name=name), name, None)


def _backup_of(file: EdsFile, path: str, node_id: int | None) -> ParameterSet:
    file_node_id = file.od.node_id
    if file_node_id is None:
        raise EdsError(path, 0, "has no node-ID ([DeviceComissioning]), so it is an EDS and not the DCF of a node")
    _refuse_unsound(file)
    od = file.od if node_id is None else file.od.for_node(node_id)
    chosen = {entry.address: entry.parameter_value for entry in parameters_of(od) if entry.parameter_value is not None}
    lines = next((texts for title, texts in od.sections.items() if title.lower() == SECTION.lower()), None)
    for address in _addresses(lines or {}):
        if (entry := od.get(*address)) is not None:
            chosen[address] = zero_of(entry.data_type)
    if not chosen:
        raise EdsError(path, 0, "has no ParameterValue of a parameter, so nothing can be compared or restored")
    identity = _backup_identity(lines, od) if lines is not None else _identity_of(od)
    date = "" if lines is None else _get(lines, "Date")
    values = without_unused_slots(dict(sorted(chosen.items())))
    foreign = tuple(entry.address for entry in od if entry.address not in chosen and _is_set(entry))
    return ParameterSet(od, node_id or file_node_id, identity, values, path, date, foreign)


def _refuse_unsound(file: EdsFile) -> None:
    """Raise EdsError for an invalid value or a truncated backup, which could only be restored in part."""
    is_backup = any(title.lower() == SECTION.lower() for title in file.od.sections)
    for issue in file.issues:
        if issue.code == "value-form" and issue.text.startswith("ParameterValue"):
            raise EdsError(issue.path, issue.line, f"{issue.text.partition(';')[0]}; correct or remove the line")
        if is_backup and issue.code == "list-object" and issue.text.endswith("has no section"):
            raise EdsError(issue.path, issue.line, f"{issue.text}: the backup is incomplete; make a new one")


def _is_set(entry: Entry) -> bool:
    """Whether a file gives an object a non-default value; identity objects do not count."""
    value = entry.parameter_value
    return value is not None and value != entry.default and entry.address not in OBJECTS.values()


def backup_file_text(parameters: ParameterSet, node_name: str = "") -> tuple[str, list[str]]:
    """Return the DCF of a backup, and a text for each parameter that a DCF cannot represent."""
    info = next((lines for title, lines in parameters.od.sections.items() if title.lower() == "fileinfo"), {})
    eds_name = next((value for key, value in info.items() if key.lower() == "filename"), "")
    text, lost = _representable_text(parameters, eds_name=eds_name, node_name=node_name)
    return text, [f"0x{index:04X}:{subindex:02X}: a DCF cannot represent this text" for index, subindex in lost]


def kept_text(parameters: ParameterSet) -> str:
    """Return the DCF of the values that a DCF can represent."""
    return _representable_text(parameters)[0]


def _representable_text(
    parameters: ParameterSet, *, eds_name: str = "", node_name: str = ""
) -> tuple[str, list[Address]]:
    """Return the text of a backup without the values that a DCF cannot represent, and their addresses."""
    text = backup_text(parameters, eds_name=eds_name, node_name=node_name)
    lost = lost_in_text(parameters, text)
    if lost:
        values = {address: value for address, value in parameters.values.items() if address not in lost}
        text = backup_text(replace(parameters, values=values), eds_name=eds_name, node_name=node_name)
    return text, lost


def lost_in_text(parameters: ParameterSet, text: str) -> list[Address]:
    """Return the addresses whose values change in a DCF: texts with line breaks or leading or trailing blanks."""
    od = parse_eds(text.encode(), parameters.node_id).od
    return [
        address
        for address, value in parameters.values.items()
        if value not in ("", b"") and not _survives_parsing(od.get(*address), value)
    ]


def _survives_parsing(entry: Entry | None, value: Value) -> bool:
    parsed = None if entry is None else entry.parameter_value
    return entry is not None and parsed is not None and same_value(entry, parsed, value)


def _addresses(lines: Mapping[str, str]) -> list[Address]:
    words = (word.partition(":") for word in _get(lines, "Empty").split())
    try:
        return [(int(index, 16), int(subindex, 16)) for index, _, subindex in words]
    except ValueError:
        return []


def _get(lines: Mapping[str, str], name: str) -> str:
    return next((value for key, value in lines.items() if key.lower() == name.lower()), "")


def _backup_identity(lines: Mapping[str, str], od: ObjectDictionary) -> DeviceIdentity:
    """Return the identity in the [Backup] section; missing or invalid numbers are taken from the objects."""
    in_objects = _identity_of(od)

    def number(key: str, name: str) -> int | None:
        try:
            return parse_number(_get(lines, key)).value
        except ValueError:
            value: int | None = getattr(in_objects, name)
            return value

    return DeviceIdentity.of((number(*pair) for pair in _NUMBERS.items()), (_get(lines, key) for key in _NAMES))


def _identity_of(od: ObjectDictionary) -> DeviceIdentity:
    """Return the identity in the objects of a file; a number that is missing or 0 is None."""
    entries = (od.get(*OBJECTS[name]) for name in _NUMBERS.values())
    values = (None if entry is None else entry.value for entry in entries)
    identity = DeviceIdentity.of(value if isinstance(value, int) and value else None for value in values)
    return replace(
        identity,
        vendor_id=identity.vendor_id or od.device.vendor_number or None,
        product_code=identity.product_code or od.device.product_number or None,
    )


# Comparison of the parameters of two nodes, two files, or a node and a file.
#
# Values that depend on the node-ID are compared without it: a COB-ID of 0x185 on node 5 and of 0x186 on node 6 are the
# same parameter. A parameter that only one side has is a difference too, unless the node gave a reason for refusing it.


_COMMUNICATION = range(0x1000, 0x2000)  # identifiers and mappings are hexadecimal


@dataclass(frozen=True, slots=True)
class DifferentParameter:
    """Parameter with different values, as texts; None if one side lacks the object."""

    index: int
    subindex: int
    name: str
    a: str | None
    b: str | None


def differences(a: ParameterSet, b: ParameterSet) -> Iterator[DifferentParameter]:
    """Yield the parameters that differ, or that one side lacks, in order of address."""
    a_relative, b_relative = a.relative, b.relative
    for address in sorted({*a.values, *b.values}):
        in_a, in_b = a.values.get(address), b.values.get(address)
        side = a if in_a is not None else b
        follows = address in a_relative, address in b_relative
        if in_a is not None and in_b is not None and follows[0] == follows[1]:
            plain_a, plain_b = _without_id(in_a, a, follows[0]), _without_id(in_b, b, follows[1])
            if same_value(side.od[address], plain_a, plain_b):
                continue
        texts = [parameter_text(each, address) if address in each.values else None for each in (a, b)]
        yield DifferentParameter(*address, _name(side, side.od[address]), *texts)


def _without_id(value: Value, side: ParameterSet, follows: bool) -> Value:
    return value - side.node_id if follows and isinstance(value, int) else value


def _name(side: ParameterSet, entry: Entry) -> str:
    info = side.od.objects.get(entry.index)
    return entry.name if info is None or info.name == entry.name else f"{info.name}.{entry.name}"


def parameter_text(side: ParameterSet, address: Address) -> str:
    """Format a value for users, relative to $NODEID if it depends on the node-ID, else as in `value_text`."""
    value, entry = side.values[address], side.od[address]
    if isinstance(value, int) and address in side.relative:
        return f"$NODEID+0x{value - side.node_id:X}"
    return value_text(entry, value)


def value_text(entry: Entry, value: Value) -> str:
    """Format a value for users: numbers from index 0x2000 on in decimal, other values as in a DCF."""
    if isinstance(value, int | float) and entry.index not in _COMMUNICATION:
        return str(value)
    return format_value(value, entry.data_type) if value not in ("", b"") else "(empty)"


# Reading of a node's parameters through an SDO session, for a backup, for a comparison, or before a restore.
#
# Refused objects are left out and reported with the reason. With `twice`, everything is read a second time: an object
# whose value has changed is then no parameter, whatever the EDS says.


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Parameter that could not be read, or whose value varies, with the reason."""

    entry: Entry
    why: str

    def __str__(self) -> str:
        return f"{entry_label(self.entry)}: {self.why}"


def entry_label(entry: Entry) -> str:
    """Return the address and the name of an object as text."""
    return f"0x{entry.index:04X}:{entry.subindex:02X} {entry.name}"


def read_parameters(
    session: NodeSession, *, twice: bool = True, progress: ProgressCallback | None = None
) -> tuple[ParameterSet, list[LeftOut]]:
    """Read the identity and all parameters of a node, and list refused parameters; raise ConfigError without an EDS.

    With `twice`, parameters that changed between two readings are left out. `progress` receives count and total.
    """
    od = session.dictionary
    identity = session.identity()
    entries = parameters_of(od)
    total = len(entries) * (2 if twice else 1)
    values, left_out = read_values(session, entries, lambda done: progress(done, total) if progress else None)
    if twice:
        again, _ = read_values(
            session,
            [od[value] for value in values],
            lambda done: progress(len(entries) + done, total) if progress else None,
        )
        for address in [
            address_read for address_read, value in values.items() if not _again(od[address_read], again, value)
        ]:
            left_out.append(LeftOut(od[address], "two readings differed, so the object is not a parameter"))
            del values[address]
    return ParameterSet(od, session.node_id, identity, without_unused_slots(values), str(session)), left_out


def read_same(
    session: NodeSession, file: ParameterSet, progress: ProgressCallback | None = None
) -> tuple[ParameterSet, list[LeftOut]]:
    """Read the parameters of a file from a node with the file's data types; a session without an EDS adopts them."""
    od = file.od.for_node(session.node_id)
    if session.od is None:
        session.od = od
    entries = [od[address] for address in file.values]
    identity = session.identity()
    values, left_out = read_values(session, entries, lambda done: progress(done, len(entries)) if progress else None)
    return ParameterSet(od, session.node_id, identity, values, str(session)), left_out


def _again(entry: Entry, again: Mapping[Address, Value], value: Value) -> bool:
    return entry.address in again and same_value(entry, again[entry.address], value)


def read_values(
    session: NodeSession, entries: Iterable[Entry], progress: Callable[[int], None] | None = None
) -> tuple[dict[Address, Value], list[LeftOut]]:
    """Read objects; return the values by address, and the objects that are refused or have another length."""
    values: dict[Address, Value] = {}
    left_out = []
    for number, entry in enumerate(entries, 1):
        try:
            values[entry.address] = session.read_value(entry)
        except CanopenError as error:
            if not (isinstance(error, SdoLengthError) or is_abort(error)):
                raise
            left_out.append(LeftOut(entry, reason_of(error)))
        if progress is not None:
            progress(number)
    return values, left_out


def reason_of(error: CanopenError) -> str:
    """Return the text of an error from the abort code on, or the whole text without an abort code."""
    text = str(error)
    place = text.find("abort 0x")
    return text[place:] if place >= 0 else text
