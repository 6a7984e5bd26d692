"""Numbers and values as files write them."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.od.codec import decode, encode
from canopen_control.od.eds_values import format_value, parse_number, parse_value
from canopen_control.od.issues import Severity
from canopen_control.od.model import DataType

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "eds_values.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("vector", [v for v in VECTORS if v["text"]], ids=lambda vector: vector["text"])
def test_values_of_real_files(vector):
    data_type = DataType[vector.get("type", "UNSIGNED32")]
    if vector["value"] is None:
        with pytest.raises(ValueError, match=r"not a number|neither a number"):
            parse_value(vector["text"], data_type, vector.get("node"))
    else:
        assert parse_value(vector["text"], data_type, vector.get("node")).value == vector["value"]


@pytest.mark.parametrize(
    ("text", "number", "code"),
    [
        ("0", 0, None),
        ("00", 0, None),
        ("007", 7, None),
        ("-5", -5, None),
        ("+5", 5, None),
        ("0XfF", 255, None),
        ("12 ; comment", 12, None),
        ("0x07 # VAR", 7, "number-comment"),
        ("0x00020192LL", 0x20192, "number-suffix"),
        ("5u", 5, "number-suffix"),
        ("0FFh", 255, "number-suffix"),
        ("010", 8, "number-octal"),
        ("08", 8, None),
        ("TRUE", 1, "number-word"),
        ("false", 0, "number-word"),
        ("0.0", 0, "number-fraction"),
        ("5.", 5, "number-fraction"),
    ],
)
def test_number_forms(text, number, code):
    parsed = parse_number(text)
    assert parsed.value == number
    assert (parsed.issue.code if parsed.issue else None) == code


@pytest.mark.parametrize(
    "text",
    ["", "x", "0x", "1_000", "٣", "1 2", "0b11", "--5", "0.5", "1e999", "9" * 5000, "0x" + "F" * 5000, "$NODEID"],
)
def test_what_is_not_a_number(text):
    with pytest.raises(ValueError, match="not a number"):
        parse_number(text)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("$NODEID", 3),
        ("$nodeid+0x200", 0x203),
        ("0x200+$NodeId", 0x203),
        (" $NODEID + 512 ; COB-ID", 515),
        ("$NODEID+0x40000000+0x200", 0x40000203),
        ("$NODEID+0x80000300", 0x80000303),
        ("($NODEID + 0x200)", 0x203),
    ],
)
def test_the_node_id_stands_anywhere(text, value):
    parsed = parse_value(text, DataType.UNSIGNED32, 3)
    assert (parsed.value, parsed.relative) == (value, True)
    assert parse_value(text, DataType.UNSIGNED32).value == value - 3


def test_parentheses_around_a_sum_are_reported():
    issue = parse_value("($NODEID+0x200)", DataType.UNSIGNED32, 3).issue
    assert issue is not None
    assert issue.text == "the parentheses are ignored"


def test_a_sum_below_the_node_id_is_refused():
    """As two's complement it would become 0x100000002 for node 3."""
    with pytest.raises(ValueError, match="minus a number"):
        parse_value("-1+$NODEID", DataType.UNSIGNED32)


@pytest.mark.parametrize("text", ["$MY_NODE_ID+0x200", "$NODEID-1", "$NODEID+$NODEID", "$NODEID+x", "$NODEID*2", "$"])
def test_what_is_not_a_node_id(text):
    with pytest.raises(ValueError, match=r"not a number|neither a number"):
        parse_value(text, DataType.UNSIGNED32, 3)


@pytest.mark.parametrize(
    ("text", "data_type", "value", "code"),
    [
        ("0x80000001", DataType.INTEGER32, -2147483647, None),
        ("0xFD", DataType.INTEGER8, -3, None),
        ("0xFFFFFF", DataType.INTEGER24, -1, None),
        ("4294967295", DataType.INTEGER32, -1, "number-sign"),
        ("0xFFFF8000", DataType.INTEGER16, -32768, "number-sign"),
        ("0xFFFFFFF6", DataType.INTEGER8, -10, "number-sign"),
        ("0xFFFFFFFFFFFFFFFE", DataType.INTEGER32, -2, "number-sign"),
        ("-1", DataType.UNSIGNED32, 0xFFFFFFFF, "number-sign"),
        ("-128", DataType.INTEGER8, -128, None),
        ("1", DataType.BOOLEAN, 1, None),
    ],
)
def test_two_s_complement_is_the_type_s(text, data_type, value, code):
    parsed = parse_value(text, data_type)
    assert parsed.value == value
    assert (parsed.issue.code if parsed.issue else None) == code


@pytest.mark.parametrize(
    ("text", "data_type"),
    [
        ("256", "UNSIGNED8"),
        ("0x100", "INTEGER8"),
        ("0xFFFF7FFF", "INTEGER16"),
        ("0xFFFFFFFF", "UNSIGNED8"),
        ("-129", "INTEGER8"),
        ("2", "BOOLEAN"),
        ("-1", "BOOLEAN"),
    ],
)
def test_what_a_type_cannot_hold_is_refused(text, data_type):
    with pytest.raises(ValueError, match=f"does not fit {data_type}"):
        parse_value(text, DataType[data_type])


@pytest.mark.parametrize(
    ("text", "data_type", "value"),
    [
        ("1.5", DataType.REAL32, 1.5),
        ("-3", DataType.REAL64, -3.0),
        ("1e3 ; comment", DataType.REAL32, 1000.0),
        (".5", DataType.REAL32, 0.5),
        ("0x41200000", DataType.REAL32, 10.0),
        ("0x4024000000000000", DataType.REAL64, 10.0),
    ],
)
def test_reals_are_decimal_or_bits(text, data_type, value):
    assert parse_value(text, data_type).value == value


@pytest.mark.parametrize("text", ["", "nan", "1,5", "1e39", "0x1FFFFFFFF", "$NODEID", "1_0.0", "1e" + "9" * 100])
def test_what_is_not_a_real(text):
    with pytest.raises(ValueError, match=r"not a number|too large|neither"):
        parse_value(text, DataType.REAL32)


@pytest.mark.parametrize("data_type", [DataType.OCTET_STRING, DataType.DOMAIN])
def test_characters_that_no_byte_holds_are_refused(data_type):
    with pytest.raises(ValueError, match="outside ISO 8859-1"):
        parse_value("5 €", data_type)
    assert parse_value("5 €", DataType.UNICODE_STRING).value == "5 €"


def test_a_visible_string_in_utf_8_is_kept_and_noted():
    parsed = parse_value("5 \u20ac", DataType.VISIBLE_STRING)
    assert (parsed.value, parsed.issue.code) == ("5 \u20ac", "text-utf8")
    assert encode(parsed.value, DataType.VISIBLE_STRING) == "5 \u20ac".encode()
    assert parse_value("\u00b0C", DataType.VISIBLE_STRING).issue is None
    assert encode("\u00b0C", DataType.VISIBLE_STRING) == b"\xb0C"


@pytest.mark.parametrize(
    ("text", "value"), [("1 2", 1 << 32 | 2), ("0x10 0", 16 << 32), ("12345", 12345), ("0 86399999", 86399999)]
)
def test_a_time_is_one_number_or_days_and_milliseconds(text, value):
    assert parse_value(text, DataType.TIME_OF_DAY).value == value
    assert parse_value(text, DataType.TIME_DIFFERENCE).value == value


@pytest.mark.parametrize("text", ["70000 0", "-1 5", "1 2 3", "a b"])
def test_what_is_not_a_time_is_refused(text):
    with pytest.raises(ValueError, match=r"days are|not a number"):
        parse_value(text, DataType.TIME_OF_DAY)


def test_octets_are_hexadecimal_and_else_characters():
    assert parse_value("01 02 0A", DataType.OCTET_STRING).value == b"\x01\x02\x0a"
    assert parse_value("0x0102", DataType.DOMAIN).value == b"\x01\x02"
    text = parse_value("hello", DataType.DOMAIN)
    assert text.value == b"hello"
    assert (text.issue.code, text.issue.severity) == ("bytes-text", Severity.NOTE)


WIRE = {t: (t.bits + 7) // 8 for t in DataType if t.bits}


@given(st.sampled_from(sorted(WIRE)), st.data())
def test_every_value_that_is_written_is_read_again(number, data):
    data_type = DataType(number)
    value = decode(data.draw(st.binary(min_size=WIRE[data_type], max_size=WIRE[data_type])), data_type)
    parsed = parse_value(format_value(value, data_type), data_type)
    assert parsed.issue is None
    if isinstance(value, float) and math.isnan(value):
        assert math.isnan(parsed.value)
    else:
        assert encode(parsed.value, data_type) == encode(value, data_type)


@given(st.text(), st.sampled_from(list(DataType)), st.none() | st.integers(1, 127))
def test_no_text_brings_another_error_than_value_error(text, data_type, node_id):
    try:
        parsed = parse_value(text, data_type, node_id)
    except ValueError:
        return
    if data_type.is_integer:
        assert data_type.minimum <= parsed.value <= data_type.maximum
