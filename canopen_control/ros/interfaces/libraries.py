"""The functions and names of ROS's C libraries that a type support made at run time stands on.

The law of the file: a ROS message of ours is a `std_msgs/String` in C whose text is the CDR body; so creating,
destroying and copying are upstream's own functions. The type supports' identifiers are compared by address and so must
be the libraries' own. Where in a Fast CDR object the end of its buffer stands is found by making one and looking. What
Fast DDS calls while it holds its mutexes is `callbacks.c`, made for each processor: see there why it is not Python.
"""

from __future__ import annotations

import ctypes
import importlib
import platform
from ctypes import c_bool, c_char_p, c_int, c_size_t, c_uint, c_uint32, c_void_p
from pathlib import Path
from typing import Any, Final

from canopen_control.ros.interfaces.abi import SLOTS, Bytes, CallbackSettings, keep

__all__ = ["Callbacks", "Libraries"]

_CDR: Final = "_ZN8eprosima7fastcdr3Cdr"  # eprosima::fastcdr::Cdr
_BUFFER_MADE: Final = "_ZN8eprosima7fastcdr10FastBufferC1EPcm"
_CDR_MADE: Final = f"{_CDR}C1ERNS0_10FastBufferENS1_10EndiannessENS0_10CdrVersionE"
_PUT: Final = f"{_CDR}15serialize_arrayEPKcm"
_POSITION: Final = f"{_CDR}20get_current_positionEv"
_LITTLE_ENDIAN: Final = 1
_XCDR1: Final = 1


class Libraries:
    """Loads the libraries; OSError or AttributeError when one, or a function in it, is missing."""

    def __init__(self) -> None:
        self._folder = _library_folder()
        runtime, cdr = self._open("librosidl_runtime_c.so"), self._open("libfastcdr.so.2")
        strings = self._open("libstd_msgs__rosidl_generator_c.so")
        self.dispatch_id = self._identifier("rosidl_typesupport_c", "typesupport_identifier")
        self.fast_id = self._identifier("rosidl_typesupport_fastrtps_c", "identifier")
        self.introspection_id = self._identifier("rosidl_typesupport_introspection_c", "identifier")
        self.create = _address_of(strings.std_msgs__msg__String__create)
        self.destroy = _address_of(strings.std_msgs__msg__String__destroy)
        self._assign = _declared(runtime.rosidl_runtime_c__String__assignn, c_bool, c_void_p, c_char_p, c_size_t)
        position = _declared(cdr[_POSITION], c_void_p, c_void_p)
        self.callbacks = Callbacks(
            put=_address_of(cdr[_PUT]),
            position=_address_of(position),
            assign=_address_of(self._assign),
            end_offset=_find_end(cdr, position),
        )

    def set_body(self, message: int, body: bytes) -> bool:
        """Let a message in C hold a body."""
        return bool(self._assign(message, body, len(body)))

    def body_of(self, message: int) -> bytes:
        """Return what a message in C holds."""
        held = Bytes.from_address(message)
        return ctypes.string_at(held.data, held.size) if held.size else b""

    def _open(self, name: str) -> ctypes.CDLL:
        try:
            return ctypes.CDLL(name)  # loaded already, or on the library path
        except OSError:
            return ctypes.CDLL(str(self._folder / name))

    def _identifier(self, package: str, symbol: str) -> int:
        return int(c_void_p.in_dll(self._open(f"lib{package}.so"), f"{package}__{symbol}").value or 0)


class Callbacks:
    """The functions of `callbacks.c`, as addresses; OSError when there is none for this processor."""

    def __init__(self, put: int, position: int, assign: int, end_offset: int) -> None:
        path = Path(__file__).with_name(f"callbacks_{platform.machine()}.so")
        if not path.exists():
            make = f"cc -O2 -shared -fPIC -o {path} {path.with_name('callbacks.c')}"
            raise OSError(f"there is no {path.name} for this processor; make it with: {make}")
        self._library = keep(ctypes.CDLL(str(path)))
        self._settings = keep(CallbackSettings.in_dll(self._library, "settings"))
        self._settings.put, self._settings.position, self._settings.assign = put, position, assign
        self._settings.end_offset = end_offset
        self._dropped = (c_uint32 * SLOTS).in_dll(self._library, "dropped")
        self._dropped_in_all = c_uint32.in_dll(self._library, "dropped_in_all")
        self._slot = _declared(self._library.slot, c_void_p, c_uint)
        self._names: list[str] = []
        self._told, self._told_in_all = [0] * SLOTS, 0

    def __getitem__(self, name: str) -> int:
        """Return the address of a function."""
        return _address_of(self._library[name])

    def deserializer(self, name: str, layout: int) -> int:
        """Return the function that takes a message of a new type; RuntimeError when there is no room for another."""
        slot = len(self._names)
        if slot == SLOTS:
            raise RuntimeError(f"more than {SLOTS} types of messages in one process")
        self._names.append(name)
        self._settings.layouts[slot] = layout
        return int(self._slot(slot))

    def newly_dropped(self) -> list[str]:
        """Return the types of which messages of another layout came, and were dropped, since the last call."""
        if self._dropped_in_all.value == self._told_in_all:
            return []
        self._told_in_all = self._dropped_in_all.value
        counts = list(self._dropped)
        names = [name for slot, name in enumerate(self._names) if counts[slot] != self._told[slot]]
        self._told = counts
        return names


def _library_folder() -> Path:
    """Return where this ROS has its libraries: beside the site-packages that its generators are in."""
    generator = importlib.import_module("rosidl_generator_py")
    return Path(str(generator.__file__)).resolve().parents[4] / "lib"


def _declared(function: Any, result: Any, *arguments: Any) -> Any:  # noqa: ANN401 - ctypes functions are
    function.restype, function.argtypes = result, arguments
    return function


def _address_of(function: Any) -> int:  # noqa: ANN401 - as above
    return int(ctypes.cast(function, c_void_p).value or 0)


def _find_end(cdr: ctypes.CDLL, position: Any) -> int:  # noqa: ANN401 - as above
    """Return the offset of the end pointer in a Cdr; RuntimeError when it is not there exactly once."""
    size, words = 16, 128
    raw = keep(ctypes.create_string_buffer(size))
    buffer, made = keep(ctypes.create_string_buffer(64)), keep(ctypes.create_string_buffer(words * 8))
    _declared(cdr[_BUFFER_MADE], None, c_void_p, c_void_p, c_size_t)(buffer, raw, size)
    _declared(cdr[_CDR_MADE], None, c_void_p, c_void_p, c_int, c_int)(made, buffer, _LITTLE_ENDIAN, _XCDR1)
    held = list((c_size_t * words).from_buffer(made))
    end = ctypes.addressof(raw) + size
    if held.count(end) != 1 or position(made) != ctypes.addressof(raw):
        raise RuntimeError("this Fast CDR is laid out in another way than the one known here")
    return 8 * held.index(end)
