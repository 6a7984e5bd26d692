"""Large generated EDS files, shaped like public ones, for the load times in `services`.

A shape says how many entries there are, how they are put together (single variables, arrays and records by their
subindices, arrays in short form, PDOs, domains) and how its maker writes: which keys, hexadecimal or decimal, which
ends of lines. The same shape is the same file everywhere, byte by byte.
"""

from __future__ import annotations

import random
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


_WORDS = re.findall(
    r"[a-z]+",
    "actual position velocity torque demand limit window time factor control status motor current filter gain offset "
    "brake encoder resolution temperature supply voltage error history user defined digital analog input output "
    "profile acceleration deceleration homing switch mode supported window reserved commutation feedback",
)
_NUMBERS = ((0x05, 8, False), (0x06, 16, False), (0x07, 32, False), (0x02, 8, True), (0x03, 16, True), (0x04, 32, True))
_ACCESS = ("ro", "rw", "rw", "rw", "wo", "const", "rww", "rwr")
_MANUFACTURER, _PROFILE, _LAST = 0x2000, 0x6000, 0x9FFF
_PDO_ENTRIES = 8
DUMMIES = 7  # types for gaps in an RPDO; some readers create objects for them


@dataclass(frozen=True, slots=True)
class Shape:
    """The parameters of a generated file; the shares of object types are weights."""

    name: str
    entries: int
    variables: float = 1.0
    arrays: float = 1.0
    records: float = 1.0
    compact: float = 0.0
    domains: float = 0.0
    pdos: int = 4  # in each direction
    subindices: tuple[int, int] = (2, 16)  # of an array or a record
    hexadecimal: bool = True
    limits: float = 0.3  # fraction of the numeric entries
    defaults: float = 0.7
    strings: float = 0.05
    reals: float = 0.02
    more_keys: bool = False  # ObjFlags everywhere, and empty LowLimit and HighLimit, like some editors
    end: str = "\n"
    pad: str = ""  # around the equals sign
    comments: bool = False


SHAPES = (
    Shape("servo drive", 1000),
    Shape("servo drive, every key", 1500, more_keys=True, end="\r\n"),
    Shape("variables only", 1200, arrays=0, records=0, pdos=2, hexadecimal=False),
    Shape("many strings and reals", 1800, strings=0.3, reals=0.2, domains=0.1),
    Shape("input and output modules", 2200, arrays=3, records=0, subindices=(16, 64), end="\r\n"),
    Shape("100 PDOs of each direction", 2600, pdos=100),
    Shape("arrays in short form", 3000, compact=1, subindices=(8, 127)),
    Shape("limits everywhere", 3200, limits=1.0, defaults=1.0, end="\r\n"),
    Shape("multi-axis drive", 4300, records=3, pdos=64, subindices=(2, 32), pad=" "),
    Shape("controller with comments", 5200, comments=True, hexadecimal=False, domains=0.1),
    Shape("gateway", 6800, arrays=3, subindices=(64, 254), more_keys=True),
    Shape("everything", 8500, compact=0.2, domains=0.2, pdos=32, limits=0.5, strings=0.1, reals=0.1, end="\r\n"),
)


def written(shape: Shape) -> bytes:
    """Return the text of a file with the given shape."""
    return _Writer(shape).file()


@dataclass(slots=True)
class _Writer:
    """Writes one file; `lists` are its objects in the order in which they were written."""

    shape: Shape
    draw: random.Random = field(init=False)
    lists: dict[str, list[int]] = field(init=False)
    lines: list[str] = field(default_factory=list)
    entries: int = 0
    mappable: int = 0x20000008  # the mapped object of a PDO: the first manufacturer object

    def __post_init__(self) -> None:
        self.draw = random.Random(self.shape.name)
        self.lists = {"MandatoryObjects": [], "OptionalObjects": [], "ManufacturerObjects": []}

    def file(self) -> bytes:
        """Return the whole file; the object lists come first in it, so they are generated first."""
        self._standard_objects()
        self._pdo_records()
        self._other_objects()
        objects, self.lines = self.lines, []
        self._device()
        for name, indices in self.lists.items():
            numbered = {str(number): f"0x{index:04X}" for number, index in enumerate(indices, 1)}
            self._section(name, {"SupportedObjects": str(len(indices)), **numbered})
        return self.shape.end.join([*self.lines, *objects, ""]).encode("latin-1")

    def _section(self, title: str, keys: dict[str, str]) -> None:
        equals = f"{self.shape.pad}={self.shape.pad}"
        if self.shape.comments:
            self.lines.append(f"; {title}: {self._name()}")
        self.lines += [f"[{title}]", *(f"{key}{equals}{value}" for key, value in keys.items()), ""]

    def _device(self) -> None:
        self._section("FileInfo", {"FileName": f"{self.shape.name}.eds", "FileVersion": "1", "EDSVersion": "4.0"})
        rates = {f"BaudRate_{rate}": "1" for rate in (10, 20, 50, 125, 250, 500, 800, 1000)}
        counts = {"Granularity": "8", "NrOfRXPDO": str(self.shape.pdos), "NrOfTXPDO": str(self.shape.pdos)}
        self._section(
            "DeviceInfo", {"VendorName": "none", "VendorNumber": "0x1", "ProductNumber": "2"} | rates | counts
        )
        self._section("DummyUsage", {f"Dummy000{number}": "1" for number in range(1, DUMMIES + 1)})
        self._section("Comments", {"Lines": "1", "Line1": "made up"})

    def _standard_objects(self) -> None:
        self._variable(0x1000, "Device type", self._keys(0x07, "ro", "0x00000000"))
        self._variable(0x1001, "Error register", self._keys(0x05, "ro", "0x0"))
        identity = ("Vendor-ID", "Product code", "Revision number", "Serial number")
        self._list(0x1018, 9, "Identity", [(name, self._keys(0x07, "ro", "")) for name in identity])

    def _pdo_records(self) -> None:
        for communication, mapping, cob_id in ((0x1400, 0x1600, 0x200), (0x1800, 0x1A00, 0x180)):
            for number in range(self.shape.pdos):
                named = f"$NODEID+0x{cob_id + 0x100 * number:X}" if number < 4 else "0x80000000"
                parameters = [
                    ("COB-ID", self._keys(0x07, "rw", named)),
                    ("Transmission type", self._keys(0x05, "rw", "255")),
                    ("Inhibit time", self._keys(0x06, "rw", "0")),
                ]
                self._list(communication + number, 9, f"PDO {number + 1} communication parameter", parameters)
                mapped = [(f"PDO mapping entry {sub}", self._mapping(sub)) for sub in range(1, _PDO_ENTRIES + 1)]
                self._list(mapping + number, 9, f"PDO {number + 1} mapping parameter", mapped, "1")

    def _mapping(self, subindex: int) -> dict[str, str]:
        return self._keys(0x07, "rw", f"0x{self.mappable:08X}" if subindex == 1 else "0")

    def _other_objects(self) -> None:
        self._variable(_MANUFACTURER, "Mapped by the PDOs", self._keys(0x05, "rw", "0") | {"PDOMapping": "1"})
        kinds = {"variable": self.shape.variables, "array": self.shape.arrays, "record": self.shape.records}
        kinds |= {"compact": self.shape.compact, "domain": self.shape.domains}
        names, weights = list(kinds), list(kinds.values())
        for index in self._indices():
            if self.entries >= self.shape.entries:
                return
            self._object(index, self.draw.choices(names, weights)[0])

    def _indices(self) -> Iterator[int]:
        """Yield the indices for objects, with gaps."""
        index = _MANUFACTURER
        while index < _LAST:
            index += self.draw.choice((1, 1, 1, 2, 5))
            yield index

    def _object(self, index: int, kind: str) -> None:
        if kind == "variable":
            self._variable(index, self._name(), self._any_keys())
        elif kind == "domain":
            keys = {"ObjectType": "0x2", "DataType": "0x000F", "AccessType": "rw"}
            self._entry(f"{index:04X}", self._name(), keys)
            self._listed(index)
        elif kind == "compact":
            self._compact(index)
        else:
            count = self.draw.randint(*self.shape.subindices)
            same = self._any_keys()
            subs = [(self._name(), same if kind == "array" else self._any_keys()) for _ in range(count)]
            self._list(index, 8 if kind == "array" else 9, self._name(), subs)

    def _compact(self, index: int) -> None:
        count = self.draw.randint(*self.shape.subindices)
        keys = {"ParameterName": self._name(), "ObjectType": "0x8", "CompactSubObj": str(count)}
        self._section(f"{index:04X}", keys | self._keys(0x07, "rw", "0"))
        names = {str(sub): self._name() for sub in range(1, count + 1)}
        self._section(f"{index:04X}Name", {"NrOfEntries": str(count), **names})
        values = {str(sub): str(self.draw.randrange(1 << 16)) for sub in range(1, count + 1, 2)}
        self._section(f"{index:04X}Value", {"NrOfEntries": str(len(values)), **values})
        self.entries += count + 1
        self._listed(index)

    def _list(
        self, index: int, code: int, name: str, subs: list[tuple[str, dict[str, str]]], number: str | None = None
    ) -> None:
        keys = {"ParameterName": name, "ObjectType": f"0x{code}", "SubNumber": str(len(subs) + 1)}
        self._section(f"{index:04X}", keys)
        count = self._keys(0x05, "rw" if number else "ro", number or str(len(subs)))
        self._entry(f"{index:04X}sub0", "Highest sub-index supported", {"ObjectType": "0x7", **count})
        for subindex, (label, described) in enumerate(subs, 1):
            self._entry(f"{index:04X}sub{subindex:X}", label, {"ObjectType": "0x7", **described})
        self._listed(index)

    def _variable(self, index: int, name: str, keys: dict[str, str]) -> None:
        self._entry(f"{index:04X}", name, {"ObjectType": "0x7", **keys})
        self._listed(index)

    def _entry(self, title: str, name: str, keys: dict[str, str]) -> None:
        self._section(title, {"ParameterName": name, **keys})
        self.entries += 1

    def _listed(self, index: int) -> None:
        mandatory = index in (0x1000, 0x1001, 0x1018)
        optional = index < _MANUFACTURER or index >= _PROFILE
        name = "MandatoryObjects" if mandatory else "OptionalObjects" if optional else "ManufacturerObjects"
        self.lists[name].append(index)

    def _name(self) -> str:
        return " ".join(self.draw.sample(_WORDS, self.draw.randint(1, 4))).capitalize()

    def _any_keys(self) -> dict[str, str]:
        kind = self.draw.random()
        if kind < self.shape.strings:
            return self._keys(0x09, self.draw.choice(("ro", "const", "rw")), self._name())
        if kind < self.shape.strings + self.shape.reals:
            return self._keys(0x08, "rw", f"{self.draw.uniform(-1000, 1000):.4f}")
        return self._number()

    def _number(self) -> dict[str, str]:
        data_type, bits, signed = self.draw.choice(_NUMBERS)
        low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
        value = self.draw.choice((0, 0, 0, 1, self.draw.randint(low, high)))
        default = self._text(value, bits) if self.draw.random() < self.shape.defaults else ""
        keys = self._keys(data_type, self.draw.choice(_ACCESS), default)
        if self.draw.random() < self.shape.limits:
            keys |= {"LowLimit": self._text(low, bits), "HighLimit": self._text(high, bits)}
        if self.draw.random() < 0.2:
            keys["PDOMapping"] = "1"
        return keys

    def _text(self, value: int, bits: int) -> str:
        return f"0x{value & ((1 << bits) - 1):0{bits // 4}X}" if self.shape.hexadecimal else str(value)

    def _keys(self, data_type: int, access: str, default: str) -> dict[str, str]:
        keys = {"DataType": f"0x{data_type:04X}", "AccessType": access}
        if default or self.shape.more_keys:
            keys["DefaultValue"] = default
        if self.shape.more_keys:
            keys |= {"LowLimit": "", "HighLimit": "", "ObjFlags": "0x0"}
        return keys | {"PDOMapping": "0"}
