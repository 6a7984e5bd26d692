"""Type supports made at run time: what rclpy and rmw_fastrtps need of an interface, without a compiler.

The law of the file: rmw_fastrtps asks each type for two supports, fastrtps_c to serialise and introspection_c for its
type object; both carry the same hash and description. No exception leaves a callback that C has called, since what C
would see then is garbage: a failure is False or NULL and a line on standard error. What comes is decoded while Fast DDS
still asks whether it can be: bytes of another layout are dropped there, as compiled code does it. Were it refused
later, rclpy would raise out of `spin`, and a stranger's message would end the process.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import c_char_p, c_void_p
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from canopen_control.ros.interfaces import abi
from canopen_control.ros.interfaces.abi import address, keep
from canopen_control.ros.interfaces.definition import NESTED, Shape, parts_of
from canopen_control.ros.interfaces.type_description import hash_of

if TYPE_CHECKING:
    from canopen_control.ros.interfaces.cdr import Codecs
    from canopen_control.ros.interfaces.definition import FieldType
    from canopen_control.ros.interfaces.libraries import Libraries
    from canopen_control.ros.interfaces.type_description import DescribedStructure, Description, Registry

__all__ = ["Capsules", "Supports"]

_MAX_SIZE: Final = 256  # no bound: Fast DDS grows the buffer
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


class _Judged(NamedTuple):
    """A message that was decoded when it came: where it is in C, its body then, and what it says."""

    address: int
    body: bytes
    made: object


class Supports:
    """Makes and keeps the type supports of the structures in a registry."""

    def __init__(self, libraries: Libraries, registry: Registry, codecs: Codecs) -> None:
        self._libraries, self._registry, self._codecs = libraries, registry, codecs
        self._messages: dict[str, _Message] = {}
        self._members: dict[str, tuple[int, int, abi.MessageSupport]] = {}
        self._judged: _Judged | None = None
        self._serialize = keep(abi.SERIALIZE(self._write))
        self._size = keep(abi.SIZE(lambda message: abi.Bytes.from_address(message).size))
        self._max_size = keep(abi.MAX_SIZE(_unbounded))

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
            try:
                made = self._decoded(name, message)
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
        libraries = self._libraries
        parts = [self._message(f"{name}_{part}") for part in ("Request", "Response", "Event")]
        request, response, event = parts
        package, kind, short = parts_of(name)
        fast = abi.FastService(f"{package}::{kind}".encode(), short.encode(), request.fast, response.fast)
        members = abi.ServiceMembers(
            f"{package}__{kind}".encode(), short.encode(), request.members, response.members, event.members
        )
        getters, events = self._getters(name), self._event_functions(name)
        of_kinds = {
            b"rosidl_typesupport_fastrtps_c": (libraries.fast_id, address(fast), [each.fast for each in parts]),
            b"rosidl_typesupport_introspection_c": (
                libraries.introspection_id, address(members), [each.introspection for each in parts],
            ),
            b"rosidl_typesupport_c": (libraries.dispatch_id, None, [each.dispatch for each in parts]),
        }  # fmt: skip
        table: dict[bytes, int] = {}
        handle = keep(abi.HANDLE(lambda _, wanted: table.get(wanted)))
        for wanted, (identifier, data, of_parts) in of_kinds.items():
            support = abi.ServiceSupport(identifier, data, handle, *of_parts, *events, *getters)
            table[wanted] = address(support)
        return _capsule(table[b"rosidl_typesupport_c"])

    def action(self, name: str, cancel: object, status: object) -> object:
        """Make the support of an action of its parts' and of the capsules of the installed ones; return its capsule."""
        send, get = (_pointer(self.service(f"{name}_{each}")) for each in ("SendGoal", "GetResult"))
        feedback = self._message(f"{name}_FeedbackMessage").dispatch
        parts = (send, get, _pointer(cancel), feedback, _pointer(status))
        return _capsule(address(abi.ActionSupport(*parts, *self._getters(name))))

    # ------------------------------------------------------------------------------------------------- messages

    def _message(self, name: str) -> _Message:
        if name not in self._messages:
            self._messages[name] = self._make_message(name)
        return self._messages[name]

    def _make_message(self, name: str) -> _Message:
        libraries, getters = self._libraries, self._getters(name)
        package, kind, short = parts_of(name)
        deserialize = keep(abi.DESERIALIZE(lambda cdr, message: self._read(name, cdr, message)))
        callbacks = abi.FastCallbacks(
            f"{package}::{kind}".encode(), short.encode(),
            self._serialize, deserialize, self._size, self._max_size, None,
        )  # fmt: skip
        members, introspected, introspection = self._introspection(name)
        table: dict[bytes, int] = {b"rosidl_typesupport_introspection_c": introspected}
        handle = keep(abi.HANDLE(lambda _, wanted: table.get(wanted)))
        introspection.get_hash, introspection.get_description, introspection.get_sources = getters
        fast = address(abi.MessageSupport(libraries.fast_id, address(callbacks), handle, *getters))
        dispatch = address(abi.MessageSupport(libraries.dispatch_id, None, handle, *getters))
        table[b"rosidl_typesupport_fastrtps_c"], table[b"rosidl_typesupport_c"] = fast, dispatch
        return _Message(dispatch, fast, introspected, members)

    def _introspection(self, name: str) -> tuple[int, int, abi.MessageSupport]:
        """Return where the members and the introspection support of a structure are, and that support."""
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
            support = abi.MessageSupport(self._libraries.introspection_id, members)
            where = address(support)
            wanted = b"rosidl_typesupport_introspection_c"
            support.handle = keep(abi.HANDLE(lambda _, asked: where if asked == wanted else None))
            self._members[name] = (members, where, support)
        return self._members[name]

    def _member(self, name: str, kind: FieldType) -> abi.Member:
        nested = self._introspection(kind.nested)[1] if kind.nested else None
        many, bounded = kind.shape is not Shape.SCALAR, kind.shape is Shape.BOUNDED_SEQUENCE
        count = kind.capacity if bounded or kind.shape is Shape.ARRAY else 0
        return abi.Member(
            name.encode(), _INTROSPECTION[kind.base], kind.string_capacity, nested, False, many, count, bounded, 0, None
        )

    def _write(self, message: int, cdr: int) -> bool:
        try:
            self._libraries.write(message, cdr)
        except Exception as error:  # noqa: BLE001 - see the law of the file
            _complain("serialize", error)
            return False
        return True

    def _read(self, name: str, cdr: int, message: int) -> bool:
        """Take what has come into a message; False, and it is dropped, if it is none of this type."""
        libraries = self._libraries
        try:
            if not libraries.read(cdr, message):
                return False
            body = libraries.body_of(message)
            self._judged = _Judged(message, body, self._codecs.decode(name, body))
        except Exception as error:  # noqa: BLE001 - see the law of the file
            _complain(f"{name}: dropped a message of another layout", error)
            return False
        return True

    def _decoded(self, name: str, message: int) -> object:
        """Return what a message in C says; it is the one that was judged last, unless somebody came between."""
        body = self._libraries.body_of(message)
        judged, self._judged = self._judged, None
        if judged is not None and judged.address == message and judged.body == body:
            return judged.made
        made: object = self._codecs.decode(name, body)
        return made

    # ---------------------------------------------------------------------------------------------- descriptions

    def _getters(self, name: str) -> tuple[Any, Any, Any]:
        """Return the functions that tell hash, description and sources of a structure."""
        description = self._registry.describe(name)
        value = (ctypes.c_uint8 * 32)(*hash_of(description))
        told = [description["type_description"], *description["referenced_type_descriptions"]]
        sources = [abi.Source(abi.string(each["type_name"]), abi.string("implicit"), abi.string("")) for each in told]
        answers = (abi.Hash(1, value), _c_description(description), abi.sequence(abi.Source, sources))
        one, two, three = (_getter(address(each)) for each in answers)
        return one, two, three

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


def _unbounded(flags: int) -> int:
    ctypes.c_char.from_address(flags).value = b"\0"  # the first flag: the size is bounded
    return _MAX_SIZE


def _getter(where: int) -> Any:  # noqa: ANN401 - a ctypes function
    return keep(abi.GET(lambda _: where))


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


def _complain(what: str, error: Exception) -> None:
    sys.stderr.write(f"canopen-control: {what}: {error}\n")
