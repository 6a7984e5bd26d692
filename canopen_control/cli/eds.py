"""Check, show, compare and convert EDS, DCF, XDD and XDC files.

Exit codes: 0 success; 1 errors or differences found, or no such object; 2 wrong usage, no such file, or not an EDS.
"""

from __future__ import annotations

import re
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

from canopen_control.cli.support.arguments import eds_path, node_id
from canopen_control.cli.support.output import Progress, json_text
from canopen_control.errors import ConfigError, EdsError
from canopen_control.host.files import write_whole
from canopen_control.od.dcf import dcf_text, eds_text
from canopen_control.od.eds import SUFFIXES, read_eds
from canopen_control.od.eds_values import format_value
from canopen_control.od.issues import Issue, Severity
from canopen_control.od.model import DataType, ObjectCode
from canopen_control.od.pdos import MAX_BITS, Pdo, pdos_of
from canopen_control.od.xdd import xdd_text
from canopen_control.rpc.messages.declare import Document

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value


# Documents of `eds --json`: issues, entries, differences and PDOs of EDS and DCF files.


Plain: TypeAlias = int | float | str | None
_COMPARED = ("name", "data_type", "access", "pdo_mappable", "default", "parameter_value", "low", "high", "obj_flags")


class EdsCheckDocument(Document, frozen=True, kw_only=True):
    """Result of `eds check` for one file: the issues, and the counts of objects, entries and issues."""

    file: str
    objects: int = 0
    entries: int = 0
    errors: int = 0
    warnings: int = 0
    notes: int = 0
    issues: list[Issue]


class EntryDocument(Document, frozen=True, kw_only=True):
    """Entry of an object dictionary; `index` is hexadecimal text, as are values that consist of bytes."""

    index: str
    subindex: int
    name: str
    object: str
    object_type: str
    data_type: str
    access: str
    pdo_mappable: bool
    rpdo_mappable: bool
    tpdo_mappable: bool
    default: Plain
    parameter_value: Plain
    plus_node_id: bool
    low: Plain
    high: Plain
    line: int


class Difference(Document, frozen=True):
    """Value of a field in the two compared files, `a` and `b`."""

    a: Plain
    b: Plain


class ChangeDocument(Document, frozen=True, kw_only=True, omit_defaults=True):
    """Entry that differs between two files; `change` is "added", "removed" or "changed"."""

    index: str
    subindex: int
    change: str
    name: str
    fields: dict[str, Difference] | None = None


class MappedDocument(Document, frozen=True):
    """Object mapped to a PDO; `name` is None if the object is not in the file."""

    index: str
    subindex: int
    bits: int
    name: str | None


class PdoDocument(Document, frozen=True, kw_only=True):
    """Default configuration of a PDO; `cob_id_entry` is the COB-ID together with its flag bits."""

    pdo: str
    enabled: bool
    cob_id: int | None
    cob_id_entry: int | None
    transmission_type: int | None
    bits: int
    slots: int
    mapped: list[MappedDocument]


_UNUSABLE: Final = "not-canopen"  # code of the only issue of a file that is not an EDS


def checked(name: str, file: EdsFile) -> EdsCheckDocument:
    """Return the check result of a readable file, with all its issues."""
    count = dict.fromkeys(Severity, 0)
    for issue in file.issues:
        count[issue.severity] += 1
    return EdsCheckDocument(
        file=name,
        objects=len(file.od.objects),
        entries=len(file.od),
        errors=count[Severity.ERROR],
        warnings=count[Severity.WARNING],
        notes=count[Severity.NOTE],
        issues=list(file.issues),
    )


def refused(name: str, error: EdsError) -> EdsCheckDocument:
    """Return the check result of a file that cannot be read as an EDS; the reason is the only issue."""
    return EdsCheckDocument(
        file=name, errors=1, issues=[Issue(name, error.line, _UNUSABLE, Severity.ERROR, error.reason)]
    )


def entry_document(od: ObjectDictionary, entry: Entry) -> EntryDocument:
    """Return an entry as `eds show --json` prints it."""
    return EntryDocument(
        index=f"0x{entry.index:04X}",
        subindex=entry.subindex,
        name=entry.name,
        object=od.objects[entry.index].name,
        object_type=od.objects[entry.index].code.name,
        data_type=entry.data_type.name,
        access=entry.access,
        pdo_mappable=entry.pdo_mappable,
        rpdo_mappable=entry.rpdo_mappable,
        tpdo_mappable=entry.tpdo_mappable,
        default=_plain(entry.default),
        parameter_value=_plain(entry.parameter_value),
        plus_node_id=entry.relative and od.node_id is None,
        low=_plain(entry.low),
        high=_plain(entry.high),
        line=entry.line,
    )


def changes_of(a: ObjectDictionary, b: ObjectDictionary) -> Iterator[ChangeDocument]:
    """Yield the entries that differ between two object dictionaries, in order of address."""
    addresses: list[Address] = sorted({*a.entries, *b.entries})
    for address in addresses:
        old, new = a.get(*address), b.get(*address)
        if old is not None and new is not None:
            fields = _differences(old, new)
            if fields:
                yield _change(new, "changed", fields)
        elif new is not None:
            yield _change(new, "added")
        elif old is not None:
            yield _change(old, "removed")


def _change(entry: Entry, change: str, fields: dict[str, Difference] | None = None) -> ChangeDocument:
    index = f"0x{entry.index:04X}"
    return ChangeDocument(index=index, subindex=entry.subindex, change=change, name=entry.name, fields=fields)


def _differences(old: Entry, new: Entry) -> dict[str, Difference]:
    return {
        field: Difference(_field(old, field), _field(new, field))
        for field in _COMPARED
        if getattr(old, field) != getattr(new, field)
    }


def _field(entry: Entry, field: str) -> Plain:
    value = getattr(entry, field)
    return value.name if isinstance(value, DataType) else _plain(value)


def pdo_document(pdo: Pdo) -> PdoDocument:
    """Return a PDO as `eds pdos --json` prints it."""
    return PdoDocument(
        pdo=pdo.name,
        enabled=pdo.enabled,
        cob_id=None if pdo.cob_id is None else pdo.cob_id & 0x1FFFFFFF,
        cob_id_entry=pdo.cob_id,
        transmission_type=pdo.transmission_type,
        bits=pdo.bits,
        slots=pdo.slots,
        mapped=[
            MappedDocument(
                f"0x{mapped.index:04X}",
                mapped.subindex,
                mapped.bits,
                None if mapped.entry is None else mapped.entry.name,
            )
            for mapped in pdo.mapped
        ],
    )


def _plain(value: Value | None) -> Plain:
    """Convert a value for JSON: bytes become hexadecimal text, infinite numbers and NaN become text."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and value - value != 0:
        return format_value(value, DataType.REAL64)
    return value


EXAMPLE = """canopen-control eds check TMCM-1270.eds
         canopen-control eds show TMCM-1270.eds 0x6041
         canopen-control eds diff TMCM-1270.eds generic_cia402.eds
         canopen-control eds pdos TMCM-1270.eds
         canopen-control eds convert TMCM-1270.eds -o TMCM-1270.xdd"""

_ADDRESS = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{1,4})(?::(?:0[xX])?([0-9A-Fa-f]{1,2}))?")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    check = actions.add_parser("check", help="report errors and questionable entries in the files")
    check.add_argument("files", nargs="+", metavar="FILE")
    show = actions.add_parser("show", help="list all objects, or one object")
    show.add_argument("file", metavar="FILE")
    show.add_argument("object", nargs="?", metavar="INDEX[:SUB]", help="hexadecimal address, or a name")
    diff = actions.add_parser("diff", help="compare the objects of two files")
    diff.add_argument("a", metavar="A")
    diff.add_argument("b", metavar="B")
    pdos = actions.add_parser("pdos", help="show the default mapping of the PDOs")
    pdos.add_argument("file", metavar="FILE")
    convert = actions.add_parser("convert", help="write a file as EDS, DCF, XDD or XDC, by the ending of OUT")
    convert.add_argument("file", metavar="FILE")
    convert.add_argument("-o", "--output", metavar="OUT", required=True, help="file to write; it must not exist")
    convert.add_argument("--force", action="store_true", help="overwrite OUT")
    for action in (check, show, diff, pdos, convert):
        action.add_argument("--node-id", type=node_id, metavar="N", help="value of $NODEID")


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    missing = [name for name in _files_of(args) if not eds_path(name).is_file()]
    if missing:
        names = [f"{name} (a folder)" if Path(name).is_dir() else name for name in missing]
        print(f"canopen-control: no such file: {', '.join(names)}", file=sys.stderr)
        return 2
    return _ACTIONS[args.action](args)


def _files_of(args: argparse.Namespace) -> list[str]:
    return list(getattr(args, "files", ())) or [getattr(args, name) for name in ("file", "a", "b") if name in args]


def _read(name: str, args: argparse.Namespace) -> EdsFile:
    return read_eds(eds_path(name), args.node_id)


# -- check


def _check(args: argparse.Namespace) -> int:
    reports: list[EdsCheckDocument] = []
    with Progress("checking", "files") as progress:
        for name in args.files:
            progress.at(len(reports), len(args.files))
            reports.append(_checked(name, args))
    if args.json:
        print(json_text(reports))
    else:
        for report in reports:
            for line in _report_lines(report):
                print(line)
    unusable = any(issue.code == _UNUSABLE for report in reports for issue in report.issues)
    return 2 if unusable else 1 if any(report.errors for report in reports) else 0


def _checked(name: str, args: argparse.Namespace) -> EdsCheckDocument:
    try:
        return checked(name, _read(name, args))
    except EdsError as error:
        return refused(name, error)


def _report_lines(report: EdsCheckDocument) -> Iterator[str]:
    for issue in report.issues:
        place = f"{report.file}:{issue.line}" if issue.line else report.file
        yield f"{place}: {issue.severity.value}: {issue.text} [{issue.code}]"
    sections = {"errors": report.errors, "warnings": report.warnings, "notes": report.notes}
    summary = ", ".join(_counted(number, kind) for kind, number in sections.items() if number) or "no issue"
    yield f"{report.file}: {report.objects} objects, {report.entries} entries: {summary}"


def _counted(number: int, plural: str) -> str:
    return f"{number} {plural if number > 1 else plural.removesuffix('s')}"


# -- show


def _show(args: argparse.Namespace) -> int:
    od = _read(args.file, args).od
    entries = list(_selected(od, args.object))
    if not entries:
        print(f"canopen-control: {args.file}: no object {args.object!r}{_hint(od, args.object)}", file=sys.stderr)
        return 1
    if args.json:
        print(json_text([entry_document(od, entry) for entry in entries]))
    else:
        configured = any(entry.parameter_value is not None for entry in od)
        header = _ENTRY_HEADER if configured else tuple(column for column in _ENTRY_HEADER if column != _CONFIGURED)
        _print_table(header, [_entry_row(od, entry, configured=configured) for entry in entries])
    return 0


def _selected(od: ObjectDictionary, text: str | None) -> Iterator[Entry]:
    ordered = sorted(od, key=lambda entry: entry.address)
    if text is None:
        yield from ordered
        return
    match = _ADDRESS.fullmatch(text)
    if match is not None:
        index, subindex = int(match[1], 16), None if match[2] is None else int(match[2], 16)
        yield from (entry for entry in ordered if entry.index == index and subindex in (None, entry.subindex))
        return
    folded = text.casefold()
    named = {info.index for info in od.objects.values() if info.name.casefold() == folded}
    single = od.find(text)
    yield from (entry for entry in ordered if entry.index in named or entry is single)


def _hint(od: ObjectDictionary, text: str) -> str:
    folded = text.casefold()
    similar = [info for info in od.objects.values() if folded in info.name.casefold()][:5]
    return f"; did you mean {', '.join(f'0x{info.index:04X} {info.name}' for info in similar)}?" if similar else ""


_CONFIGURED = "parameter value"
_ENTRY_HEADER = ("address", "name", "type", "access", "PDO", "default", _CONFIGURED, "limits")


def _entry_row(od: ObjectDictionary, entry: Entry, *, configured: bool) -> tuple[str, ...]:
    """Return an entry as table cells; `configured` adds a column for the ParameterValues of a DCF."""
    values = [(entry.default, entry.relative), (entry.parameter_value, entry.parameter_relative)]
    texts = [_value_text(entry, *pair, od.node_id) or "-" for pair in (values if configured else values[:1])]
    mappable = ("R" if entry.rpdo_mappable else "") + ("T" if entry.tpdo_mappable else "")
    return (
        f"0x{entry.index:04X}:{entry.subindex:02X}",
        _full_name(od, entry),
        entry.data_type.name,
        entry.access,
        mappable or "-",
        *texts,
        _limits_text(entry, od.node_id),
    )


def _full_name(od: ObjectDictionary, entry: Entry) -> str:
    info = od.objects[entry.index]
    return entry.name if info.code in (ObjectCode.VAR, ObjectCode.DOMAIN) else f"{info.name}: {entry.name}"


def _value_text(entry: Entry, value: Value | None, relative: bool, node_id: int | None) -> str:
    if value is None:
        return ""
    text = format_value(value, entry.data_type)
    return f"$NODEID+{text}" if relative and node_id is None else text


def _limits_text(entry: Entry, node_id: int | None) -> str:
    if entry.low is None and entry.high is None:
        return "-"
    texts = ["" if limit is None else format_value(limit, entry.data_type) for limit in (entry.low, entry.high)]
    marks = [relative and node_id is None for relative in (entry.low_relative, entry.high_relative)]
    low, high = (f"$NODEID+{text}" if mark else text for text, mark in zip(texts, marks, strict=True))
    return f"{low}..{high}"


def _print_table(header: Sequence[str], rows: list[tuple[str, ...]]) -> None:
    widths = [max(len(row[column]) for row in (header, *rows)) for column in range(len(header))]
    for row in (header, *rows):
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())


# -- diff


def _diff(args: argparse.Namespace) -> int:
    a, b = _read(args.a, args).od, _read(args.b, args).od
    changes = list(changes_of(a, b))
    if args.json:
        print(json_text(changes))
    elif not changes:
        print(f"{args.a} and {args.b}: {len(a.entries)} entries, equal")
    for change in [] if args.json else changes:
        print(_change_line(change))
    return 1 if changes else 0


def _change_line(change: ChangeDocument) -> str:
    place = f"{change.index}:{change.subindex:02X} {change.name}"
    if change.fields is None:
        return f"{'-' if change.change == 'removed' else '+'} {place}"
    fields = ", ".join(f"{field} {both.a} -> {both.b}" for field, both in change.fields.items())
    return f"~ {place}: {fields}"


# -- pdos


def _pdos(args: argparse.Namespace) -> int:
    od = _read(args.file, args).od
    pdos = pdos_of(od)
    if args.json:
        print(json_text([pdo_document(pdo) for pdo in pdos]))
    else:
        relative = od.node_id is None
        for pdo in pdos:
            print(_pdo_line(od, pdo, relative))
            for mapped in pdo.mapped:
                name = "(not in the file)" if mapped.entry is None else _full_name(od, mapped.entry)
                label = "dummy" if mapped.is_dummy else name
                print(f"    0x{mapped.index:04X}:{mapped.subindex:02X}  {mapped.bits:2} bits  {label}")
    return 0


def _pdo_line(od: ObjectDictionary, pdo: Pdo, relative: bool) -> str:
    state = "on " if pdo.enabled else "off"
    cob_id = "no COB-ID" if pdo.cob_id is None else f"{pdo.cob_id & 0x1FFFFFFF:03X}"
    source = od.get(pdo.communication, 1)
    plus = "+node" if relative and source is not None and source.relative else ""
    kind = "?" if pdo.transmission_type is None else pdo.transmission_type
    return f"{pdo.name}  {state}  {cob_id}{plus}  type {kind}  {pdo.bits} of {MAX_BITS} bits, {pdo.slots} slots"


# -- convert


class ConvertedDocument(Document, frozen=True):
    """Result of `eds convert`; `problems` is the number of issues found in the input file."""

    file: str
    output: str
    objects: int
    problems: int


def _convert(args: argparse.Namespace) -> int:
    output = Path(args.output)
    ending = output.suffix.lower()
    if ending not in SUFFIXES:
        raise ConfigError(f"{output}: the suffix chooses the format, and must be one of: {', '.join(SUFFIXES)}")
    if output.exists() and not args.force:
        raise ConfigError(f"{output} already exists; choose another name, or --force")
    if not output.absolute().parent.is_dir():
        raise ConfigError(f"{output} cannot be written: no such folder")
    file = _read(args.file, args)
    write_whole(output, _converted(file.od, ending, args).encode())
    for issue in [] if args.json else file.issues:
        print(f"{args.file}:{issue.line}: {issue.severity.name.lower()}: {issue.text}")
    count = sum(entry.parameter_value is not None for entry in file.od.entries.values())
    if count and ending in _DEVICE_TYPES and not args.json:
        print(f"{output}: without ParameterValue ({count} in the input); .dcf and .xdc include it")
    done = ConvertedDocument(args.file, str(output), len(file.od.objects), len(file.issues))
    print(json_text(done) if args.json else f"{output}: {done.objects} objects of {args.file}")
    return 0


_DEVICE_TYPES: Final = (".eds", ".xdd")  # formats that describe a device type, without the values of one device


def _converted(od: ObjectDictionary, ending: str, args: argparse.Namespace) -> str:
    if ending in _DEVICE_TYPES:
        entries = {address: replace(entry, parameter_value=None) for address, entry in od.entries.items()}
        od = replace(od, entries=entries)
        return eds_text(od) if ending == ".eds" else xdd_text(od)
    if od.node_id is None:
        raise ConfigError(f"{args.output} describes one device, and {args.file} has no node-ID; give --node-id N")
    return dcf_text(od, od.node_id, od.bitrate) if ending == ".dcf" else xdd_text(od, configured=True)


_ACTIONS: dict[str, Callable[[argparse.Namespace], int]] = {
    "convert": _convert,
    "check": _check,
    "show": _show,
    "diff": _diff,
    "pdos": _pdos,
}
