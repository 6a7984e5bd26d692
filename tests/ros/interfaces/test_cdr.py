from __future__ import annotations

import math
from array import array
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.interfaces.cdr import Codecs
from canopen_control.ros.interfaces.definition import Registry

DEFINITIONS = {
    "p/msg/Empty": [],
    "p/msg/Point": ["float64 x", "float64 y"],
    "p/msg/All": [
        "bool yes", "byte one", "uint8 small", "int16 middle", "uint32 large", "int64 huge", "float32 single",
        "float64 double", "string text", "float64[] numbers", "uint8[3] three", "string[] texts", "bool[] flags",
        "byte[] octets", "Point point", "Point[] points", "Empty nothing", "int16[<=2] two",
    ],
}  # fmt: skip


def codecs():
    registry = Registry()
    registry.add(DEFINITIONS)
    return Codecs(registry.get, lambda name: SimpleNamespace)


def point(x=0.0, y=0.0):
    return SimpleNamespace(x=x, y=y)


numbers = st.floats(allow_nan=False)
points = st.builds(point, numbers, numbers)
texts = st.text().filter(lambda text: "\0" not in text)
messages = st.builds(
    SimpleNamespace, yes=st.booleans(), one=st.binary(min_size=1, max_size=1), small=st.integers(0, 255),
    middle=st.integers(-(2**15), 2**15 - 1), large=st.integers(0, 2**32 - 1), huge=st.integers(-(2**63), 2**63 - 1),
    single=st.floats(width=32, allow_nan=False), double=numbers, text=texts,
    numbers=st.lists(numbers).map(lambda values: array("d", values)),
    three=st.lists(st.integers(0, 255), min_size=3, max_size=3).map(lambda values: array("B", values)),
    texts=st.lists(texts), flags=st.lists(st.booleans()), octets=st.lists(st.binary(min_size=1, max_size=1)),
    point=points, points=st.lists(points), nothing=st.just(SimpleNamespace()),
    two=st.lists(st.integers(-5, 5), max_size=2).map(lambda values: array("h", values)),
)  # fmt: skip


@pytest.mark.rest
@given(messages)
def test_what_is_encoded_is_decoded_to_the_same(message):
    created = codecs()
    assert created.decode("p/msg/All", created.encode("p/msg/All", message)) == message


@given(messages, st.data())
def test_a_body_that_is_cut_is_refused(message, data):
    created = codecs()
    body = created.encode("p/msg/All", message)
    with pytest.raises(ValueError, match=r"not the body|announced"):
        created.decode("p/msg/All", body[: data.draw(st.integers(0, len(body) - 1))])


@given(st.binary(max_size=200))
def test_garbage_is_a_message_or_a_value_error(body):
    created = codecs()
    try:
        message = created.decode("p/msg/All", body)
    except ValueError:
        return
    assert created.decode("p/msg/All", created.encode("p/msg/All", message)) is not None


def test_a_length_of_four_gigabytes_allocates_nothing():
    for kind in ("float64[]", "string[]", "bool[]"):
        registry = Registry()
        registry.add({"p/msg/T": [f"{kind} values"]})
        with pytest.raises(ValueError, match="bytes are announced"):
            Codecs(registry.get, lambda name: SimpleNamespace).decode("p/msg/T", b"\xff" * 8)


def test_numbers_are_aligned_to_their_size_and_strings_end_with_zero():
    registry = Registry()
    registry.add({"p/msg/T": ["uint8 a", "float64 b", "string c", "uint16 d"]})
    body = Codecs(registry.get, lambda name: SimpleNamespace).encode(
        "p/msg/T", SimpleNamespace(a=1, b=0.0, c="hi", d=2)
    )
    assert body.hex() == "01" + "00" * 7 + "00" * 8 + "03000000" + "686900" + "00" + "0200"


@pytest.mark.parametrize(
    ("field", "value"),
    [("three", [1, 2]), ("two", [1, 2, 3]), ("one", b""), ("small", 300), ("text", 5), ("double", "x")],
)
def test_a_field_that_holds_something_else_is_refused(field, value):
    message = SimpleNamespace(
        yes=True, one=b"a", small=1, middle=1, large=1, huge=1, single=math.pi, double=1.0, text="", numbers=[],
        three=[1, 2, 3], texts=[], flags=[], octets=[], point=point(), points=[], nothing=None, two=[],
    )  # fmt: skip
    codecs().encode("p/msg/All", message)
    setattr(message, field, value)
    with pytest.raises(ValueError, match=r"this is not a valid p/msg/All|cannot have|one byte"):
        codecs().encode("p/msg/All", message)
