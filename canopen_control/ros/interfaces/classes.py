"""Python classes of messages, services and actions, as rclpy expects them from rosidl_generator_py.

The metaclass has the type support, which is created when rclpy first requests it. A message has its fields as
attributes; None in the constructor means the default. Its slots are the field names with a leading underscore, in their
order, and `SLOT_TYPES` are their types as objects of rosidl_parser, which rosidl_runtime_py uses to print and fill
messages. A service class cannot be instantiated, only its Request and Response. An action class has Goal, Result and
Feedback, and in its Impl the types that rclpy.action sends. A field accepts any value; an unsuitable value is an error
on sending.
"""

from __future__ import annotations

import copy
import importlib
from array import array
from typing import TYPE_CHECKING, Any, ClassVar, Final

from canopen_control.ros.interfaces.cdr import NUMBERS
from canopen_control.ros.interfaces.definition import DUMMY, NESTED, FieldType, Shape, parts_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.ros.interfaces.definition import Structure
    from canopen_control.ros.interfaces.support import Supports


#: attributes that rclpy reads from a metaclass, in the order of `Capsules`
_CAPSULES: Final = (
    "_CREATE_ROS_MESSAGE",
    "_DESTROY_ROS_MESSAGE",
    "_CONVERT_FROM_PY",
    "_CONVERT_TO_PY",
    "_TYPE_SUPPORT",
)
_SUPPORT: Final = _CAPSULES[-1]
_IMPORT: Final = "__import_type_support__"
_TEXT: Final = {2: "int8", 3: "uint8", 4: "int16", 5: "uint16", 6: "int32", 7: "uint32", 8: "int64", 9: "uint64",
                10: "float", 11: "double", 15: "boolean", 16: "octet", 17: "string"}  # fmt: skip
_EMPTY: Final[dict[int, object]] = {10: 0.0, 11: 0.0, 15: False, 16: b"\0", 17: "", 21: ""}  # all other types: 0


class _SlotTypes:
    """Descriptor of `SLOT_TYPES`, which creates the value on first use because this needs rosidl_parser."""

    def __get__(self, _message: object, owner: type[MadeMessage]) -> tuple[object, ...]:
        types = tuple(_rosidl_type(kind) for kind in owner.__field_types__)
        type.__setattr__(owner, "SLOT_TYPES", types)
        return types


class MadeMessage:
    """Base class of all message classes created at run time."""

    __slots__ = ()
    __defaults__: ClassVar[dict[str, Callable[[], object]]] = {}
    _fields_and_field_types: ClassVar[dict[str, str]] = {}
    __field_types__: ClassVar[tuple[FieldType, ...]] = ()

    def __init__(self, **values: object) -> None:
        for name, default in self.__defaults__.items():
            value = values.pop(name, None)
            setattr(self, name, default() if value is None else value)
        values.pop("check_fields", None)
        if values:
            raise TypeError(f"{type(self).__name__} has no field {', '.join(values)}")

    @classmethod
    def get_fields_and_field_types(cls) -> dict[str, str]:
        """Return the names of the fields with their types in IDL notation."""
        return dict(cls._fields_and_field_types)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and all(
            _same(getattr(self, name), getattr(other, name)) for name in self.__defaults__
        )

    __hash__ = None  # type: ignore[assignment] # a message can be changed

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={_shown(getattr(self, name))}" for name in self.__defaults__)
        return f"{type(self).__module__}.{type(self).__name__}({fields})"


def message_class(structure: Structure, class_of: Callable[[str], type], supports: Callable[[], Supports]) -> type:
    """Create the class of a message.

    `class_of` returns the classes of nested messages, `supports` the factory of type supports.
    """
    package, kind, short = parts_of(structure.name)
    fields = [field for field in structure.fields if field.name != DUMMY]

    def load(metaclass: Any) -> None:  # noqa: ANN401 - the metaclass below
        for attribute, capsule in zip(_CAPSULES, supports().message(structure.name), strict=True):
            setattr(metaclass, attribute, capsule)

    contents = {
        "__slots__": tuple(f"_{field.name}" for field in fields),
        "SLOT_TYPES": _SlotTypes(),
        "__field_types__": tuple(field.type for field in fields),
        "__module__": f"{package}.{kind}",
        "__doc__": f"{structure.name}, created at run time.",
        "__defaults__": {field.name: _default_of(field.type, field.default, class_of) for field in fields},
        "_fields_and_field_types": {field.name: _text_of(field.type) for field in fields},
        **structure.constants,
    }
    new_class: type = _metaclass(short, load)(short, (MadeMessage,), contents)
    for field in fields:
        setattr(new_class, field.name, new_class.__dict__[f"_{field.name}"])  # the slot itself, without a property
    return new_class


def service_class(name: str, parts: dict[str, type], supports: Callable[[], Supports]) -> type:
    """Create the class of a service; `parts` are the classes Request, Response and Event."""
    package, kind, short = parts_of(name)

    def load(metaclass: Any) -> None:  # noqa: ANN401 - the metaclass below
        setattr(metaclass, _SUPPORT, supports().service(name))
        for part in parts.values():
            load_support = getattr(type(part), _IMPORT)
            load_support()

    contents = {**parts, "__module__": f"{package}.{kind}", "__doc__": f"{name}, created at run time."}
    new_class: type = _metaclass(short, load)(short, (), contents)
    return new_class


def action_class(
    name: str, class_of: Callable[[str], type], service_of: Callable[[str], type], supports: Callable[[], Supports]
) -> type:
    """Create the class of an action; `class_of` returns message classes, `service_of` service classes.

    The types for cancelling and for the status are common to all actions, and are installed.
    """
    package, kind, short = parts_of(name)
    carriers = {
        "SendGoalService": service_of(f"{name}_SendGoal"),
        "GetResultService": service_of(f"{name}_GetResult"),
        "FeedbackMessage": class_of(f"{name}_FeedbackMessage"),
        "CancelGoalService": class_of("action_msgs/srv/CancelGoal"),
        "GoalStatusMessage": class_of("action_msgs/msg/GoalStatusArray"),
    }

    def load(metaclass: Any) -> None:  # noqa: ANN401 - the metaclass below
        for part in carriers.values():  # rclpy requests only the type support of the action
            if getattr(type(part), _SUPPORT) is None:
                load_support = getattr(type(part), _IMPORT)
                load_support()
        installed = [getattr(type(carriers[kind]), _SUPPORT) for kind in ("CancelGoalService", "GoalStatusMessage")]
        setattr(metaclass, _SUPPORT, supports().action(name, *installed))

    contents = {
        **{word: class_of(f"{name}_{word}") for word in ("Goal", "Result", "Feedback")},
        "Impl": type("Impl", (), carriers),
        "__module__": f"{package}.{kind}",
        "__doc__": f"{name}, created at run time.",
    }
    new_class: type = _metaclass(short, load)(short, (), contents)
    return new_class


def _metaclass(short: str, load: Callable[[Any], None]) -> Any:  # noqa: ANN401 - a metaclass
    contents: dict[str, object] = dict.fromkeys(_CAPSULES)

    def import_type_support(metaclass: Any) -> None:  # noqa: ANN401 - this one
        if getattr(metaclass, _SUPPORT) is None:
            load(metaclass)

    contents[_IMPORT] = classmethod(import_type_support)
    return type(f"Metaclass_{short}", (type,), contents)


def _default_of(kind: FieldType, default: object, class_of: Callable[[str], type]) -> Callable[[], object]:
    if default is not None:
        return lambda: copy.copy(default)
    if kind.shape is Shape.SCALAR:
        return (lambda: class_of(kind.nested)()) if kind.base == NESTED else (lambda: _EMPTY.get(kind.base, 0))
    count = kind.capacity if kind.shape is Shape.ARRAY else 0
    if kind.base in NUMBERS:
        return lambda: array(NUMBERS[kind.base], bytes(array(NUMBERS[kind.base]).itemsize * count))
    element = _default_of(FieldType(kind.base, nested=kind.nested), None, class_of)
    return lambda: [element() for _ in range(count)]


def _text_of(kind: FieldType) -> str:
    package, _, short = kind.nested.partition("/msg/")
    bound = f"<{kind.string_capacity}>" if kind.string_capacity else ""
    text = f"{package}/{short}" if kind.base == NESTED else _TEXT.get(kind.base, "string") + bound
    shapes = {
        Shape.SCALAR: text,
        Shape.ARRAY: f"{text}[{kind.capacity}]",
        Shape.BOUNDED_SEQUENCE: f"sequence<{text}, {kind.capacity}>",
        Shape.SEQUENCE: f"sequence<{text}>",
    }
    return shapes[kind.shape]


def _rosidl_type(kind: FieldType) -> object:
    """Return a field's type as an object of rosidl_parser.definition."""
    parser = importlib.import_module("rosidl_parser.definition")
    if kind.shape is not Shape.SCALAR:
        element = _rosidl_type(FieldType(kind.base, string_capacity=kind.string_capacity, nested=kind.nested))
        if kind.shape is Shape.ARRAY:
            return parser.Array(element, kind.capacity)
        return parser.BoundedSequence(element, kind.capacity) if kind.capacity else parser.UnboundedSequence(element)
    if kind.base == NESTED:
        *namespaces, short = kind.nested.split("/")
        return parser.NamespacedType(namespaces, short)
    if kind.string_capacity:
        return parser.BoundedString(kind.string_capacity)
    text = _TEXT.get(kind.base, "string")
    return parser.UnboundedString() if text == "string" else parser.BasicType(text)


def _same(first: Any, second: Any) -> bool:  # noqa: ANN401 - any value of a field
    if isinstance(first, array | list | tuple) and isinstance(second, array | list | tuple):
        return list(first) == list(second)
    return bool(first == second)


def _shown(value: object) -> str:
    return repr(list(value)) if isinstance(value, array) else repr(value)
