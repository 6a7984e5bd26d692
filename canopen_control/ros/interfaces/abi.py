"""ctypes structures of rosidl's type supports.

Rules (rosidl_runtime_c, rosidl_typesupport_introspection_c, rosidl_typesupport_fastrtps_cpp of Jazzy): the order and
sizes of the fields are those of the C headers; objects that are created here are never freed, because C keeps pointers
to them. The fields of a type support in its C header are followed by the values that the functions of `callbacks.c`
return for this support.
"""

from __future__ import annotations

import ctypes
from ctypes import (
    CFUNCTYPE,
    POINTER,
    PYFUNCTYPE,
    Structure,
    c_bool,
    c_char_p,
    c_int32,
    c_int64,
    c_size_t,
    c_uint8,
    c_uint32,
    c_uint64,
    c_void_p,
    py_object,
)
from typing import Any, Final, TypeVar

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
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("serialize", c_void_p),
        ("deserialize", c_void_p),
        ("size", c_void_p),
        ("max_size", c_void_p),
        ("key_callbacks", c_void_p),
    )


class FastService(Structure):
    """C structure service_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (("namespace", c_char_p), ("name", c_char_p), ("request", c_void_p), ("response", c_void_p))


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
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("count", c_uint32),
        ("size_of", c_size_t),
        ("has_any_key", c_bool),
        ("members", c_void_p),
        ("init", c_void_p),
        ("fini", c_void_p),
    )


class ServiceMembers(Structure):
    """C structure rosidl_typesupport_introspection_c__ServiceMembers."""

    _fields_ = (
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("request", c_void_p),
        ("response", c_void_p),
        ("event", c_void_p),
    )


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
        ("put", c_void_p),
        ("position", c_void_p),
        ("assign", c_void_p),
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
