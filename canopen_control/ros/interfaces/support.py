"""Type supports for rclpy and rmw_fastrtps, created at run time without a compiler.

rmw_fastrtps requests two supports of each type, fastrtps_c to serialise and introspection_c for its type object; both
have the same hash and description. Fast DDS calls their functions while it holds mutexes, so they must not run Python;
they are in `callbacks.c`, and this module makes the constants that they need. Data with another layout is dropped
there, as by compiled code: if it were refused later, rclpy would raise an exception in `spin`, and a foreign message
would end the process. rclpy itself calls the converters and the functions for service events, without any lock; they
never raise an exception, because C would use an undefined result: a failure is False or NULL and a line on standard
error.
"""

from __future__ import annotations

import ctypes
import importlib
import platform
import sys
from ctypes import (
    CFUNCTYPE,
    POINTER,
    PYFUNCTYPE,
    Structure,
    c_bool,
    c_char_p,
    c_int,
    c_int32,
    c_int64,
    c_size_t,
    c_uint,
    c_uint8,
    c_uint32,
    c_uint64,
    c_void_p,
    py_object,
)
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TypeVar

from canopen_control.ros.interfaces.cdr import size_of
from canopen_control.ros.interfaces.definition import (
    BOUNDED_STRING,
    NESTED,
    STRING,
    Shape,
    hash_of,
    parts_of,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.ros.interfaces.cdr import Codecs
    from canopen_control.ros.interfaces.definition import DescribedStructure, FieldType, Registry, TypeDescription


# ctypes structures of rosidl's type supports.
#
# Rules (rosidl_runtime_c, rosidl_typesupport_introspection_c, rosidl_typesupport_fastrtps_cpp of Jazzy): the order and
# sizes of the fields are those of the C headers; objects that are created here are never freed, because C keeps
# pointers to them. The fields of a type support in its C header are followed by the values that the functions of
# `callbacks.c` return for this support.


T = TypeVar("T")
_referenced: Final[list[object]] = []

SLOTS: Final = 512
"""Maximum number of message types in `callbacks.c`."""

CREATE = CFUNCTYPE(c_void_p)
DESTROY = CFUNCTYPE(None, c_void_p)
CONVERT_FROM_PY = PYFUNCTYPE(c_bool, py_object, c_void_p)
CONVERT_TO_PY = PYFUNCTYPE(c_void_p, c_void_p)


def keep(value: T) -> T:
    """Keep a reference to an object that C points to, and return the object."""
    _referenced.append(value)
    return value


def address(value: Any) -> int:  # noqa: ANN401 - any ctypes object
    """Return the address of a ctypes object, and keep a reference to it."""
    return ctypes.addressof(keep(value))


class Bytes(Structure):
    """C structure rosidl_runtime_c__String, which has the same layout as every rosidl sequence."""

    _fields_ = (("data", c_void_p), ("size", c_size_t), ("capacity", c_size_t))


class FieldTypeDescription(Structure):
    """C structure of type_description_interfaces/msg/FieldType."""

    _fields_ = (("type_id", c_uint8), ("capacity", c_uint64), ("string_capacity", c_uint64), ("nested", Bytes))


class FieldDescription(Structure):
    """C structure of type_description_interfaces/msg/Field."""

    _fields_ = (("name", Bytes), ("type", FieldTypeDescription), ("default_value", Bytes))


class IndividualDescription(Structure):
    """C structure of type_description_interfaces/msg/IndividualTypeDescription."""

    _fields_ = (("type_name", Bytes), ("fields", Bytes))


class TypeDescriptionStruct(Structure):
    """C structure of type_description_interfaces/msg/TypeDescription."""

    _fields_ = (("type_description", IndividualDescription), ("referenced", Bytes))


class TypeSource(Structure):
    """C structure of type_description_interfaces/msg/TypeSource."""

    _fields_ = (("type_name", Bytes), ("encoding", Bytes), ("raw", Bytes))


class Hash(Structure):
    """C structure rosidl_type_hash_t."""

    _fields_ = (("version", c_uint8), ("value", c_uint8 * 32))


def _pointers(*names: str) -> tuple[tuple[str, type[c_void_p]], ...]:
    return tuple((name, c_void_p) for name in names)


_HASHED: Final = _pointers("get_hash", "get_description", "get_sources", "hash", "description", "sources")
_KINDS: Final = ("kinds", c_void_p * 3)
_NAMED: Final = (("namespace", c_char_p), ("name", c_char_p))


class MessageSupport(Structure):
    """C structure rosidl_message_type_support_t."""

    _fields_ = (*_pointers("identifier", "data", "handle"), *_HASHED, _KINDS)


class ServiceSupport(Structure):
    """C structure rosidl_service_type_support_t."""

    _fields_ = (
        *_pointers("identifier", "data", "handle", "request", "response", "event", "make_event", "remove_event"),
        *_HASHED,
        _KINDS,
    )


class ActionSupport(Structure):
    """C structure rosidl_action_type_support_t; rcl_action reads this one without identifier and handle."""

    _fields_ = (*_pointers("send_goal", "get_result", "cancel", "feedback", "status"), *_HASHED)


class FastCallbacks(Structure):
    """C structure message_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (
        *_NAMED,
        *_pointers("serialize", "deserialize", "size", "max_size", "key_callbacks"),
    )


class FastService(Structure):
    """C structure service_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (*_NAMED, *_pointers("request", "response"))


class MessageMember(Structure):
    """C structure rosidl_typesupport_introspection_c__MessageMember; rmw_fastrtps does not use its functions."""

    _fields_ = (
        ("name", c_char_p),
        ("type_id", c_uint8),
        ("string_upper_bound", c_size_t),
        ("members", c_void_p),
        ("is_key", c_bool),
        ("is_array", c_bool),
        ("array_size", c_size_t),
        ("is_upper_bound", c_bool),
        ("offset", c_uint32),
        ("default_value", c_void_p),
        ("functions", c_void_p * 6),
    )


class Members(Structure):
    """C structure rosidl_typesupport_introspection_c__MessageMembers."""

    _fields_ = (
        *_NAMED,
        ("count", c_uint32),
        ("size_of", c_size_t),
        ("has_any_key", c_bool),
        *_pointers("members", "init", "fini"),
    )


class ServiceMembers(Structure):
    """C structure rosidl_typesupport_introspection_c__ServiceMembers."""

    _fields_ = (*_NAMED, *_pointers("request", "response", "event"))


class EventInfo(Structure):
    """C structure rosidl_service_introspection_info_t."""

    _fields_ = (
        ("event_type", c_uint8),
        ("sec", c_int32),
        ("nanosec", c_uint32),
        ("gid", c_uint8 * 16),
        ("sequence_number", c_int64),
    )


class LayoutField(Structure):
    """C structure `field` of `callbacks.c`."""

    _fields_ = (("kind", c_uint8), ("shape", c_uint8), ("size", c_uint8), ("count", c_uint32), ("nested", c_void_p))


class StructLayout(Structure):
    """C structure `layout` of `callbacks.c`."""

    _fields_ = (("count", c_size_t), ("fields", c_void_p))


class CallbackSettings(Structure):
    """C structure of the variable `settings` of `callbacks.c`."""

    _fields_ = (
        *_pointers("put", "position", "assign"),
        ("end_offset", c_size_t),
        ("layouts", c_void_p * SLOTS),
    )


MAKE_EVENT = CFUNCTYPE(c_void_p, POINTER(EventInfo), c_void_p, c_void_p, c_void_p)
REMOVE_EVENT = CFUNCTYPE(c_bool, c_void_p, c_void_p)


def string(text: str) -> Bytes:
    """Return a rosidl string in UTF-8; the memory is never freed."""
    buffer = ctypes.create_string_buffer(text.encode())
    return Bytes(address(buffer), len(buffer) - 1, len(buffer))


def sequence(kind: type[Structure], items: list[Any]) -> Bytes:
    """Return a rosidl sequence of structures of the type `kind`; the memory is never freed."""
    array = (kind * max(1, len(items)))(*items)
    return Bytes(address(array), len(items), len(items))


# Functions and names of ROS's C libraries that a type support created at run time uses.
#
# In C, a message of a created type is a `std_msgs/String` whose text is the CDR body; so upstream's own functions
# create, destroy and copy messages. Identifiers of type supports are compared by address, so those of the libraries are
# used. The offset of the end of the buffer in a Fast CDR object is found by creating an object and searching its
# memory. The functions that Fast DDS calls while it holds mutexes are in `callbacks.c`, compiled for each processor.


_CDR: Final = "_ZN8eprosima7fastcdr3Cdr"  # eprosima::fastcdr::Cdr
_BUFFER_MADE: Final = "_ZN8eprosima7fastcdr10FastBufferC1EPcm"
_CDR_MADE: Final = f"{_CDR}C1ERNS0_10FastBufferENS1_10EndiannessENS0_10CdrVersionE"
_PUT: Final = f"{_CDR}15serialize_arrayEPKcm"
_POSITION: Final = f"{_CDR}20get_current_positionEv"
_LITTLE_ENDIAN: Final = 1
_XCDR1: Final = 1


class Libraries:
    """Symbols of ROS's C libraries.

    Raise OSError, AttributeError or ValueError if a library or a symbol is missing; raise RuntimeError if this version
    of Fast CDR is not supported.
    """

    def __init__(self) -> None:
        self._folder = _library_folder()
        runtime, cdr = self._open("librosidl_runtime_c.so"), self._open("libfastcdr.so.2")
        strings = self._open("libstd_msgs__rosidl_generator_c.so")
        self.dispatch_id = self._identifier("rosidl_typesupport_c", "typesupport_identifier")
        self.fast_id = self._identifier("rosidl_typesupport_fastrtps_c", "identifier")
        self.introspection_id = self._identifier("rosidl_typesupport_introspection_c", "identifier")
        self.create = _symbol_address(strings.std_msgs__msg__String__create)
        self.destroy = _symbol_address(strings.std_msgs__msg__String__destroy)
        self._assign = _declared(runtime.rosidl_runtime_c__String__assignn, c_bool, c_void_p, c_char_p, c_size_t)
        position = _declared(cdr[_POSITION], c_void_p, c_void_p)
        self.callbacks = Callbacks(
            put=_symbol_address(cdr[_PUT]),
            position=_symbol_address(position),
            assign=_symbol_address(self._assign),
            end_offset=_find_end(cdr, position),
        )

    def set_body(self, message: int, body: bytes) -> bool:
        """Set the CDR body of the C message at this address; return False on failure."""
        return bool(self._assign(message, body, len(body)))

    def body_of(self, message: int) -> bytes:
        """Return the CDR body of the C message at this address."""
        body = Bytes.from_address(message)
        return ctypes.string_at(body.data, body.size) if body.size else b""

    def _open(self, name: str) -> ctypes.CDLL:
        try:
            return ctypes.CDLL(name)  # already loaded, or on the library path
        except OSError:
            return ctypes.CDLL(str(self._folder / name))

    def _identifier(self, package: str, symbol: str) -> int:
        return int(c_void_p.in_dll(self._open(f"lib{package}.so"), f"{package}__{symbol}").value or 0)


class Callbacks:
    """Functions of the compiled `callbacks.c`; raise OSError if no library exists for this processor."""

    def __init__(self, put: int, position: int, assign: int, end_offset: int) -> None:
        path = Path(__file__).with_name(f"callbacks_{platform.machine()}.so")
        if not path.exists():
            make = f"cc -O2 -shared -fPIC -o {path} {path.with_name('callbacks.c')}"
            raise OSError(f"{path.name} is missing for this processor; build it with: {make}")
        self._library = keep(ctypes.CDLL(str(path)))
        self._settings = keep(CallbackSettings.in_dll(self._library, "settings"))
        self._settings.put, self._settings.position, self._settings.assign = put, position, assign
        self._settings.end_offset = end_offset
        self._dropped = (c_uint32 * SLOTS).in_dll(self._library, "dropped")
        self._dropped_in_all = c_uint32.in_dll(self._library, "dropped_in_all")
        self._slot = _declared(self._library.slot, c_void_p, c_uint)
        self._names: list[str] = []
        self._reported, self._reported_in_all = [0] * SLOTS, 0

    def __getitem__(self, name: str) -> int:
        """Return the address of a function of `callbacks.c`."""
        return _symbol_address(self._library[name])

    def deserializer(self, name: str, layout: int) -> int:
        """Return the address of a deserialiser for a new message type; raise RuntimeError if all `SLOTS` are in use."""
        slot = len(self._names)
        if slot == SLOTS:
            raise RuntimeError(f"more than {SLOTS} types of messages in one process")
        self._names.append(name)
        self._settings.layouts[slot] = layout
        return int(self._slot(slot))

    def newly_dropped(self) -> list[str]:
        """Return the types of the messages that were dropped since the last call because of a wrong layout."""
        if self._dropped_in_all.value == self._reported_in_all:
            return []
        self._reported_in_all = self._dropped_in_all.value
        counts = list(self._dropped)
        names = [name for slot, name in enumerate(self._names) if counts[slot] != self._reported[slot]]
        self._reported = counts
        return names


def _library_folder() -> Path:
    """Return the folder of ROS's shared libraries, found from the location of rosidl_generator_py."""
    generator = importlib.import_module("rosidl_generator_py")
    return Path(str(generator.__file__)).resolve().parents[4] / "lib"


def _declared(function: Any, result: Any, *arguments: Any) -> Any:  # noqa: ANN401 - ctypes functions are
    function.restype, function.argtypes = result, arguments
    return function


def _symbol_address(function: Any) -> int:  # noqa: ANN401 - as above
    return int(ctypes.cast(function, c_void_p).value or 0)


def _find_end(cdr: ctypes.CDLL, position: Any) -> int:  # noqa: ANN401 - as above
    """Return the offset of the end pointer in a Fast CDR object; raise RuntimeError unless it occurs exactly once."""
    size, words = 16, 128
    raw = keep(ctypes.create_string_buffer(size))
    buffer, array = keep(ctypes.create_string_buffer(64)), keep(ctypes.create_string_buffer(words * 8))
    _declared(cdr[_BUFFER_MADE], None, c_void_p, c_void_p, c_size_t)(buffer, raw, size)
    _declared(cdr[_CDR_MADE], None, c_void_p, c_void_p, c_int, c_int)(array, buffer, _LITTLE_ENDIAN, _XCDR1)
    memory = list((c_size_t * words).from_buffer(array))
    end = ctypes.addressof(raw) + size
    if memory.count(end) != 1 or position(array) != ctypes.addressof(raw):
        raise RuntimeError("the memory layout of this Fast CDR version is not supported")
    return 8 * memory.index(end)


_GETTERS: Final = ("hash", "description", "sources")
_NUMBER, _TEXT, _NESTED = range(3)  # enum kind of `callbacks.c`
#: enum shape of `callbacks.c`; a bounded sequence is serialised like any other sequence
_LAYOUT_SHAPES: Final = {Shape.SCALAR: 0, Shape.ARRAY: 1, Shape.BOUNDED_SEQUENCE: 2, Shape.SEQUENCE: 2}
#: type ids in a type description -> type ids of rosidl_typesupport_introspection_c
_INTROSPECTION: Final = {10: 1, 11: 2, 15: 6, 16: 7, 3: 8, 2: 9, 5: 10, 4: 11, 7: 12, 6: 13, 9: 14, 8: 15,
                         17: 16, 21: 16, NESTED: 18}  # fmt: skip


class Capsules(NamedTuple):
    """Attributes of the metaclass of a message, each a PyCapsule with the address of a function or type support."""

    create: object
    destroy: object
    from_py: object
    to_py: object
    support: object


class _Message(NamedTuple):
    """Addresses of a message's type supports (dispatch, Fast CDR, introspection) and of its introspection members."""

    dispatch: int
    fast: int
    introspection: int
    members: int


class Supports:
    """Factory and cache of type supports for the structures in a registry."""

    def __init__(self, libraries: Libraries, registry: Registry, codecs: Codecs) -> None:
        self._libraries, self._registry, self._codecs = libraries, registry, codecs
        self._messages: dict[str, _Message] = {}
        self._members: dict[str, tuple[int, MessageSupport]] = {}
        self._layouts: dict[str, int] = {}

    def message(self, name: str) -> Capsules:
        """Return the capsules of a message; its type supports are created only once."""
        support = self._message(name)
        libraries, codecs = self._libraries, self._codecs

        def from_py(message: object, into: int) -> bool:
            try:
                return libraries.set_body(into, codecs.encode(name, message))
            except Exception as error:  # noqa: BLE001 - see the module's docstring
                _complain(name, error)
                return False

        def to_py(message: int) -> int | None:
            self._report_dropped()
            try:
                codec = codecs.decode(name, libraries.body_of(message))
            except Exception as error:  # noqa: BLE001 - see the module's docstring
                _complain(name, error)
                return None
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(codec))  # the caller owns this reference
            return id(codec)

        return Capsules(
            _capsule(libraries.create),
            _capsule(libraries.destroy),
            _capsule(_address_of(CONVERT_FROM_PY(from_py))),
            _capsule(_address_of(CONVERT_TO_PY(to_py))),
            _capsule(support.dispatch),
        )

    def service(self, name: str) -> object:
        """Create the type support of a service and return its capsule."""
        libraries, callbacks = self._libraries, self._libraries.callbacks
        parts = [self._message(f"{name}_{part}") for part in ("Request", "Response", "Event")]
        request, response, event = parts
        package, kind, short = parts_of(name)
        fast = FastService(f"{package}::{kind}".encode(), short.encode(), request.fast, response.fast)
        members = ServiceMembers(
            f"{package}__{kind}".encode(), short.encode(), request.members, response.members, event.members
        )
        events = self._event_functions(name)
        supports = [
            ServiceSupport(identifier, data, callbacks["service_of_kind"], *of_parts, *events)
            for identifier, data, of_parts in (
                (libraries.dispatch_id, None, [part.dispatch for part in parts]),
                (libraries.fast_id, address(fast), [part.fast for part in parts]),
                (libraries.introspection_id, address(members), [part.introspection for part in parts]),
            )
        ]
        return _capsule(self._described("service_support", name, supports)[0])

    def action(self, name: str, cancel: object, status: object) -> object:
        """Create the type support of an action and return its capsule."""
        send, get = (_pointer(self.service(f"{name}_{part}")) for part in ("SendGoal", "GetResult"))
        feedback = self._message(f"{name}_FeedbackMessage").dispatch
        support = ActionSupport(send, get, _pointer(cancel), feedback, _pointer(status))
        return _capsule(self._described("action_support", name, [support])[0])

    # ------------------------------------------------------------------------------------------------- messages

    def _message(self, name: str) -> _Message:
        if name not in self._messages:
            self._messages[name] = self._make_message(name)
        return self._messages[name]

    def _make_message(self, name: str) -> _Message:
        libraries, callbacks = self._libraries, self._libraries.callbacks
        package, kind, short = parts_of(name)
        functions = FastCallbacks(
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
            MessageSupport(libraries.dispatch_id, None, of_kind),
            MessageSupport(libraries.fast_id, address(functions), of_kind),
            introspection,
        ]
        dispatch, fast, introspected = self._described("message_support", name, supports)
        return _Message(dispatch, fast, introspected, members)

    def _introspection(self, name: str) -> tuple[int, MessageSupport]:
        """Return the address of a structure's members, and its introspection support."""
        if name not in self._members:
            package, kind, short = parts_of(name)
            fields = [self._member(field.name, field.type) for field in self._registry.get(name).fields]
            array = (MessageMember * max(1, len(fields)))(*fields)
            size = ctypes.sizeof(Bytes)
            members = address(
                Members(
                    f"{package}__{kind}".encode(), short.encode(), len(fields), size, False, address(array), None, None
                )
            )
            of_kind = self._libraries.callbacks["message_of_kind"]
            support = MessageSupport(self._libraries.introspection_id, members, of_kind)
            support.kinds[0] = address(support)
            self._members[name] = (members, support)
        return self._members[name]

    def _member(self, name: str, kind: FieldType) -> MessageMember:
        nested = address(self._introspection(kind.nested)[1]) if kind.nested else None
        many, bounded = kind.shape is not Shape.SCALAR, kind.shape is Shape.BOUNDED_SEQUENCE
        count = kind.capacity if bounded or kind.shape is Shape.ARRAY else 0
        return MessageMember(
            name.encode(), _INTROSPECTION[kind.base], kind.string_capacity, nested, False, many, count, bounded, 0, None
        )

    def _layout(self, name: str) -> int:
        """Return the address of the layout of a structure, with which `callbacks.c` checks received messages."""
        if name not in self._layouts:
            fields = [self._layout_field(field.type) for field in self._registry.get(name).fields]
            array = (LayoutField * max(1, len(fields)))(*fields)
            self._layouts[name] = address(StructLayout(len(fields), address(array)))
        return self._layouts[name]

    def _layout_field(self, kind: FieldType) -> LayoutField:
        shape = _LAYOUT_SHAPES[kind.shape]
        if kind.base == NESTED:
            return LayoutField(_NESTED, shape, 0, kind.capacity, self._layout(kind.nested))
        if kind.base in (STRING, BOUNDED_STRING):
            return LayoutField(_TEXT, shape, 0, kind.capacity)
        return LayoutField(_NUMBER, shape, size_of(kind.base), kind.capacity)

    def _report_dropped(self) -> None:
        for name in self._libraries.callbacks.newly_dropped():
            _complain(name, "dropped a message with another layout")

    # ---------------------------------------------------------------------------------------------- descriptions

    def _described(self, kind: str, name: str, supports: Sequence[Any]) -> list[int]:
        """Set the hash, description and sources in the type supports of an interface; return the supports' addresses.

        `kind` is the name of the structure of the supports in `callbacks.c`.
        """
        description = self._registry.describe(name)
        value = (ctypes.c_uint8 * 32)(*hash_of(description))
        descriptions = [description["type_description"], *description["referenced_type_descriptions"]]
        sources = [
            TypeSource(string(structure["type_name"]), string("implicit"), string("")) for structure in descriptions
        ]
        answers = (Hash(1, value), _c_description(description), sequence(TypeSource, sources))
        data = [address(answer) for answer in answers]
        addresses = [address(support) for support in supports]
        callbacks = self._libraries.callbacks
        for support in supports:
            support.get_hash, support.get_description, support.get_sources = (
                callbacks[f"{kind}_{getter}"] for getter in _GETTERS
            )
            support.hash, support.description, support.sources = data
            if len(addresses) > 1:
                support.kinds[:] = addresses
        return addresses

    # ----------------------------------------------------------------------------------------------- service events

    def _event_functions(self, name: str) -> tuple[Any, Any]:
        """Return the C functions that create and destroy service events; rcl crashes without them."""
        libraries, codecs = self._libraries, self._codecs
        create, destroy = CREATE(libraries.create), DESTROY(libraries.destroy)

        def make(info: Any, _allocator: int, request: int, response: int) -> int | None:  # noqa: ANN401 - a pointer
            try:
                event = _event_of(codecs, name, info.contents)
                for target, part in ((request, "Request"), (response, "Response")):
                    if target:
                        body = libraries.body_of(target)
                        setattr(event, part.lower(), [codecs.decode(f"{name}_{part}", body)])
                message = int(create())
                libraries.set_body(message, codecs.encode(f"{name}_Event", event))
            except Exception as error:  # noqa: BLE001 - see the module's docstring
                _complain(f"{name}_Event", error)
                return None
            return message

        def remove(message: int, _allocator: int) -> bool:
            if message:
                destroy(message)
            return bool(message)

        return _address_of(MAKE_EVENT(make)), _address_of(REMOVE_EVENT(remove))


def _event_of(codecs: Codecs, name: str, info: EventInfo) -> Any:  # noqa: ANN401 - an event message of that service
    event = codecs.class_of(f"{name}_Event")()
    event.info.event_type, event.info.sequence_number = info.event_type, info.sequence_number
    event.info.stamp.sec, event.info.stamp.nanosec = info.sec, info.nanosec
    event.info.client_gid = list(info.gid)
    return event


def _c_description(description: TypeDescription) -> TypeDescriptionStruct:
    referenced = [_c_individual(referenced_type) for referenced_type in description["referenced_type_descriptions"]]
    return TypeDescriptionStruct(
        _c_individual(description["type_description"]), sequence(IndividualDescription, referenced)
    )


def _c_individual(described: DescribedStructure) -> IndividualDescription:
    fields = []
    for field in described["fields"]:
        kind = field["type"]
        nested = string(kind["nested_type_name"])
        field_type = FieldTypeDescription(kind["type_id"], kind["capacity"], kind["string_capacity"], nested)
        fields.append(FieldDescription(string(field["name"]), field_type, string("")))
    return IndividualDescription(string(described["type_name"]), sequence(FieldDescription, fields))


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


def _complain(title: str, error: object) -> None:
    sys.stderr.write(f"canopen-control: {title}: {error}\n")
