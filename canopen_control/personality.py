"""Personalities: behaviour of manufacturers' drives in YAML files, with a source for every line.

    title: Elmo Gold
    identity:                                   # 0x1018:01 and :02; no products: all of the vendor
      - {vendor: 0x9A, products: [], source: "..."}
    objects: [0x607A]                           # objects that the EDS of such a drive has
    absent: [0x603F]                            # objects that the drive lacks, even if its EDS lists them
    modes: [1, 3, 7, 8, 9, 10]                  # of 0x6502, if they are known
    quirks:                                     # as in `drive --quirk`
      - {quirk: brake_delay=0.5, source: "jsd#48"}
    bus:                                        # keys of bus.yml that a robot with such a drive needs
      - {key: enable_settle_ms, value: 600, why: "set-points count when the brake has lifted", source: "jsd#48"}
    not_known: ["..."]                          # facts without a public source

`source` is a repository with a number or a file, or a manual with its page, never copied text; `unsourced` if no public
source is known. Quirks are checked by the virtual drive that gets the personality.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, nearest
from canopen_control.yamlfile.convert import position, setting
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load

if TYPE_CHECKING:
    from canopen_control.yamlfile.node import Problems


_FOLDER: Final = "personalities"
_MAX = 0xFFFFFFFF
_VENDOR: Final = re.compile(r"^ *- \{vendor: (\w+)", re.MULTILINE)  # format of the bundled files


class PersonalityError(ConfigError):
    """Error in a personality file, or in the name of a personality."""


@dataclass(frozen=True)
class DriveIdentity:
    """Vendor-ID (0x1018:01) and product codes (0x1018:02); an empty list means all products of the vendor."""

    vendor: int = setting(low=1, high=_MAX)
    products: list[int] = setting(factory=list, low=0, high=_MAX)
    source: str = "unsourced"


@dataclass(frozen=True)
class QuirkLine:
    """Quirk in a personality file, in the notation of `drive --quirk`, with its source."""

    quirk: str
    source: str = "unsourced"
    here: Node = position()  # noqa: RUF009 - makes a field


@dataclass(frozen=True)
class BusKey:
    """Key of bus.yml that drives with this personality need, with its value, reason and source."""

    key: str
    value: int | float | bool | str | dict[int, int]
    why: str = ""
    source: str = "unsourced"
    here: Node = position()  # noqa: RUF009 - makes a field

    @property
    def text(self) -> str:
        """Key and value as a line for bus.yml."""
        value = self.value
        if isinstance(value, bool):
            return f"{self.key}: {'true' if value else 'false'}"
        if isinstance(value, dict):
            return f"{self.key}: {{{', '.join(f'{key}: {item}' for key, item in value.items())}}}"
        return f"{self.key}: {value}"


@dataclass(frozen=True)
class Personality:
    """Behaviour of a manufacturer's drives, as in a personality file."""

    title: str
    identity: list[DriveIdentity] = setting(factory=list)
    objects: list[int] = setting(factory=list, low=0x1000, high=0xFFFF)
    absent: list[int] = setting(factory=list, low=0x1000, high=0xFFFF)
    modes: list[int] = setting(factory=list, low=1, high=32)
    quirks: list[QuirkLine] = setting(factory=list)
    bus_keys: list[BusKey] = setting(key="bus", factory=list)
    not_known: list[str] = setting(factory=list)
    here: Node = position()  # noqa: RUF009 - makes a field

    @property
    def path(self) -> str:
        """Path of the personality file."""
        return self.here.path

    @property
    def name(self) -> str:
        """Name of the personality: file name without suffix."""
        return Path(self.path).stem

    def line_of(self, key: str) -> str:
        """Return the location of a key in the personality file, as ``PATH:LINE``."""
        return f"{self.path}:{self.here.keys()[key].line}"

    def place(self, line: QuirkLine) -> str:
        """Return the location of a quirk in the personality file, as ``PATH:LINE``."""
        return f"{self.path}:{line.here.line}"

    def fits(self, vendor: int | None, product: int | None) -> bool:
        """Whether a drive with this vendor-ID and product code has this personality."""
        return any(
            identity.vendor == vendor and (not identity.products or product in identity.products)
            for identity in self.identity
        )


def personality_names() -> list[str]:
    """Return the names of the bundled personalities, sorted."""
    return sorted(path.stem for path in data_path("eds", _FOLDER).glob("*.yaml"))


def read_personality(name: str) -> Personality:
    """Read a bundled personality by name, or a file by path; raise PersonalityError, which lists all errors."""
    bundled = data_path("eds", _FOLDER) / f"{name}.yaml"
    path = bundled if name in personality_names() else Path(name)
    if path is not bundled and not path.is_file():
        known = personality_names()
        problem = "no file" if "/" in name or Path(name).suffix else "no personality"
        near = nearest(name, known, listed=False)
        raise PersonalityError(f"{problem} {name!r}{near}; available: {', '.join(known)}; or a file of your own")
    return load(path, Personality, error=PersonalityError, check=_check)


def _check(personality: Personality, _problems: Problems) -> None:
    """Report quirks and keys of bus.yml whose source is empty."""
    lines: list[QuirkLine | BusKey] = [*personality.quirks, *personality.bus_keys]
    for line in lines:
        if not line.source.strip():
            line.here.error("source: empty; write a repository with a number, a manual with a page, or unsourced")


@functools.cache
def _vendors_of(name: str) -> frozenset[int]:
    """Return the vendor-IDs in a bundled file without parsing YAML, which would slow down every start."""
    text = (data_path("eds", _FOLDER) / f"{name}.yaml").read_text(encoding="utf-8")
    return frozenset(int(number, 0) for number in _VENDOR.findall(text))


def personality_of(vendor: int | None, product: int | None) -> Personality | None:
    """Return the bundled personality for a vendor-ID and product code (0x1018:01 and :02), or None.

    A personality that names the product takes precedence over a personality for all products of the vendor.
    """
    names = [name for name in personality_names() if vendor in _vendors_of(name)]
    fitting = [personality for personality in map(read_personality, names) if personality.fits(vendor, product)]
    named = [
        personality for personality in fitting if any(product in identity.products for identity in personality.identity)
    ]
    return next(iter([*named, *fitting]), None)
