"""One section of an EDS or DCF file as an entry (CiA 306-1, 4.6.3).

What the file does not say well is replaced by what harms least, and reported: an unknown type is handled as bytes of
any length, an access that cannot be read is rw, limits the wrong way round are none. A value that its type cannot
hold is left out; its text stays in the entry's `texts`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.eds_sections import clip, optional_number, read_number
from canopen_control.od.eds_values import Parsed, parse_value
from canopen_control.od.issues import Report
from canopen_control.od.model import ACCESS_TYPES, DataType, Entry, ObjectCode

if TYPE_CHECKING:
    from canopen_control.od.eds_sections import Section

__all__ = ["EntryReader", "RangeType"]

_TYPES: dict[int, DataType] = {int(data_type): data_type for data_type in DataType}
_ACCESS = {name: name for name in ACCESS_TYPES}
_ACCESS_ALIASES = {
    "r": "ro",
    "w": "wo",
    "r/w": "rw",
    "wr": "rw",
    "readonly": "ro",
    "writeonly": "wo",
    "readwrite": "rw",
}
_VALUE_KEYS = ("defaultvalue", "parametervalue")


class RangeType(NamedTuple):
    """A data type of a device's own: a basic type and the limits of its values."""

    base: DataType
    low: int | None
    high: int | None


class _Limit(NamedTuple):
    value: int | float | None = None
    relative: bool = False


class _Traits(NamedTuple):
    """What entries with the same keys have in common; `defaults` are texts of values that were read without a doubt."""

    data_type: DataType
    known: bool
    access: str
    pdo_mappable: bool
    low: _Limit
    high: _Limit
    obj_flags: int
    defaults: dict[str, Parsed]


_NO_LIMIT = _Limit()
_NO_VALUE = Parsed(None)


@dataclass(frozen=True, slots=True)
class EntryReader:
    """Reads the entries of a file; `node_id` is what $NODEID stands for, None where that is not known yet.

    A file with thousands of entries describes them by the same few texts, so that what was read of those without an
    issue is kept. `ranges` are the data types that the file describes itself, by their index.
    """

    node_id: int | None
    report: Report
    kept: dict[tuple[str | int | None, ...], _Traits] = field(default_factory=dict)
    ranges: dict[int, RangeType] = field(default_factory=dict)

    def read(self, section: Section, index: int, subindex: int, name: str, code: int) -> Entry:
        """Return the entry that `section` describes; `code` is its object code."""
        traits = self._traits(section, code)
        data_type, known, access, pdo_mappable, low, high, obj_flags, _ = traits
        default = self._parsed(section, "defaultvalue", traits) if known else _NO_VALUE
        parameter = self._parsed(section, "parametervalue", traits) if known else _NO_VALUE
        return Entry(
            index,
            subindex,
            name,
            data_type,
            access,
            pdo_mappable,
            default.value,
            low.value,
            high.value,
            default.relative,
            low.relative,
            high.relative,
            parameter.value,
            parameter.relative,
            obj_flags,
            section.line,
            section.texts(),
        )

    def like(self, model: Entry, subindex: int, name: str, values: Section | None = None, key: str = "") -> Entry:
        """Return `model` as another subindex, with the default that a [xxxxValue] section has for it, if any."""
        parsed = _NO_VALUE if values is None else self._read_value(values, key, model.data_type)
        default, relative, _ = Parsed(model.default, model.relative) if parsed is _NO_VALUE else parsed
        return Entry(
            model.index,
            subindex,
            name,
            model.data_type,
            model.access,
            model.pdo_mappable,
            default,
            model.low,
            model.high,
            relative,
            model.low_relative,
            model.high_relative,
            model.parameter_value,
            model.parameter_relative,
            model.obj_flags,
            model.line,
        )

    def _traits(self, section: Section, code: int) -> _Traits:
        text = section.values.get
        told = (
            code,
            text("datatype"),
            text("accesstype"),
            text("pdomapping"),
            text("lowlimit"),
            text("highlimit"),
            text("objflags"),
        )
        traits = self.kept.get(told)
        if traits is not None:
            return traits
        issues = len(self.report.issues)
        data_type, known = self._data_type(section, code)
        low, high = self._limits(section, data_type)
        access = self._access(section)
        pdo_mappable = read_number(section, "pdomapping", 0, self.report) != 0
        obj_flags = read_number(section, "objflags", 0, self.report)
        traits = _Traits(data_type, known, access, pdo_mappable, low, high, obj_flags, {})
        if len(self.report.issues) == issues:
            self.kept[told] = traits
        return traits

    def _data_type(self, section: Section, code: int) -> tuple[DataType, bool]:
        if "datatype" not in section.values and code == ObjectCode.DOMAIN:
            return DataType.DOMAIN, True
        number = optional_number(section, "datatype", self.report)
        ranged = self.ranges.get(number) if number is not None else None
        if ranged is not None:
            return ranged.base, True
        data_type = _TYPES.get(number) if number is not None else None
        if data_type is not None:
            return data_type, True
        what = (
            f"DataType={clip(section.get('datatype'))} is no basic type"
            if "datatype" in section.values
            else f"[{section.title}] has no DataType"
        )
        kept = " and its values kept as text" if any(section.get(key) for key in _VALUE_KEYS) else ""
        self.report.warning(section.line_of("datatype"), "data-type", f"{what}; handled as bytes of any length{kept}")
        return DataType.DOMAIN, False

    def _range_type(self, section: Section) -> RangeType | None:
        if not self.ranges or "datatype" not in section.values:
            return None
        number = optional_number(section, "datatype", Report(self.report.path))
        return self.ranges.get(number) if number is not None else None

    def _access(self, section: Section) -> str:
        text = section.get("accesstype").lower()
        access = _ACCESS.get(text)
        if access is None:
            access = _ACCESS_ALIASES.get(text, "rw")
            what = f"AccessType={clip(text)} is unknown" if text else f"[{section.title}] has no AccessType"
            self.report.warning(section.line_of("accesstype"), "access-type", f"{what}; taken as {access}")
        return access

    def _parsed(self, section: Section, key: str, traits: _Traits) -> Parsed:
        text = section.values.get(key)
        if not text:
            return _NO_VALUE  # an empty DefaultValue= is how many tools say that there is none
        parsed = traits.defaults.get(text)
        if parsed is None:
            parsed = self._read_value(section, key, traits.data_type)
            if parsed.issue is None and parsed is not _NO_VALUE:
                traits.defaults[text] = parsed
        return parsed

    def _read_value(self, section: Section, key: str, data_type: DataType) -> Parsed:
        text = section.get(key)
        if not text:
            return _NO_VALUE
        try:
            parsed = parse_value(text, data_type, self.node_id)
        except ValueError as problem:
            reason = (
                f"{section.spelled(key)}={clip(text)} is no {data_type.name} ({problem}); the entry is left without"
            )
            self.report.error(section.line_of(key), "value-form", reason)
            return _NO_VALUE
        if parsed.issue is not None:
            issue = parsed.issue
            told = f"{section.spelled(key)}={clip(text)}: {issue.text}"
            self.report.add(section.line_of(key), issue.code, issue.severity, told)
        return parsed

    def _limits(self, section: Section, data_type: DataType) -> tuple[_Limit, _Limit]:
        if "lowlimit" not in section.values and "highlimit" not in section.values:
            ranged = self._range_type(section)
            return (_NO_LIMIT, _NO_LIMIT) if ranged is None else (_Limit(ranged.low), _Limit(ranged.high))
        low, high = self._limit(section, "lowlimit", data_type), self._limit(section, "highlimit", data_type)
        if low.value is not None and high.value is not None and low.value > high.value:
            text = f"LowLimit={section.get('lowlimit')} is above HighLimit={section.get('highlimit')}; both are ignored"
            self.report.warning(section.line_of("lowlimit"), "limit-order", clip(text))
            return _NO_LIMIT, _NO_LIMIT
        return low, high

    def _limit(self, section: Section, key: str, data_type: DataType) -> _Limit:
        text = section.get(key)
        if not text or data_type.bits is None:
            return _NO_LIMIT
        try:
            parsed = parse_value(text, data_type, self.node_id)
        except ValueError as problem:
            told = f"{section.spelled(key)}={clip(text)} is no {data_type.name} ({problem}); ignored"
            self.report.warning(section.line_of(key), "limit-form", told)
            return _NO_LIMIT
        return _Limit(parsed.value, parsed.relative) if isinstance(parsed.value, int | float) else _NO_LIMIT
