"""C structures of rosidl's type supports for ctypes.

Rules (rosidl_runtime_c, rosidl_typesupport_introspection_c, rosidl_typesupport_fastrtps_cpp of Jazzy):
order and sizes are those of the headers; what is made here lives as long as the process, C keeps pointers to it. Behind
the fields of a support's header stands what the functions of `callbacks.c` return for it.
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
"""How many types `callbacks.c` has room for."""

CREATE = CFUNCTYPE(c_void_p)
DESTROY = CFUNCTYPE(None, c_void_p)
CONVERT_FROM_PY = PYFUNCTYPE(c_bool, py_object, c_void_p)
CONVERT_TO_PY = PYFUNCTYPE(c_void_p, c_void_p)


def keep(value: T) -> T:
    """Keep a reference to memory that C points to."""
    _referenced.append(value)
    return value


def address(value: Any) -> int:  # noqa: ANN401 - any ctypes object
    """Return the address of a structure, which is kept."""
    return ctypes.addressof(keep(value))


class Bytes(Structure):
    """rosidl_runtime_c__String, and every sequence."""

    _fields_ = (("data", c_void_p), ("size", c_size_t), ("capacity", c_size_t))


class FieldTypeDescription(Structure):
    """type_description_interfaces/msg/FieldType."""

    _fields_ = (("type_id", c_uint8), ("capacity", c_uint64), ("string_capacity", c_uint64), ("nested", Bytes))


class FieldDescription(Structure):
    """type_description_interfaces/msg/Field."""

    _fields_ = (("name", Bytes), ("type", FieldTypeDescription), ("default_value", Bytes))


class IndividualDescription(Structure):
    """type_description_interfaces/msg/IndividualTypeDescription."""

    _fields_ = (("type_name", Bytes), ("fields", Bytes))


class TypeDescriptionStruct(Structure):
    """type_description_interfaces/msg/TypeDescription."""

    _fields_ = (("type_description", IndividualDescription), ("referenced", Bytes))


class TypeSource(Structure):
    """type_description_interfaces/msg/TypeSource."""

    _fields_ = (("type_name", Bytes), ("encoding", Bytes), ("raw", Bytes))


class Hash(Structure):
    """rosidl_type_hash_t."""

    _fields_ = (("version", c_uint8), ("value", c_uint8 * 32))


def _pointers(*names: str) -> tuple[tuple[str, type[c_void_p]], ...]:
    return tuple((name, c_void_p) for name in names)


_HASHED: Final = _pointers("get_hash", "get_description", "get_sources", "hash", "description", "sources")
_KINDS: Final = ("kinds", c_void_p * 3)


class MessageSupport(Structure):
    """rosidl_message_type_support_t."""

    _fields_ = (*_pointers("identifier", "data", "handle"), *_HASHED, _KINDS)


class ServiceSupport(Structure):
    """rosidl_service_type_support_t."""

    _fields_ = (
        *_pointers("identifier", "data", "handle", "request", "response", "event", "make_event", "remove_event"),
        *_HASHED,
        _KINDS,
    )


class ActionSupport(Structure):
    """rosidl_action_type_support_t: rcl_action reads it directly, so it has neither identifier nor handle."""

    _fields_ = (*_pointers("send_goal", "get_result", "cancel", "feedback", "status"), *_HASHED)


class FastCallbacks(Structure):
    """message_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

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
    """service_type_support_callbacks_t of rosidl_typesupport_fastrtps_cpp."""

    _fields_ = (("namespace", c_char_p), ("name", c_char_p), ("request", c_void_p), ("response", c_void_p))


class MessageMember(Structure):
    """rosidl_typesupport_introspection_c__MessageMember; its functions are not used by rmw_fastrtps."""

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
    """rosidl_typesupport_introspection_c__MessageMembers."""

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
    """rosidl_typesupport_introspection_c__ServiceMembers."""

    _fields_ = (
        ("namespace", c_char_p),
        ("name", c_char_p),
        ("request", c_void_p),
        ("response", c_void_p),
        ("event", c_void_p),
    )


class EventInfo(Structure):
    """rosidl_service_introspection_info_t."""

    _fields_ = (
        ("event_type", c_uint8),
        ("sec", c_int32),
        ("nanosec", c_uint32),
        ("gid", c_uint8 * 16),
        ("sequence_number", c_int64),
    )


class LayoutField(Structure):
    """struct field of `callbacks.c`."""

    _fields_ = (("kind", c_uint8), ("shape", c_uint8), ("size", c_uint8), ("count", c_uint32), ("nested", c_void_p))


class StructLayout(Structure):
    """struct layout of `callbacks.c`."""

    _fields_ = (("count", c_size_t), ("fields", c_void_p))


class CallbackSettings(Structure):
    """`settings` of `callbacks.c`."""

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
    """Return a text as a C string."""
    buffer = ctypes.create_string_buffer(text.encode())
    return Bytes(address(buffer), len(buffer) - 1, len(buffer))


def sequence(kind: type[Structure], items: list[Any]) -> Bytes:
    """Return a sequence of structures."""
    array = (kind * max(1, len(items)))(*items)
    return Bytes(address(array), len(items), len(items))
