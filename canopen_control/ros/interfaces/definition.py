"""Structures of .msg, .srv and .action files and their descriptions, for interfaces created at run time.

Rules (rosidl): a line is `type name [default]` or `type NAME=value`; `---` separates the parts of a service or action;
`Header` is std_msgs/msg/Header, and a type without a package belongs to the same package. An empty structure has one
byte in CDR. A service consists of three messages (request, response, event) and a structure of these three. An action
consists of three messages (goal, result, feedback), two services and a message that transfer them with the goal's id,
and a structure of all six.
"""

from __future__ import annotations

import enum
import hashlib
import json
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypedDict

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping


DEFINITIONS: Final[dict[str, list[str]]] = json.loads(
    Path(__file__).with_name("definitions.json").read_text(encoding="utf-8")
)
"""Lines of the definitions of all interfaces that can be created, by full name."""
DUMMY: Final = "structure_needs_at_least_one_member"
"""Field of an empty structure: one byte in CDR, no attribute in Python."""
NESTED: Final = 1
STRING: Final = 17
BOUNDED_STRING: Final = 21
_SHAPE_STEP: Final = 48  # difference of the type ids of a scalar and of its arrays and sequences

#: type ids of type_description_interfaces/msg/FieldType
PRIMITIVES: Final = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8, "uint64": 9,
    "float32": 10, "float64": 11, "bool": 15, "byte": 16, "char": 3, "string": STRING,
}  # fmt: skip
_LINE: Final = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=(?P<string>\d+))?(?P<array>\[(?P<bounded><=)?(?P<count>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)


class Shape(enum.IntEnum):
    """Kind of a field: a scalar, an array, or a sequence with or without an upper bound."""

    SCALAR = 0
    ARRAY = 1
    BOUNDED_SEQUENCE = 2
    SEQUENCE = 3


@dataclass(frozen=True, slots=True)
class FieldType:
    """Type of a field: `base` is the type id of the scalar, `nested` the full name of a structure, else ""."""

    base: int
    shape: Shape = Shape.SCALAR
    capacity: int = 0
    string_capacity: int = 0
    nested: str = ""

    @property
    def type_id(self) -> int:
        """Id of this type in type_description_interfaces."""
        return self.base + _SHAPE_STEP * self.shape

    @classmethod
    def of_id(cls, type_id: int, capacity: int, string_capacity: int, nested: str) -> FieldType:
        """Return the field type for an id of type_description_interfaces."""
        shape = (type_id - 1) // _SHAPE_STEP
        return cls(type_id - _SHAPE_STEP * shape, Shape(shape), capacity, string_capacity, nested)


@dataclass(frozen=True, slots=True)
class Field:
    """Field of a structure; a `default` of None means zero, an empty value or false."""

    name: str
    type: FieldType
    default: object = None


@dataclass(frozen=True, slots=True)
class Structure:
    """Message, or the structure that describes a service or an action; `name` is "package/msg/Name"."""

    name: str
    fields: tuple[Field, ...]
    constants: dict[str, object] = field(default_factory=dict)


def parts_of(name: str) -> tuple[str, str, str]:
    """Split a full name into package, kind ("msg", "srv" or "action") and short name."""
    package, kind, short = name.split("/")
    return package, kind, short


def owner_of(name: str) -> str:
    """Return the interface that a structure belongs to: the full name up to the first "_" of its last part."""
    package, kind, short = parts_of(name)
    return f"{package}/{kind}/{short.partition('_')[0]}"


def parse(name: str, lines: list[str]) -> list[Structure]:
    """Return the structures of an interface: one for a message, four for a service, thirteen for an action.

    Raise ValueError with the reason if a line is invalid or the number of parts is wrong.
    """
    package, kind, _ = parts_of(name)
    if kind == "msg":
        return [_structure(name, package, lines)]
    words = ("Request", "Response") if kind == "srv" else ("Goal", "Result", "Feedback")
    texts = _split(lines)
    if len(texts) != len(words):
        raise ValueError(f"{name}: it has {len(texts)} parts separated by ---, not {len(words)}")
    parts = [_structure(f"{name}_{word}", package, text) for word, text in zip(words, texts, strict=True)]
    return _service(name, *parts) if kind == "srv" else _action(name, *parts)


def _split(lines: list[str]) -> list[list[str]]:
    texts: list[list[str]] = [[]]
    for line in lines:
        if line.strip() == "---":
            texts.append([])
        else:
            texts[-1].append(line)
    return texts


def _service(name: str, request: Structure, response: Structure) -> list[Structure]:
    event = (
        _nested("info", "service_msgs/msg/ServiceEventInfo"),
        Field("request", FieldType(NESTED, Shape.BOUNDED_SEQUENCE, 1, nested=request.name)),
        Field("response", FieldType(NESTED, Shape.BOUNDED_SEQUENCE, 1, nested=response.name)),
    )
    parts = ("request", "response", "event")
    service = tuple(_nested(f"{part}_message", f"{name}_{part.capitalize()}") for part in parts)
    return [request, response, Structure(f"{name}_Event", event), Structure(name, service)]


def _action(name: str, goal: Structure, result: Structure, feedback: Structure) -> list[Structure]:
    goal_id = _nested("goal_id", "unique_identifier_msgs/msg/UUID")
    send, get, feedback_message = f"{name}_SendGoal", f"{name}_GetResult", f"{name}_FeedbackMessage"
    accepted = (Field("accepted", FieldType(PRIMITIVES["bool"])), _nested("stamp", "builtin_interfaces/msg/Time"))
    ended = (Field("status", FieldType(PRIMITIVES["int8"])), _nested("result", result.name))
    parts = {"goal": goal.name, "result": result.name, "feedback": feedback.name,
             "send_goal_service": send, "get_result_service": get, "feedback_message": feedback_message}  # fmt: skip
    return [
        goal,
        result,
        feedback,
        *_service(
            send,
            Structure(f"{send}_Request", (goal_id, _nested("goal", goal.name))),
            Structure(f"{send}_Response", accepted),
        ),
        *_service(get, Structure(f"{get}_Request", (goal_id,)), Structure(f"{get}_Response", ended)),
        Structure(feedback_message, (goal_id, _nested("feedback", feedback.name))),
        Structure(name, tuple(_nested(field, nested) for field, nested in parts.items())),
    ]


def _nested(field: str, name: str) -> Field:
    return Field(field, FieldType(NESTED, nested=name))


def _structure(name: str, package: str, lines: list[str]) -> Structure:
    fields: list[Field] = []
    constants: dict[str, object] = {}
    for line in lines:
        text = _without_comment(line).strip()
        if not text:
            continue
        match = _LINE.fullmatch(text)
        if match is None:
            raise ValueError(f"{name}: cannot read the line {line!r}")
        rest = match["rest"].strip()
        if rest.startswith("="):
            constants[match["name"]] = _value(rest[1:], match["type"])
        else:
            default = _default(rest, match["type"], is_array=match["array"] is not None)
            fields.append(Field(match["name"], _type_of(match, package), default))
    return Structure(name, tuple(fields) or (Field(DUMMY, FieldType(PRIMITIVES["uint8"])),), constants)


def _type_of(match: re.Match[str], package: str) -> FieldType:
    shape = Shape.SCALAR
    if match["array"] is not None:
        sized = Shape.BOUNDED_SEQUENCE if match["bounded"] else Shape.ARRAY
        shape = sized if match["count"] else Shape.SEQUENCE
    base, nested = PRIMITIVES.get(match["type"]), ""
    if base is None:
        if match["type"] == "wstring":
            raise ValueError("wstring is not supported; use string")
        base, nested = NESTED, _full_name(match["type"], package)
    if match["string"]:
        base = BOUNDED_STRING
    return FieldType(base, shape, int(match["count"] or 0), int(match["string"] or 0), nested)


def _full_name(text: str, package: str) -> str:
    if text == "Header":
        return "std_msgs/msg/Header"
    *before, short = text.split("/")
    return f"{before[0] if before else package}/msg/{short}"


def _without_comment(line: str) -> str:
    quote = ""
    for index, letter in enumerate(line):
        if quote:
            quote = "" if letter == quote and line[index - 1] != "\\" else quote
        elif letter in "\"'":
            quote = letter
        elif letter == "#":
            return line[:index]
    return line


def _default(text: str, kind: str, *, is_array: bool) -> object:
    if not text:
        return None
    if is_array:
        return [_value(item, kind) for item in text.strip("[]").split(",") if item.strip()]
    return _value(text, kind)


def _value(text: str, kind: str) -> object:
    text = text.strip()
    if kind == "string":
        quoted = len(text) > 1 and text[0] in "\"'" and text[0] == text[-1]
        return text[1:-1] if quoted else text
    if kind == "bool":
        return text.lower() in ("true", "1")
    return float(text) if kind.startswith("float") else int(text, 0)


# Type descriptions and their hashes, which two ROS programs compare before they communicate.
#
# Rules (REP 2011, rosidl's RIHS01): the hash is the SHA-256 of the description as JSON with the separators ", " and ":
# ", without default values, with all directly and indirectly referenced types sorted by name. Descriptions of installed
# packages are read from the JSON files that these packages install.


class DescribedFieldType(TypedDict):
    """Fields of type_description_interfaces/msg/FieldType."""

    type_id: int
    capacity: int
    string_capacity: int
    nested_type_name: str


class DescribedField(TypedDict):
    """Fields of type_description_interfaces/msg/Field, without the default value."""

    name: str
    type: DescribedFieldType


class DescribedStructure(TypedDict):
    """Fields of type_description_interfaces/msg/IndividualTypeDescription."""

    type_name: str
    fields: list[DescribedField]


class TypeDescription(TypedDict):
    """Fields of type_description_interfaces/msg/TypeDescription; their order matters for the hash of the JSON."""

    type_description: DescribedStructure
    referenced_type_descriptions: list[DescribedStructure]


class Registry:
    """Structures by full name, from added definitions and from the packages installed in the folders `shares`."""

    def __init__(self, shares: Iterable[Path] = ()) -> None:
        self._shares = list(shares)
        self._structures: dict[str, Structure] = {}
        self._texts: dict[str, list[str]] = {}

    def add(self, definitions: Mapping[str, list[str]]) -> None:
        """Add interfaces as {"package/msg/Name": lines of the definition}, parsed on first use."""
        for name, lines in definitions.items():
            self._texts[name] = lines
            for structure_name in [structure for structure in self._structures if owner_of(structure) == name]:
                del self._structures[structure_name]

    def get(self, name: str) -> Structure:
        """Return a structure by full name; raise LookupError if neither a definition nor an installed package has it.

        Raise ValueError with the reason if the definition is invalid.
        """
        if name not in self._structures:
            owner = owner_of(name)
            if owner in self._texts:
                self._structures |= {structure.name: structure for structure in parse(owner, self._texts[owner])}
            if name not in self._structures:
                self._load(name)
        return self._structures[name]

    def referenced(self, name: str) -> list[Structure]:
        """Return all structures that are nested in a structure, directly or indirectly, sorted by name."""
        names: set[str] = set()
        todo = [name]
        while todo:
            nested = {field.type.nested for field in self.get(todo.pop()).fields if field.type.nested}
            todo += nested - names
            names |= nested
        return [self.get(dependency) for dependency in sorted(names)]

    def describe(self, name: str) -> TypeDescription:
        """Return the type description of a structure and all nested structures."""
        return {
            "type_description": _describe(self.get(name)),
            "referenced_type_descriptions": [_describe(structure) for structure in self.referenced(name)],
        }

    def _load(self, name: str) -> None:
        package, kind, short = parts_of(name)
        paths = [share / package / kind / f"{short}.json" for share in self._shares]
        path_found = next((path for path in paths if path.exists()), None)
        if path_found is None:
            raise LookupError(f"no type description of {name}; install the package {package}")
        described = json.loads(path_found.read_text(encoding="utf-8"))["type_description_msg"]
        for structure in (described["type_description"], *described["referenced_type_descriptions"]):
            self._structures.setdefault(structure["type_name"], _structure_of(structure))


def hash_of(description: TypeDescription) -> bytes:
    """Return the 32 bytes of the RIHS01 hash of a type description."""
    return hashlib.sha256(json.dumps(description, separators=(", ", ": ")).encode()).digest()


def hash_text(description: TypeDescription) -> str:
    """Return the hash of a type description as printed by `ros2 topic info -v`."""
    return f"RIHS01_{hash_of(description).hex()}"


def _describe(structure: Structure) -> DescribedStructure:
    return {
        "type_name": structure.name,
        "fields": [
            {
                "name": field.name,
                "type": {
                    "type_id": field.type.type_id,
                    "capacity": field.type.capacity,
                    "string_capacity": field.type.string_capacity,
                    "nested_type_name": field.type.nested,
                },
            }
            for field in structure.fields
        ],
    }


def _structure_of(described: DescribedStructure) -> Structure:
    fields = []
    for described_field in described["fields"]:
        kind = described_field["type"]
        field_type = FieldType.of_id(
            kind["type_id"], kind["capacity"], kind["string_capacity"], kind["nested_type_name"]
        )
        fields.append(Field(described_field["name"], field_type))
    return Structure(described["type_name"], tuple(fields))
