"""What `eds --json` prints: issues, entries, differences and PDOs of EDS and DCF files."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from canopen_control.od.eds_values import format_value
from canopen_control.od.issues import Severity
from canopen_control.od.model import DataType
from canopen_control.rpc.messages.declare import Document

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.errors import EdsError
    from canopen_control.od.eds import EdsFile
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value
    from canopen_control.od.pdos import Pdo

__all__ = ["ChangeDocument", "CheckDocument", "Difference", "EntryDocument", "IssueDocument", "MappedDocument",
           "PdoDocument", "changes_of", "checked", "entry_document", "pdo_document", "refused"]  # fmt: skip

Plain: TypeAlias = int | float | str | None
_COMPARED = ("name", "data_type", "access", "pdo_mappable", "default", "parameter_value", "low", "high", "obj_flags")


class IssueDocument(Document, frozen=True):
    """What is wrong or doubtful in a line; `severity` is "error", "warning" or "note"."""

    line: int
    code: str
    severity: str
    text: str


class CheckDocument(Document, frozen=True, kw_only=True):
    """What a check of a file found."""

    file: str
    objects: int = 0
    entries: int = 0
    errors: int = 0
    warnings: int = 0
    notes: int = 0
    issues: list[IssueDocument]


class EntryDocument(Document, frozen=True, kw_only=True):
    """An entry: `index` is hexadecimal; values are numbers or text, bytes hexadecimal."""

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
    """What a field is in two files."""

    a: Plain
    b: Plain


class ChangeDocument(Document, frozen=True, kw_only=True, omit_defaults=True):
    """An entry that two files do not have alike; `change` is "added", "removed" or "changed", by `fields`."""

    index: str
    subindex: int
    change: str
    name: str
    fields: dict[str, Difference] | None = None


class MappedDocument(Document, frozen=True):
    """An object in a PDO; `name` None where the file does not have it."""

    index: str
    subindex: int
    bits: int
    name: str | None


class PdoDocument(Document, frozen=True, kw_only=True):
    """A PDO by default; `cob_id_entry` has the flags of its entry too."""

    pdo: str
    enabled: bool
    cob_id: int | None
    cob_id_entry: int | None
    transmission_type: int | None
    bits: int
    slots: int
    mapped: list[MappedDocument]


def checked(name: str, file: EdsFile) -> CheckDocument:
    """Return what reading a file has found."""
    count = dict.fromkeys(Severity, 0)
    for issue in file.issues:
        count[issue.severity] += 1
    return CheckDocument(
        file=name,
        objects=len(file.od.objects),
        entries=len(file.od),
        errors=count[Severity.ERROR],
        warnings=count[Severity.WARNING],
        notes=count[Severity.NOTE],
        issues=[IssueDocument(each.line, each.code, each.severity.value, each.text) for each in file.issues],
    )


def refused(name: str, error: EdsError) -> CheckDocument:
    """Return why a file is none."""
    return CheckDocument(file=name, errors=1, issues=[IssueDocument(error.line, "not-canopen", "error", error.reason)])


def entry_document(od: ObjectDictionary, entry: Entry) -> EntryDocument:
    """Return an entry."""
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
    """Yield the entries that differ, by address."""
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
    """Return a PDO."""
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
                f"0x{each.index:04X}", each.subindex, each.bits, None if each.entry is None else each.entry.name
            )
            for each in pdo.mapped
        ],
    )


def _plain(value: Value | None) -> Plain:
    """Return what JSON can hold; bytes in hexadecimal, what is no finite number as text."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and value - value != 0:
        return format_value(value, DataType.REAL64)
    return value
