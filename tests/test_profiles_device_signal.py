"""One signal: raw numbers to values and back, bits, types taken for others, addresses as people write them."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.od.model import DataType
from canopen_control.profiles import (
    TYPES,
    Signal,
    SignalScale,
    factor_of_digits,
    factor_of_prefix,
    object_of,
    retyped,
    unit_of_code,
)


@given(
    st.integers(-32768, 32767),
    st.floats(1e-6, 1e6).flatmap(lambda each: st.sampled_from((each, -each))),
    st.floats(-1e3, 1e3),
)
def test_a_value_goes_back_to_the_raw_number_it_came_of(raw, factor, offset):
    signal = Signal("x", 0x6401, 1, factor=factor, offset=offset)
    gain = signal.gain({})
    assert signal.raw(signal.value(raw, gain), gain, whole=False) == pytest.approx(raw, rel=1e-6, abs=1e-3)


def test_a_bit_is_0_or_1_and_an_invalid_number_is_none():
    signal = Signal("x", 0x6000, 1, bit=3)
    assert [signal.value(raw, 1.0) for raw in (0, 8, 0xF7, 0xFF)] == [0.0, 1.0, 0.0, 1.0]
    broken = Signal("x", 0x6401, 1, invalid=(-32768.0, 32767.0))
    assert math.isnan(broken.value(32767, 1.0))
    assert broken.value(32766, 1.0) == 32766.0


def test_the_devices_own_numbers_scale_a_signal_and_only_without_them_what_is_assumed():
    signal = Signal(
        "x", 0x7130, 1, factor=2.0, scales=(SignalScale((0x6132, 1), factor_of_digits, 1),), unwrap=(0x6002, 0)
    )
    assert signal.gain({(0x6132, 1): 3}) == pytest.approx(0.002)
    assert signal.gain({}) == pytest.approx(0.2)
    assert signal.needs == ((0x6132, 1), (0x6002, 0))
    assert (signal.where, Signal("b", 0x6000, 2, bit=7).where) == ("0x7130:01", "0x6000:02.7")


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("0x6401:01", (0x6401, 1, None)),
        ("6401:1", (0x6401, 1, None)),
        ("0x6004", (0x6004, 0, None)),
        (" 0x6000:0x02.7 ", (0x6000, 2, 7)),
        ("0x6000.63", (0x6000, 0, 63)),
        ("0x6000.64", None),
        ("640", None),
        ("0x64011:1", None),
        ("di0", None),
        ("", None),
    ],
)
def test_objects_are_read_as_people_write_them(text, result):
    assert object_of(text) == result


@given(st.text(max_size=12))
def test_no_text_breaks_the_reading_of_an_object(text):
    result = object_of(text)
    assert result is None or 0 <= result[0] <= 0xFFFF


def test_bits_are_taken_for_another_type_of_their_width():
    assert retyped(0xFFFF, DataType.UNSIGNED16, DataType.INTEGER16) == -1
    assert retyped(0x3F800000, DataType.UNSIGNED32, DataType.REAL32) == 1.0
    assert math.isnan(retyped(1, DataType.UNSIGNED8, DataType.UNSIGNED32))
    assert all(expected.bits for expected in TYPES.values())


@pytest.mark.parametrize(
    ("code", "unit", "factor"),
    [(0x002D0000, "degC", 1.0), (0xFD260000, "V", 0.001), (0x03010000, "m", 1000.0), (0, "", 1.0), (0xFF0000, "", 1.0)],
)
def test_units_are_coded_with_their_prefix(code, unit, factor):
    assert unit_of_code(code) == unit
    assert factor_of_prefix(code) == pytest.approx(factor)


def test_digits_that_are_none_count_as_none():
    assert [factor_of_digits(item) for item in (0, 2, 200, -1)] == [1.0, 0.01, 1.0, 1.0]
