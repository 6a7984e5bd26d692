from __future__ import annotations

import contextlib
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.lineclient import MAX_VALUES
from canopen_control.rpc import wire
from canopen_control.rpc.messages.robot import CommandController, SdoData
from canopen_control.rpc.messages.state import AxisReading, JointReading

JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text(), lambda inner: st.lists(inner, max_size=3)
)


def test_a_request_has_its_number_method_and_parameters():
    line = wire.request_line(7, "command", CommandController(controller="c", values=[1.0]))
    assert json.loads(line) == {
        "id": 7,
        "method": "command",
        "params": {"controller": "c", "values": [1.0], "source": None, "dead_man": False, "interface": None},
    }
    assert line.endswith(b"\n")
    assert b'"id"' not in wire.request_line(None, "status", {})


def test_what_is_sent_is_what_comes():
    incoming = wire.read_request(wire.request_line(7, "sdo_write", SdoData(b"\x00\xff")).rstrip())
    assert (incoming.number, incoming.method) == (7, "sdo_write")
    assert wire.decode(incoming.params, SdoData) == SdoData(b"\x00\xff")


@given(st.dictionaries(st.text(), JSON))
def test_any_object_is_read_and_any_other_line_is_refused(document):
    assert {key: json.loads(bytes(value)) for key, value in wire.read_line(json.dumps(document).encode()).items()} == (
        document
    )
    with pytest.raises(ValueError, match="JSON object"):
        wire.read_line(json.dumps([document]).encode())


@given(st.binary())
def test_garbage_is_a_sentence(line):
    with contextlib.suppress(ValueError):  # and nothing else
        assert isinstance(wire.read_request(line).method, str)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"[1]", "JSON object"),
        (b"\xff", "malformed"),
        (b'{"id": {}}', "an id is a number or a text"),
        (b'{"a":' + b"[" * 4000, "recursion"),
        (b'{"a":[' + b"1," * MAX_VALUES + b"1]}", "values"),
    ],
)
def test_a_request_that_is_none_is_refused_with_why(line, words):
    with pytest.raises(ValueError, match=words):
        wire.read_request(line)


def test_without_a_method_or_parameters_there_are_none():
    incoming = wire.read_request(b'{"id": "x", "method": 5}')
    assert (incoming.number, incoming.method, bytes(incoming.params)) == ("x", "", b"{}")


def test_what_does_not_fit_is_reported_with_its_path():
    with pytest.raises(ValueError, match=r"Expected `float \| null`, got `str` - at `\$.velocity`"):
        wire.decode(b'{"name": "a", "velocity": "fast"}', JointReading)
    with pytest.raises(ValueError, match="missing required field `joint`"):
        wire.convert({}, AxisReading)


def test_what_is_nested_too_deep_is_reported_as_that():
    with pytest.raises(ValueError, match="it is nested too deep"):
        wire.decode(b'{"new": ' + b"[" * 100_000, JointReading)


def test_a_number_that_is_not_finite_is_null_and_a_field_of_a_newer_server_is_skipped():
    assert json.loads(wire.text_of(JointReading("a", math.nan)))["position"] is None
    assert wire.convert({**wire.plain(JointReading("a", math.inf)), "new": 1}, JointReading) == JointReading("a")


def test_answers_and_unrequested_messages_have_their_own_keys():
    assert json.loads(wire.answer_line("x", SdoData(b"\1"))) == {"id": "x", "result": {"data": "AQ=="}}
    assert json.loads(wire.error_line(3, "ControlError", "no")) == {
        "id": 3,
        "error": {"kind": "ControlError", "message": "no"},
    }
    assert json.loads(wire.push_line("state", {"time": 1.0})) == {"state": {"time": 1.0}}


def test_a_number_that_is_not_finite_is_called_that():
    with pytest.raises(ValueError, match=r"NaN or an infinite number .* where a finite one is needed - at `\$\[1\]`"):
        wire.decode(b"[1.0, null]", list[float])
    with pytest.raises(ValueError, match="got `str`"):
        wire.decode(b'["1"]', list[float])
