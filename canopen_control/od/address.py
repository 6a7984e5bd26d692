"""Parser of object addresses in user input: INDEX[:SUB] in hexadecimal, or a name in the EDS.

Numbers are hexadecimal with or without 0x, as in all messages of this package. A name is the name of an entry, a pair
``Object.Entry``, or the name of an object followed by ``:SUB``. A name that several objects share is refused, with a
list of these objects.
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
_SHOWN = 5  # number of similar names offered for an unknown name


@dataclass(frozen=True, slots=True)
class ObjectAddress:
    """Address of an object, with the EDS entry or None; `whole` is True if the user gave no subindex."""

    index: int
    subindex: int
    entry: Entry | None = None
    object_name: str = ""
    whole: bool = False

    @property
    def label(self) -> str:
        """Address and name for messages."""
        name = self.entry.name if self.entry is not None else ""
        if self.object_name and self.object_name != name:
            name = f"{self.object_name}.{name}" if name else self.object_name
        return f"0x{self.index:04X}:{self.subindex:02X}" + (f" {name}" if name else "")


def find_object(text: str, od: ObjectDictionary | None) -> ObjectAddress:
    """Return the object addressed by `text`; raise ConfigError with a hint if it does not exist.

    `od` may be None; then only numbers are valid.
    """
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
    """Return the addresses to read: all readable subindices of a whole object, else `address` alone."""
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
        return f"object {text!r}: {len(same)} entries have that name: {_listed(same)}; use the index instead"
    near = [entry for entry in od if folded in entry.name.casefold() or folded in _parent(entry, od)]
    near = near or _similar(folded, od)
    hint = f"; did you mean {_listed(near)}?" if near else "; numbers are hexadecimal, as in 0x6041:00"
    return f"no object {text!r} in the EDS{hint}"


def _similar(folded: str, od: ObjectDictionary) -> list[Entry]:
    by_name = {entry.name.casefold(): entry for entry in od}
    return [by_name[name] for name in difflib.get_close_matches(folded, by_name, _SHOWN, 0.8)]


def _parent(entry: Entry, od: ObjectDictionary) -> str:
    info = od.objects.get(entry.index)
    return info.name.casefold() if info is not None else ""


def _listed(entries: list[Entry]) -> str:
    shown = [f"0x{entry.index:04X}:{entry.subindex:02X} {entry.name}" for entry in entries[:_SHOWN]]
    return ", ".join(shown) + (", ..." if len(entries) > _SHOWN else "")
