from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.ros.sdo_services import Address, as_uint32, decode, encode, of_datatype, of_uint32, parse_address


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("0x6041", Address(0x6041, 0, "")),
        ("6041:1f", Address(0x6041, 0x1F, "")),
        ("0x1008:00 str", Address(0x1008, 0, "str")),
        ("0x60FF:00/i32", Address(0x60FF, 0, "i32")),
    ],
)
def test_an_object_is_written_in_hexadecimal_with_or_without_a_type(text, address):
    assert parse_address(text) == address
    assert str(address) == f"0x{address.index:04X}:{address.subindex:02X}"


@pytest.mark.parametrize("text", ["", "x", "0x60411", "0x6041:100", "0x6041 u128", "speed"])
def test_what_is_no_object_is_a_sentence(text):
    with pytest.raises(ValueError, match=r"is no object|no type"):
        parse_address(text)


@given(st.text())
def test_any_text_is_an_address_or_a_sentence(text):
    with contextlib.suppress(ValueError):
        assert 0 <= parse_address(text).index <= 0xFFFF


@pytest.mark.parametrize(
    ("value", "kind"),
    [(True, "bool"), (-1, "i8"), (-300, "i16"), (-70000, "i32"), (-(1 << 40), "i64"), (200, "u8"), (60000, "u16"),
     (1 << 31, "u32"), (1 << 63, "u64"), (0.5, "f32"), (math.pi, "f64"), ("TMCM-1270", "str"), (b"\0\1\2", "bytes")],
)  # fmt: skip
def test_every_type_goes_out_and_comes_back(value, kind):
    assert decode(encode(value, kind, 0), kind) == value


def test_without_a_type_the_length_decides():
    assert decode(b"\x2c\x01", "") == 300
    assert decode(b"abc", "") == b"abc"
    assert encode(-2, "", 2) == b"\xfe\xff"
    assert encode(1.0, "", 4) == b"\0\0\x80\x3f"


@pytest.mark.parametrize(("value", "kind", "length"), [(256, "u8", 0), (-1, "u32", 0), (70000, "", 2), ("x", "", 4)])
def test_what_does_not_fit_is_a_sentence(value, kind, length):
    if isinstance(value, str):
        assert encode(value, kind, length) == b"x"
    else:
        with pytest.raises(ValueError, match="does not fit"):
            encode(value, kind, length)
    with pytest.raises(ValueError, match="bytes"):
        decode(b"abc", "u16")


@given(st.integers(1, 4), st.data())
def test_data_of_a_service_is_the_objects_bytes_also_where_they_are_negative(length, data):
    raw = data.draw(st.binary(min_size=length, max_size=length))
    assert of_uint32(as_uint32(raw), length) == raw
    signed = int.from_bytes(raw, "little", signed=True)
    assert of_uint32(signed & 0xFFFFFFFF, length) == raw


def test_data_that_is_too_large_for_the_object_is_refused():
    with pytest.raises(ValueError, match="does not fit"):
        of_uint32(256, 1)
    with pytest.raises(ValueError, match="set_objects"):
        of_uint32(1, 8)
    with pytest.raises(ValueError, match="get_objects"):
        as_uint32(bytes(5))


def test_the_data_types_of_the_services_are_those_of_the_standard():
    assert [of_datatype(number) for number in range(2, 8)] == [1, 2, 4, 1, 2, 4]
    with pytest.raises(ValueError, match="no data type 8"):
        of_datatype(8)
