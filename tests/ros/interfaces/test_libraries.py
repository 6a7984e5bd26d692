from __future__ import annotations

import pytest
from support.ros import run_ros

pytestmark = pytest.mark.ros


def test_a_body_goes_into_a_message_in_c_and_out_again():
    code = """
import ctypes, rclpy.serialization
from canopen_control.ros.interfaces.libraries import Libraries
libraries = Libraries()
message = ctypes.CFUNCTYPE(ctypes.c_void_p)(libraries.create)()
assert libraries.body_of(message) == b""
assert libraries.set_body(message, b"a\\0b")
assert libraries.body_of(message) == b"a\\0b"
ctypes.CFUNCTYPE(None, ctypes.c_void_p)(libraries.destroy)(message)
assert all((libraries.fast_id, libraries.introspection_id, libraries.dispatch_id))
"""
    assert run_ros(code) == ""
