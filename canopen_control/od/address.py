"""Parses an object's address as users write it: INDEX[:SUB] in hexadecimal, or a name of the EDS.

The law of this file: numbers are hexadecimal with and without 0x, as in every message of this package. A name is that
of an entry, ``Object.Entry``, or an object's followed by ``:SUB``; one that fits several objects is refused with them.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import ConfigError

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, ObjectDictionary


_NUMBER = re.compile(r"(?:0[xX])?([0-9A-Fa-f]{1,4})(?::(?:0[xX])?([0-9A-Fa-f]{1,2}))?")
_NAME_AND_SUB = re.compile(r"(.+):(?:0[xX])?([0-9A-Fa-f]{1,2})")
_SHOWN = 5  # names offered instead of one that is none


@dataclass(frozen=True, slots=True)
class ObjectAddress:
    """An object, and its entry in the EDS where there is one; `whole`: it was named without a subindex."""

    index: int
    subindex: int
    entry: Entry | None = None
    object_name: str = ""
    whole: bool = False

    @property
    def label(self) -> str:
        """The address and the name, for people."""
        name = self.entry.name if self.entry is not None else ""
        if self.object_name and self.object_name != name:
            name = f"{self.object_name}.{name}" if name else self.object_name
        return f"0x{self.index:04X}:{self.subindex:02X}" + (f" {name}" if name else "")


def find_object(text: str, od: ObjectDictionary | None) -> ObjectAddress:
    """Return what `text` means; ConfigError with what to write instead. `od` may be None: then by number only."""
    match = _NUMBER.fullmatch(text)
    if match is not None:
        return _address(int(match[1], 16), int(match[2] or "0", 16), od, whole=match[2] is None)
    if od is None:
        raise ConfigError(f"object {text!r}: without an EDS write INDEX[:SUB] in hexadecimal, as in 0x6041:00")
    entry = od.find(text)
    if entry is not None:
        return _address(entry.index, entry.subindex, od)
    name, subindex, split = text, 0, _NAME_AND_SUB.fullmatch(text)
    if split is not None:
        name, subindex = split[1], int(split[2], 16)
    objects = [index for index, info in od.objects.items() if info.name.casefold() == name.casefold()]
    if len(objects) == 1:
        return _address(objects[0], subindex, od, whole=split is None)
    raise ConfigError(_why_not(text, name, od))


def parts_of(address: ObjectAddress, od: ObjectDictionary | None) -> list[ObjectAddress]:
    """Return what is meant to be read: every subindex of an object named without one, else the one address."""
    if not address.whole or od is None:
        return [address]
    readable = [sub for sub in od.subindices(address.index) if od[address.index, sub].readable]
    return [_address(address.index, sub, od) for sub in readable] or [address]


def _address(index: int, subindex: int, od: ObjectDictionary | None, *, whole: bool = False) -> ObjectAddress:
    if od is None:
        return ObjectAddress(index, subindex, whole=whole)
    info = od.objects.get(index)
    return ObjectAddress(index, subindex, od.get(index, subindex), info.name if info is not None else "", whole)


def _why_not(text: str, name: str, od: ObjectDictionary) -> str:
    folded = name.casefold()
    same = [entry for entry in od if entry.name.casefold() == folded]
    if same:
        return f"object {text!r} has that name {len(same)} times: {_listed(same)}; choose one by its number"
    near = [entry for entry in od if folded in entry.name.casefold() or folded in _parent(entry, od)]
    near = near or _alike(folded, od)
    hint = f"; did you mean {_listed(near)}?" if near else "; numbers are hexadecimal, as in 0x6041:00"
    return f"no object {text!r} in the EDS{hint}"


def _alike(folded: str, od: ObjectDictionary) -> list[Entry]:
    """Return the entries whose names are nearly that."""
    by_name = {entry.name.casefold(): entry for entry in od}
    return [by_name[name] for name in difflib.get_close_matches(folded, by_name, _SHOWN, 0.8)]


def _parent(entry: Entry, od: ObjectDictionary) -> str:
    info = od.objects.get(entry.index)
    return info.name.casefold() if info is not None else ""


def _listed(entries: list[Entry]) -> str:
    shown = [f"0x{entry.index:04X}:{entry.subindex:02X} {entry.name}" for entry in entries[:_SHOWN]]
    return ", ".join(shown) + (", ..." if len(entries) > _SHOWN else "")
