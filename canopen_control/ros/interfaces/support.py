"""Type supports made at run time: what rclpy and rmw_fastrtps need of an interface, without a compiler.

The law of the file: rmw_fastrtps asks each type for two supports, fastrtps_c to serialise and introspection_c for its
type object; both carry the same hash and description. Fast DDS calls their functions while it holds its mutexes, so
that no Python runs there: the functions are those of `callbacks.c`, here are the constants that they need. Bytes of
another layout are dropped there, as compiled code does it: were they refused later, rclpy would raise out of `spin`,
and a stranger's message would end the process. rclpy itself calls the converters and what makes service events, outside
of all locks; no exception leaves one, since what C would see then is garbage: a failure is False or NULL and a line on
standard error.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import c_char_p, c_void_p
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.ros.interfaces import abi
from canopen_control.ros.interfaces.abi import address, keep
from canopen_control.ros.interfaces.cdr import size_of
from canopen_control.ros.interfaces.definition import BOUNDED_STRING, NESTED, STRING, Shape, parts_of
from canopen_control.ros.interfaces.type_description import hash_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.interfaces.cdr import Codecs
    from canopen_control.ros.interfaces.definition import FieldType
    from canopen_control.ros.interfaces.libraries import Libraries
    from canopen_control.ros.interfaces.type_description import DescribedStructure, Description, Registry

__all__ = ["Capsules", "Supports"]

_GETTERS: Final = ("hash", "description", "sources")
_NUMBER, _TEXT, _NESTED = range(3)  # enum kind of `callbacks.c`
#: enum shape of `callbacks.c`: a bounded sequence looks like any other on the wire
_LAYOUT_SHAPES: Final = {Shape.SCALAR: 0, Shape.ARRAY: 1, Shape.BOUNDED_SEQUENCE: 2, Shape.SEQUENCE: 2}
#: type ids of a description to those of rosidl_typesupport_introspection_c
_INTROSPECTION: Final = {10: 1, 11: 2, 15: 6, 16: 7, 3: 8, 2: 9, 5: 10, 4: 11, 7: 12, 6: 13, 9: 14, 8: 15,
                         17: 16, 21: 16, NESTED: 18}  # fmt: skip


class Capsules(NamedTuple):
    """What the metaclass of a message holds."""

    create: object
    destroy: object
    from_py: object
    to_py: object
    support: object


class _Message(NamedTuple):
    """Where the supports of a message are: for dispatching, for Fast CDR, for introspection and its members."""

    dispatch: int
    fast: int
    introspection: int
    members: int


class Supports:
    """Makes and keeps the type supports of the structures in a registry."""

    def __init__(self, libraries: Libraries, registry: Registry, codecs: Codecs) -> None:
        self._libraries, self._registry, self._codecs = libraries, registry, codecs
        self._messages: dict[str, _Message] = {}
        self._members: dict[str, tuple[int, abi.MessageSupport]] = {}
        self._layouts: dict[str, int] = {}

    def message(self, name: str) -> Capsules:
        """Make the supports of a message; once for each name."""
        support = self._message(name)
        libraries, codecs = self._libraries, self._codecs

        def from_py(message: object, into: int) -> bool:
            try:
                return libraries.set_body(into, codecs.encode(name, message))
            except Exception as error:  # noqa: BLE001 - see the law of the file
                _complain(name, error)
                return False

        def to_py(message: int) -> int | None:
            self._tell_dropped()
            try:
                made = codecs.decode(name, libraries.body_of(message))
            except Exception as error:  # noqa: BLE001 - see the law of the file
                _complain(name, error)
                return None
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(made))  # the caller takes the reference over
            return id(made)

        return Capsules(
            _capsule(libraries.create),
            _capsule(libraries.destroy),
            _capsule(_address_of(abi.CONVERT_FROM_PY(from_py))),
            _capsule(_address_of(abi.CONVERT_TO_PY(to_py))),
            _capsule(support.dispatch),
        )

    def service(self, name: str) -> object:
        """Make the support of a service, and return its capsule."""
        libraries, callbacks = self._libraries, self._libraries.callbacks
        parts = [self._message(f"{name}_{part}") for part in ("Request", "Response", "Event")]
        request, response, event = parts
        package, kind, short = parts_of(name)
        fast = abi.FastService(f"{package}::{kind}".encode(), short.encode(), request.fast, response.fast)
        members = abi.ServiceMembers(
            f"{package}__{kind}".encode(), short.encode(), request.members, response.members, event.members
        )
        events = self._event_functions(name)
        supports = [
            abi.ServiceSupport(identifier, data, callbacks["service_of_kind"], *of_parts, *events)
            for identifier, data, of_parts in (
                (libraries.dispatch_id, None, [each.dispatch for each in parts]),
                (libraries.fast_id, address(fast), [each.fast for each in parts]),
                (libraries.introspection_id, address(members), [each.introspection for each in parts]),
            )
        ]
        return _capsule(self._described("service_support", name, supports)[0])

    def action(self, name: str, cancel: object, status: object) -> object:
        """Make the support of an action of its parts' and of the capsules of the installed ones; return its capsule."""
        send, get = (_pointer(self.service(f"{name}_{each}")) for each in ("SendGoal", "GetResult"))
        feedback = self._message(f"{name}_FeedbackMessage").dispatch
        support = abi.ActionSupport(send, get, _pointer(cancel), feedback, _pointer(status))
        return _capsule(self._described("action_support", name, [support])[0])

    # ------------------------------------------------------------------------------------------------- messages

    def _message(self, name: str) -> _Message:
        if name not in self._messages:
            self._messages[name] = self._make_message(name)
        return self._messages[name]

    def _make_message(self, name: str) -> _Message:
        libraries, callbacks = self._libraries, self._libraries.callbacks
        package, kind, short = parts_of(name)
        functions = abi.FastCallbacks(
            f"{package}::{kind}".encode(),
            short.encode(),
            callbacks["serialize"],
            callbacks.deserializer(name, self._layout(name)),
            callbacks["serialized_size"],
            callbacks["max_serialized_size"],
            None,
        )
        members, introspection = self._introspection(name)
        of_kind = callbacks["message_of_kind"]
        supports = [
            abi.MessageSupport(libraries.dispatch_id, None, of_kind),
            abi.MessageSupport(libraries.fast_id, address(functions), of_kind),
            introspection,
        ]
        dispatch, fast, introspected = self._described("message_support", name, supports)
        return _Message(dispatch, fast, introspected, members)

    def _introspection(self, name: str) -> tuple[int, abi.MessageSupport]:
        """Return where the members of a structure are, and its introspection support."""
        if name not in self._members:
            package, kind, short = parts_of(name)
            fields = [self._member(each.name, each.type) for each in self._registry.get(name).fields]
            array = (abi.Member * max(1, len(fields)))(*fields)
            size = ctypes.sizeof(abi.Bytes)
            members = address(
                abi.Members(
                    f"{package}__{kind}".encode(), short.encode(), len(fields), size, False, address(array), None, None
                )
            )
            of_kind = self._libraries.callbacks["message_of_kind"]
            support = abi.MessageSupport(self._libraries.introspection_id, members, of_kind)
            support.kinds[0] = address(support)
            self._members[name] = (members, support)
        return self._members[name]

    def _member(self, name: str, kind: FieldType) -> abi.Member:
        nested = address(self._introspection(kind.nested)[1]) if kind.nested else None
        many, bounded = kind.shape is not Shape.SCALAR, kind.shape is Shape.BOUNDED_SEQUENCE
        count = kind.capacity if bounded or kind.shape is Shape.ARRAY else 0
        return abi.Member(
            name.encode(), _INTROSPECTION[kind.base], kind.string_capacity, nested, False, many, count, bounded, 0, None
        )

    def _layout(self, name: str) -> int:
        """Return where the layout of a structure is, by which `callbacks.c` judges what comes."""
        if name not in self._layouts:
            fields = [self._layout_field(each.type) for each in self._registry.get(name).fields]
            array = (abi.LayoutField * max(1, len(fields)))(*fields)
            self._layouts[name] = address(abi.Layout(len(fields), address(array)))
        return self._layouts[name]

    def _layout_field(self, kind: FieldType) -> abi.LayoutField:
        shape = _LAYOUT_SHAPES[kind.shape]
        if kind.base == NESTED:
            return abi.LayoutField(_NESTED, shape, 0, kind.capacity, self._layout(kind.nested))
        if kind.base in (STRING, BOUNDED_STRING):
            return abi.LayoutField(_TEXT, shape, 0, kind.capacity)
        return abi.LayoutField(_NUMBER, shape, size_of(kind.base), kind.capacity)

    def _tell_dropped(self) -> None:
        for name in self._libraries.callbacks.newly_dropped():
            _complain(name, "dropped a message of another layout")

    # ---------------------------------------------------------------------------------------------- descriptions

    def _described(self, kind: str, name: str, supports: Sequence[Any]) -> list[int]:
        """Let the supports of an interface tell its hash, description, sources and one another; return where they are.

        `kind` is the structure in `callbacks.c` that they are.
        """
        description = self._registry.describe(name)
        value = (ctypes.c_uint8 * 32)(*hash_of(description))
        told = [description["type_description"], *description["referenced_type_descriptions"]]
        sources = [abi.Source(abi.string(each["type_name"]), abi.string("implicit"), abi.string("")) for each in told]
        answers = (abi.Hash(1, value), _c_description(description), abi.sequence(abi.Source, sources))
        data = [address(each) for each in answers]
        where = [address(each) for each in supports]
        callbacks = self._libraries.callbacks
        for each in supports:
            each.get_hash, each.get_description, each.get_sources = (callbacks[f"{kind}_{what}"] for what in _GETTERS)
            each.hash, each.description, each.sources = data
            if len(where) > 1:
                each.kinds[:] = where
        return where

    # ----------------------------------------------------------------------------------------------- service events

    def _event_functions(self, name: str) -> tuple[Any, Any]:
        """Return the functions that make and remove the event of a service; without them its introspection crashes."""
        libraries, codecs = self._libraries, self._codecs
        create, destroy = abi.CREATE(libraries.create), abi.DESTROY(libraries.destroy)

        def make(info: Any, _allocator: int, request: int, response: int) -> int | None:  # noqa: ANN401 - a pointer
            try:
                event = _event_of(codecs, name, info.contents)
                for where, part in ((request, "Request"), (response, "Response")):
                    if where:
                        body = libraries.body_of(where)
                        setattr(event, part.lower(), [codecs.decode(f"{name}_{part}", body)])
                message = int(create())
                libraries.set_body(message, codecs.encode(f"{name}_Event", event))
            except Exception as error:  # noqa: BLE001 - see the law of the file
                _complain(f"{name}_Event", error)
                return None
            return message

        def remove(message: int, _allocator: int) -> bool:
            if message:
                destroy(message)
            return bool(message)

        return _address_of(abi.MAKE_EVENT(make)), _address_of(abi.REMOVE_EVENT(remove))


def _event_of(codecs: Codecs, name: str, info: abi.EventInfo) -> Any:  # noqa: ANN401 - an event message of that service
    event = codecs.class_of(f"{name}_Event")()
    event.info.event_type, event.info.sequence_number = info.event_type, info.sequence_number
    event.info.stamp.sec, event.info.stamp.nanosec = info.sec, info.nanosec
    event.info.client_gid = list(info.gid)
    return event


def _c_description(description: Description) -> abi.TypeDescription:
    referenced = [_c_individual(each) for each in description["referenced_type_descriptions"]]
    return abi.TypeDescription(
        _c_individual(description["type_description"]), abi.sequence(abi.IndividualDescription, referenced)
    )


def _c_individual(described: DescribedStructure) -> abi.IndividualDescription:
    fields = []
    for each in described["fields"]:
        kind = each["type"]
        nested = abi.string(kind["nested_type_name"])
        told = abi.FieldTypeDescription(kind["type_id"], kind["capacity"], kind["string_capacity"], nested)
        fields.append(abi.FieldDescription(abi.string(each["name"]), told, abi.string("")))
    return abi.IndividualDescription(abi.string(described["type_name"]), abi.sequence(abi.FieldDescription, fields))


def _capsule(pointer: int) -> object:
    new = ctypes.pythonapi.PyCapsule_New
    new.argtypes, new.restype = [c_void_p, c_char_p, c_void_p], ctypes.py_object
    capsule: object = new(pointer, None, None)
    return capsule


def _pointer(capsule: object) -> int:
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.argtypes, get.restype = [ctypes.py_object, c_char_p], c_void_p
    return int(get(capsule, None) or 0)


def _address_of(function: Any) -> int:  # noqa: ANN401 - a ctypes function
    return int(ctypes.cast(keep(function), c_void_p).value or 0)


def _complain(what: str, error: object) -> None:
    sys.stderr.write(f"canopen-control: {what}: {error}\n")
