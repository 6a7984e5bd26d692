"""One section of an EDS or DCF file as an entry (CiA 306-1, 4.6.3).

What the file does not say well is replaced by what harms least, and reported: an unknown type is handled as bytes of
any length, an access that cannot be read is rw, limits the wrong way round are none. A value that its type cannot
hold is left out; its text stays in the entry's `texts`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.od.eds_sections import clip, optional_number, read_number
from canopen_control.od.eds_values import parse_value
from canopen_control.od.model import ACCESS_TYPES, DataType, Entry, ObjectCode

if TYPE_CHECKING:
    from canopen_control.od.eds_sections import Section
    from canopen_control.od.eds_values import Parsed
    from canopen_control.od.issues import Report

__all__ = ["EntryReader"]

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


class _Limit(NamedTuple):
    value: int | float | None = None
    relative: bool = False


_NO_LIMIT = _Limit()


@dataclass(frozen=True, slots=True)
class EntryReader:
    """Reads entries; `node_id` is what $NODEID stands for, None where that is not known yet."""

    node_id: int | None
    report: Report

    def read(self, section: Section, index: int, subindex: int, name: str, code: int) -> Entry:
        """Return the entry that `section` describes; `code` is its object code."""
        data_type, known = self._data_type(section, code)
        default = self._parsed(section, "defaultvalue", data_type) if known else None
        parameter = self._parsed(section, "parametervalue", data_type) if known else None
        low, high = self._limits(section, data_type)
        return Entry(
            index=index,
            subindex=subindex,
            name=name,
            data_type=data_type,
            access=self._access(section),
            pdo_mappable=read_number(section, "pdomapping", 0, self.report) != 0,
            default=None if default is None else default.value,
            low=low.value,
            high=high.value,
            relative=default is not None and default.relative,
            low_relative=low.relative,
            high_relative=high.relative,
            parameter_value=None if parameter is None else parameter.value,
            parameter_relative=parameter is not None and parameter.relative,
            obj_flags=read_number(section, "objflags", 0, self.report),
            line=section.line,
            texts=section.texts(),
        )

    def with_default(self, entry: Entry, section: Section, key: str) -> Entry:
        """Return `entry` with the default that a [xxxxValue] section gives it."""
        parsed = self._parsed(section, key, entry.data_type)
        if parsed is None:
            return entry
        return replace(entry, default=parsed.value, relative=parsed.relative)

    def _data_type(self, section: Section, code: int) -> tuple[DataType, bool]:
        pair = section.pair("datatype")
        if pair is None and code == ObjectCode.DOMAIN:
            return DataType.DOMAIN, True
        number = optional_number(section, "datatype", self.report)
        data_type = _TYPES.get(number) if number is not None else None
        if data_type is not None:
            return data_type, True
        what = (
            f"DataType={clip(pair.value)} is no basic type"
            if pair is not None
            else f"[{section.title}] has no DataType"
        )
        kept = " and its values kept as text" if any(section.get(key) for key in _VALUE_KEYS) else ""
        self.report.warning(section.line_of("datatype"), "data-type", f"{what}; handled as bytes of any length{kept}")
        return DataType.DOMAIN, False

    def _access(self, section: Section) -> str:
        text = section.get("accesstype").lower()
        access = _ACCESS.get(text)
        if access is None:
            access = _ACCESS_ALIASES.get(text, "rw")
            what = f"AccessType={clip(text)} is unknown" if text else f"[{section.title}] has no AccessType"
            self.report.warning(section.line_of("accesstype"), "access-type", f"{what}; taken as {access}")
        return access

    def _parsed(self, section: Section, key: str, data_type: DataType) -> Parsed | None:
        pair = section.pairs.get(key)
        if pair is None or not pair[1]:
            return None  # an empty DefaultValue= is how many tools say that there is none
        written, text, line = pair
        try:
            parsed = parse_value(text, data_type, self.node_id)
        except ValueError as problem:
            reason = f"{written}={clip(text)} is no {data_type.name} ({problem}); the entry is left without"
            self.report.error(line, "value-form", reason)
            return None
        if parsed.issue is not None:
            issue = parsed.issue
            self.report.add(line, issue.code, issue.severity, f"{written}={clip(text)}: {issue.text}")
        return parsed

    def _limits(self, section: Section, data_type: DataType) -> tuple[_Limit, _Limit]:
        pairs = section.pairs
        if "lowlimit" not in pairs and "highlimit" not in pairs:
            return _NO_LIMIT, _NO_LIMIT
        low, high = self._limit(section, "lowlimit", data_type), self._limit(section, "highlimit", data_type)
        if low.value is not None and high.value is not None and low.value > high.value:
            text = f"LowLimit={section.get('lowlimit')} is above HighLimit={section.get('highlimit')}; both are ignored"
            self.report.warning(section.line_of("lowlimit"), "limit-order", clip(text))
            return _NO_LIMIT, _NO_LIMIT
        return low, high

    def _limit(self, section: Section, key: str, data_type: DataType) -> _Limit:
        pair = section.pair(key)
        if pair is None or not pair.value or data_type.bits is None:
            return _NO_LIMIT
        try:
            parsed = parse_value(pair.value, data_type, self.node_id)
        except ValueError as problem:
            text = f"{pair.key}={clip(pair.value)} is no {data_type.name} ({problem}); ignored"
            self.report.warning(pair.line, "limit-form", text)
            return _NO_LIMIT
        return _Limit(parsed.value, parsed.relative) if isinstance(parsed.value, int | float) else _NO_LIMIT
