"""Values and their bytes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.eds import DEVICE_TYPE, codes, eds, parse, section

from canopen_control.od.codec import (
    above_limit,
    accepts,
    below_limit,
    decode,
    default_of,
    encode,
    fitted,
    forbidden_limit,
    outside_limits,
    zero_of,
)
from canopen_control.od.model import DataType, Entry

U32 = DataType.UNSIGNED32


def limited(index, subindex=0, data_type=U32, low=None, high=None):
    return Entry(index, subindex, "", data_type, low=low, high=high)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (limited(0x1016, 1, high=65535), "bits 16 to 23 are the node-ID"),
        (limited(0x1016, 2, low=1), "bits 16 to 23"),
        (limited(0x1005, high=0x7F), "predefined"),
        (limited(0x1010, 1, high=1), "signature"),
        (limited(0x1011, 1, high=0xFFFF), "signature"),
        (limited(0x1014, high=0xFF), "bit 31"),
        (limited(0x1400, 1, low=0x181, high=0x5FF), "bit 31"),
        (limited(0x19FF, 1, high=0x7FF), "bit 31"),
    ],
)
def test_a_limit_that_cia_301_forbids_counts_for_nothing(entry, words):
    assert words in forbidden_limit(entry)
    assert not outside_limits(entry, 0x00010000 | 500)


@pytest.mark.parametrize(
    "entry",
    [
        limited(0x1016, 1, low=0, high=0x007F_FFFF),
        limited(0x1016, 1),
        limited(0x1016, 0, DataType.UNSIGNED8, low=1, high=1),
        limited(0x1017, 0, DataType.UNSIGNED16, low=10, high=1000),
        limited(0x1400, 2, DataType.UNSIGNED8, high=240),
        limited(0x1400, 1, low=0, high=0xFFFFFFFF),
        limited(0x1010, 1, low=0, high=0xFFFFFFFF),
        limited(0x6083, 0, high=1000),
    ],
)
def test_other_limits_count(entry):
    assert forbidden_limit(entry) == ""
    if entry.high is not None:
        assert above_limit(entry, entry.high + 1)
        assert not above_limit(entry, entry.high)
    if entry.low is not None:
        assert below_limit(entry, entry.low - 1)
        assert not below_limit(entry, entry.low)


@pytest.mark.parametrize(
    ("edit", "value", "accepted"),
    [
        ({}, 250, True),
        ({}, 256, False),
        ({}, 1.5, False),
        ({"access": "ro"}, 1, False),
        ({"high": 100}, 100, True),
        ({"high": 100}, 101, False),
        ({"data_type": DataType.VISIBLE_STRING}, 1, False),
        ({"data_type": DataType.VISIBLE_STRING}, "a", True),
    ],
)
def test_what_a_write_of_a_value_needs(edit, value, accepted):
    entry = Entry(0x2000, 0, "Any", **{"data_type": DataType.UNSIGNED8, "access": "rw", **edit})
    assert accepts(entry, value) is accepted
    assert not accepts(None, value)


def test_the_check_of_a_file_notes_it():
    consumer = section("1016", ParameterName="Consumer heartbeat time", ObjectType=8, SubNumber=2)
    count = eds("1016sub0", data_type=5, access="ro", DefaultValue=1)
    file = parse(DEVICE_TYPE, consumer, count, eds("1016sub1", HighLimit=65535, DefaultValue="0x10064"))
    assert "limit-forbidden" in codes(file)
    assert "value-limit" not in codes(file)
    (issue,) = [issue for issue in file.issues if issue.code == "limit-forbidden"]
    assert "HighLimit 65535" in issue.text


INTEGERS = [t for t in DataType if t.is_integer]


@pytest.mark.parametrize(
    ("data_type", "value", "data"),
    [
        (DataType.BOOLEAN, 1, "01"),
        (DataType.INTEGER8, -3, "fd"),
        (DataType.INTEGER24, -2, "feffff"),
        (DataType.INTEGER32, -2147483647, "01000080"),
        (DataType.UNSIGNED16, 0x1234, "3412"),
        (DataType.UNSIGNED56, 1, "01000000000000"),
        (DataType.UNSIGNED64, 2**64 - 1, "ffffffffffffffff"),
        (DataType.REAL32, 10.0, "00002041"),
        (DataType.REAL64, -2.25, "00000000000002c0"),
        (DataType.VISIBLE_STRING, "5 °C", "3520b043"),
        (DataType.UNICODE_STRING, "aé", "6100e900"),
        (DataType.OCTET_STRING, b"\x00\x01", "0001"),
        (DataType.DOMAIN, b"", ""),
        (DataType.TIME_OF_DAY, 14669 << 32 | 45296789, "952cb3024d39"),
    ],
)
def test_known_values_have_known_bytes(data_type, value, data):
    assert encode(value, data_type).hex() == data
    assert decode(bytes.fromhex(data), data_type) == value


@given(st.sampled_from(INTEGERS), st.data())
def test_every_whole_number_returns(data_type, data):
    value = data.draw(st.integers(data_type.minimum, data_type.maximum))
    encoded = encode(value, data_type)
    assert len(encoded) == (data_type.bits + 7) // 8
    assert decode(encoded, data_type) == value


@given(st.text(st.characters(max_codepoint=0xFF)).filter(lambda text: not text.endswith("\0")))
def test_every_string_returns(text):
    for data_type in (DataType.VISIBLE_STRING, DataType.UNICODE_STRING):
        assert decode(encode(text, data_type), data_type) == text


@given(st.binary(max_size=10), st.sampled_from(list(DataType)))
def test_decoding_raises_only_value_error(data, data_type):
    try:
        value = decode(data, data_type)
    except ValueError:
        return
    assert isinstance(value, int | float | str | bytes)


@pytest.mark.parametrize(
    ("value", "data_type", "sentence"),
    [
        ("5", DataType.UNSIGNED8, "expected a whole number"),
        (5.0, DataType.UNSIGNED8, "expected a whole number"),
        ("x", DataType.REAL32, "expected a number"),
        (1e39, DataType.REAL32, "too large"),
        (10**400, DataType.REAL64, "too large"),
        (5, DataType.VISIBLE_STRING, "expected a string"),
        ("\ud800", DataType.VISIBLE_STRING, "characters"),
        ("text", DataType.DOMAIN, "expected bytes"),
    ],
)
def test_values_of_another_kind_are_refused(value, data_type, sentence):
    with pytest.raises(ValueError, match=sentence):
        encode(value, data_type)


def test_data_of_another_length_is_refused():
    with pytest.raises(ValueError, match="UNSIGNED32 has 4 bytes, not 3"):
        decode(b"\0\0\0", DataType.UNSIGNED32)
    with pytest.raises(ValueError, match="not UTF-16"):
        decode(b"a", DataType.UNICODE_STRING)


def test_what_a_node_holds_after_power_on():
    assert default_of(Entry(0x2000, 0, "a", DataType.UNSIGNED8, default=7)) == 7
    assert default_of(Entry(0x2000, 0, "a", DataType.UNSIGNED8, default=7, parameter_value=8)) == 8
    for data_type in DataType:
        zero = default_of(Entry(0x2000, 0, "a", data_type))
        assert zero == zero_of(data_type)
        assert not any(encode(zero, data_type))


@pytest.mark.parametrize(
    ("data", "data_type", "whole"),
    [
        ("4006", DataType.UNSIGNED16, "4006"),
        ("40", DataType.UNSIGNED16, None),
        ("", DataType.UNSIGNED8, None),
        ("40060000", DataType.UNSIGNED16, "4006"),
        ("40060100", DataType.UNSIGNED16, None),
        ("ffff", DataType.INTEGER8, "ff"),
        ("ff00", DataType.INTEGER8, None),
        ("7fff", DataType.INTEGER8, None),
        ("ffff", DataType.UNSIGNED8, None),
        ("0000c03f", DataType.REAL32, "0000c03f"),
        ("0000c03f00000000", DataType.REAL32, None),
        ("414200", DataType.VISIBLE_STRING, "414200"),
        ("", DataType.DOMAIN, ""),
    ],
)
def test_what_an_upload_brought_is_fitted_to_its_type_or_refused(data, data_type, whole):
    assert fitted(bytes.fromhex(data), data_type) == (None if whole is None else bytes.fromhex(whole))


def test_bytes_that_the_server_did_not_count_are_cut():
    assert fitted(b"\x40\x06\xaa\xbb", DataType.UNSIGNED16, length_known=False) == b"\x40\x06"
    assert fitted(b"\x40\x06\xaa\xbb", DataType.UNSIGNED64, length_known=False) is None
