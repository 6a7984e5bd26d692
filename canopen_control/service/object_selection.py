"""Which objects of a dictionary a word means: an address, a pattern of addresses or names, or a part of a name.

    0x6081  6081  0x1018:01     an object, or one subindex of it
    0x60*   *velocity*          patterns with * and ?, of addresses and of names
    velocity                    every name that has it in it

What an object holds is compared to the default of the EDS; where that gives none nothing is known to have changed.
"""

from __future__ import annotations

import fnmatch
import re
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError
from canopen_control.od.codec import encode
from canopen_control.od.model import SCALAR_CODES, DataType

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.od.model import Entry, ObjectDictionary, Value

__all__ = ["has_changed", "is_scanned", "object_name", "select_objects"]

_ADDRESS: Final = re.compile(r"(?:0x)?([0-9a-f]{4})(?::(?:0x)?([0-9a-f]{1,2}))?", re.IGNORECASE)
_PATTERN: Final = re.compile(r"[*?]")
_NOT_IN_A_SCAN: Final = 2  # bit 1 of ObjFlags (CiA 306-1)


def select_objects(od: ObjectDictionary, words: Iterable[str]) -> list[Entry]:
    """Return the entries that any of the words means, by address; all without a word. ConfigError for none of one."""
    ordered = sorted(od, key=lambda entry: entry.address)
    wanted = list(words)
    if not wanted:
        return ordered
    found = set[tuple[int, int]]()
    for word in wanted:
        meant = {entry.address for entry in ordered if _means(word, od, entry)}
        if not meant:
            raise ConfigError(
                f"no object {word!r} in the EDS; write an address such as 0x6081 or 0x1018:01, a pattern such as "
                "0x60* or *velocity*, or a part of a name"
            )
        found |= meant
    return [entry for entry in ordered if entry.address in found]


def _means(word: str, od: ObjectDictionary, entry: Entry) -> bool:
    match = _ADDRESS.fullmatch(word)
    if match is not None:
        return entry.index == int(match[1], 16) and (match[2] is None or entry.subindex == int(match[2], 16))
    folded, name = word.casefold(), object_name(od, entry).casefold()
    if _PATTERN.search(word):
        addresses = (f"0x{entry.index:04x}", f"0x{entry.index:04x}:{entry.subindex:02x}")
        texts = (*addresses, *(each.removeprefix("0x") for each in addresses), name)
        return any(fnmatch.fnmatchcase(text, folded) for text in texts)
    return bool(folded) and folded in name


def object_name(od: ObjectDictionary, entry: Entry) -> str:
    """Return the name of an entry, with that of its object where it is one of several."""
    info = od.objects.get(entry.index)
    if info is None or info.code in SCALAR_CODES or info.name == entry.name:
        return entry.name
    return f"{info.name}: {entry.name}"


def is_scanned(entry: Entry) -> bool:
    """Whether a look at everything reads it: it is readable, no DOMAIN, and ObjFlags do not forbid it."""
    return entry.readable and entry.data_type is not DataType.DOMAIN and not entry.obj_flags & _NOT_IN_A_SCAN


def has_changed(entry: Entry, value: Value) -> bool:
    """Whether an object that can be written holds something else than its default; False where that is not known."""
    if entry.default is None or not entry.writable:
        return False
    try:
        return encode(value, entry.data_type) != encode(entry.default, entry.data_type)
    except ValueError:
        return value != entry.default
