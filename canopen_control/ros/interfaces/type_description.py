"""Type descriptions and their hashes: what two ROS programs compare before they talk.

The law of the file (REP 2011, rosidl's RIHS01): the hash is the SHA-256 of the description as JSON with ", " and ": "
as separators, without default values, the referenced types sorted by name, all of them, whatever refers to them.
Descriptions of installed packages come from the JSON files that they install.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, TypedDict

from canopen_control.ros.interfaces.definition import Field, FieldType, Structure, owner_of, parse, parts_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

__all__ = ["DescribedField", "DescribedFieldType", "DescribedStructure", "Description", "Registry", "hash_of",
           "hash_text"]  # fmt: skip


class DescribedFieldType(TypedDict):
    """type_description_interfaces/msg/FieldType."""

    type_id: int
    capacity: int
    string_capacity: int
    nested_type_name: str


class DescribedField(TypedDict):
    """type_description_interfaces/msg/Field, without its default value."""

    name: str
    type: DescribedFieldType


class DescribedStructure(TypedDict):
    """type_description_interfaces/msg/IndividualTypeDescription."""

    type_name: str
    fields: list[DescribedField]


class Description(TypedDict):
    """type_description_interfaces/msg/TypeDescription: dicts in this order, since they are hashed as JSON."""

    type_description: DescribedStructure
    referenced_type_descriptions: list[DescribedStructure]


class Registry:
    """Structures by full name: the ones that were added, and those of installed packages below `shares`."""

    def __init__(self, shares: Iterable[Path] = ()) -> None:
        self._shares = list(shares)
        self._structures: dict[str, Structure] = {}
        self._texts: dict[str, list[str]] = {}

    def add(self, definitions: Mapping[str, list[str]]) -> None:
        """Add interfaces by their texts, as {"package/msg/Name": lines}; they are read when they are asked for."""
        for name, lines in definitions.items():
            self._texts[name] = lines
            for known in [each for each in self._structures if owner_of(each) == name]:
                del self._structures[known]

    def get(self, name: str) -> Structure:
        """Return a structure; LookupError if nobody has it, neither a definition nor an installed package.

        ValueError names a bad line of a definition.
        """
        if name not in self._structures:
            owner = owner_of(name)
            if owner in self._texts:
                self._structures |= {each.name: each for each in parse(owner, self._texts[owner])}
            if name not in self._structures:
                self._load(name)
        return self._structures[name]

    def referenced(self, name: str) -> list[Structure]:
        """Return every structure that a structure is made of, itself not, sorted by name."""
        seen: set[str] = set()
        todo = [name]
        while todo:
            nested = {each.type.nested for each in self.get(todo.pop()).fields if each.type.nested}
            todo += nested - seen
            seen |= nested
        return [self.get(each) for each in sorted(seen)]

    def describe(self, name: str) -> Description:
        """Return the type description, as type_description_interfaces/msg/TypeDescription has it."""
        return {
            "type_description": _describe(self.get(name)),
            "referenced_type_descriptions": [_describe(each) for each in self.referenced(name)],
        }

    def _load(self, name: str) -> None:
        package, kind, short = parts_of(name)
        paths = [share / package / kind / f"{short}.json" for share in self._shares]
        found = next((path for path in paths if path.exists()), None)
        if found is None:
            raise LookupError(f"no description of {name}; is the package {package} installed?")
        described = json.loads(found.read_text(encoding="utf-8"))["type_description_msg"]
        for each in (described["type_description"], *described["referenced_type_descriptions"]):
            self._structures.setdefault(each["type_name"], _structure(each))


def hash_of(description: Description) -> bytes:
    """Return the 32 bytes of the RIHS01 hash."""
    return hashlib.sha256(json.dumps(description, separators=(", ", ": ")).encode()).digest()


def hash_text(description: Description) -> str:
    """Return the hash as `ros2 topic info -v` prints it."""
    return f"RIHS01_{hash_of(description).hex()}"


def _describe(structure: Structure) -> DescribedStructure:
    return {
        "type_name": structure.name,
        "fields": [
            {
                "name": each.name,
                "type": {
                    "type_id": each.type.type_id,
                    "capacity": each.type.capacity,
                    "string_capacity": each.type.string_capacity,
                    "nested_type_name": each.type.nested,
                },
            }
            for each in structure.fields
        ],
    }


def _structure(described: DescribedStructure) -> Structure:
    fields = []
    for each in described["fields"]:
        kind = each["type"]
        field_type = FieldType.of_id(
            kind["type_id"], kind["capacity"], kind["string_capacity"], kind["nested_type_name"]
        )
        fields.append(Field(each["name"], field_type))
    return Structure(described["type_name"], tuple(fields))
