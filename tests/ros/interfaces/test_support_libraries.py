from __future__ import annotations

import ctypes
import hashlib
import platform
from pathlib import Path

import pytest
from support.ros import run_ros

from canopen_control.ros.interfaces import abi, support

FOLDER = Path(support.__file__).parent


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_the_library_of_each_processor_is_made_of_the_source_beside_it(processor):
    digest = hashlib.sha256((FOLDER / "callbacks.c").read_bytes()).hexdigest()
    assert digest.encode() in (FOLDER / f"callbacks_{processor}.so").read_bytes(), "run tools/native_callbacks"


@pytest.mark.parametrize("processor", ["x86_64", "aarch64"])
def test_the_library_needs_no_other_and_allows_no_code_on_the_stack(processor):
    held = (FOLDER / f"callbacks_{processor}.so").read_bytes()
    assert b"libc.so" not in held
    header, count = int.from_bytes(held[32:40], "little"), int.from_bytes(held[56:58], "little")
    segments = [held[header + 56 * each :][:56] for each in range(count)]
    kinds = {int.from_bytes(each[:4], "little"): int.from_bytes(each[4:8], "little") for each in segments}
    assert kinds[0x6474E551] & 1 == 0  # PT_GNU_STACK without PF_X


def test_a_processor_without_a_library_is_told_how_to_make_one(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    with pytest.raises(
        OSError, match=r"no callbacks_riscv64\.so .* make it with: cc -O2 -shared -fPIC -o .*callbacks\.c"
    ):
        support.Callbacks(0, 0, 0, 0)


def test_there_is_room_for_so_many_types_and_one_more_is_refused():
    callbacks = support.Callbacks(0, 0, 0, 0)
    made = {callbacks.deserializer(f"p/msg/T{each}", 0) for each in range(support.SLOTS)}
    assert len(made) == support.SLOTS
    with pytest.raises(RuntimeError, match="more than 512 types"):
        callbacks.deserializer("p/msg/Last", 0)


def test_a_support_of_a_kind_is_found_by_its_name():
    callbacks = support.Callbacks(0, 0, 0, 0)
    names = [ctypes.create_string_buffer(each) for each in (b"one", b"another", b"anoth")]
    supports = [abi.MessageSupport(ctypes.addressof(each)) for each in names]
    where = [ctypes.addressof(each) for each in supports]
    supports[0].kinds[:] = where
    find = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_void_p, ctypes.c_char_p)(callbacks["message_of_kind"])
    assert [find(where[0], each) for each in (b"one", b"another", b"anoth", b"ano", b"")] == [*where, None, None]


@pytest.mark.ros
def test_a_body_goes_into_a_message_in_c_and_out_again():
    code = """
import ctypes, rclpy.serialization
from canopen_control.ros.interfaces.support import Libraries
support = Libraries()
message = ctypes.CFUNCTYPE(ctypes.c_void_p)(support.create)()
assert support.body_of(message) == b""
assert support.set_body(message, b"a\\0b")
assert support.body_of(message) == b"a\\0b"
ctypes.CFUNCTYPE(None, ctypes.c_void_p)(support.destroy)(message)
assert all((support.fast_id, support.introspection_id, support.dispatch_id))
"""
    assert run_ros(code) == ""
