"""Known drives, recognised by identity or EDS names, and the keys of bus.yml that they need.

The data is in the files of `eds/personalities`. A missing key is only proposed, with its source, and never applied.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from canopen_control.personality import personality_names, personality_of, read_personality

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from canopen_control.personality import BusKey, Personality


_CYCLE_PERIOD: Final = re.compile(r"(index: 0x1006, sub_index: 0, value: )\d+")
_INDEX: Final = re.compile(r"index: (0x[0-9A-Fa-f]+)")


def known_drive(vendor: int, product: int, words: str) -> Personality | None:
    """Return a drive's personality by vendor id and product code (0: unknown), else by a name in the EDS, or None.

    A name in `words`, the text of the EDS, counts only if the personality or the device has no known vendor id.
    """
    if vendor and (match := personality_of(vendor, product)) is not None:
        return match
    names = re.split(r"[^0-9a-z]+", words.lower())
    for name in personality_names():
        if any(word.startswith(name) for word in names):
            drive = read_personality(name)
            if not (vendor and drive.identity):
                return drive
    return None


def proposals(
    drive: Personality, sync_us: int, keys: Collection[str], written: Collection[int], commanded: Collection[str]
) -> Iterator[tuple[BusKey, str]]:
    """Yield the missing keys of bus.yml that a drive needs, each with the text to write.

    `written` are the indexes in the `sdo:` list. The mode of a command interface is proposed if the interface is in
    `commanded`.
    """
    for key in drive.bus_keys:
        text = _CYCLE_PERIOD.sub(rf"\g<1>{sync_us}", key.text) if sync_us else key.text
        if key.key == "sdo":
            has = all(int(index, 16) in written for index in _INDEX.findall(text))
        else:
            interface = key.key.removesuffix("_mode")
            has = key.key in keys or (interface != key.key and interface not in commanded)
        if not has:
            yield key, text
