import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import ConfigError
from canopen_control.od.model import DataType
from canopen_control.service.object_rows import TYPE_NAMES, parse_type, parse_value, show

I32, U16, F32, TEXT = DataType.INTEGER32, DataType.UNSIGNED16, DataType.REAL32, DataType.VISIBLE_STRING


@pytest.mark.parametrize(
    ("text", "data_type", "data"),
    [
        ("-500", I32, "0cfeffff"),
        ("-0x10", I32, "f0ffffff"),
        ("0xFFFFFE0C", I32, "0cfeffff"),
        ("0x7FFFFFFF", I32, "ffffff7f"),
        ("65535", U16, "ffff"),
        ("0b101", DataType.UNSIGNED8, "05"),
        ("-1e3", F32, "00007ac4"),
        ("true", DataType.BOOLEAN, "01"),
        ("0", DataType.BOOLEAN, "00"),
        ("save", TEXT, "73617665"),
        ("", TEXT, ""),
        ("DE AD", DataType.DOMAIN, "dead"),
        ("0xBEEF", DataType.OCTET_STRING, "beef"),
        ("-3", DataType.INTEGER24, "fdffff"),
    ],
)
def test_text_becomes_the_bytes_of_its_type(text, data_type, data):
    assert parse_value(text, data_type).hex() == data


@pytest.mark.parametrize(
    ("text", "data_type", "said"),
    [
        ("300", DataType.INTEGER8, "300 is no INTEGER8: it holds -128 to 127"),
        ("0x1FF", DataType.INTEGER8, "511 is no INTEGER8"),
        ("-1", U16, "-1 is no UNSIGNED16"),
        ("1.5", U16, "a whole number is wanted"),
        ("ten", F32, "a number is wanted"),
        ("yes", DataType.BOOLEAN, "a whole number is wanted"),
        ("XY", DataType.DOMAIN, "write bytes in hexadecimal"),
        ("1e99", F32, "too large for REAL32"),
    ],
)
def test_what_the_type_cannot_hold_is_refused_in_words(text, data_type, said):
    with pytest.raises(ConfigError, match=said):
        parse_value(text, data_type)


@pytest.mark.parametrize(
    ("data", "data_type", "shown"),
    [
        ("0cfeffff", I32, "-500 (0xFFFFFE0C)"),
        ("3712", U16, "4663 (0x1237)"),
        ("01", DataType.BOOLEAN, "True (1)"),
        ("00007ac4", F32, "-1000.0 (0xC47A0000)"),
        ("544d434d00", TEXT, '"TMCM" (5 bytes)'),
        ("1b5b32", TEXT, '"\\x1b[2" (3 bytes)'),
        ("dead", DataType.DOMAIN, "de ad (2 bytes)"),
        ("", DataType.DOMAIN, "empty (0 bytes)"),
        ("0cfeffff", None, "4294966796 (0xFFFFFE0C, signed -500)"),
        ("05", None, "5 (0x05)"),
        ("73617665", None, '1702257011 (0x65766173, text "save")'),
        ("544d434d2d31323730", None, '"TMCM-1270" (9 bytes)'),
        ("00" * 100, None, " ".join(["00"] * 64) + " ... (100 bytes)"),
    ],
)
def test_bytes_are_shown_as_decimal_hexadecimal_and_text(data, data_type, shown):
    assert show(bytes.fromhex(data), data_type) == shown


def test_types_have_short_names_and_those_of_the_standard():
    assert parse_type("i32") is parse_type("integer32") is parse_type("INTEGER32") is I32
    assert all(parse_type(name.strip()) in DataType for name in TYPE_NAMES.split(","))
    assert {parse_type(name.strip()) for name in TYPE_NAMES.split(",")} == set(DataType)
    with pytest.raises(ConfigError, match="no data type 'u9'; there are: bool, i8"):
        parse_type("u9")


@given(st.sampled_from([each for each in DataType if each.is_integer and each is not DataType.BOOLEAN]), st.data())
def test_every_integer_comes_back_as_it_was_written(data_type, data):
    value = data.draw(st.integers(data_type.minimum, data_type.maximum))
    assert show(parse_value(str(value), data_type), data_type).startswith(f"{value} (0x")
    two_s_complement = f"0x{value % (1 << data_type.bits):X}"
    assert parse_value(two_s_complement, data_type) == parse_value(str(value), data_type)


@given(st.text(), st.sampled_from(list(DataType)))
def test_no_text_is_a_traceback(text, data_type):
    try:
        data = parse_value(text, data_type)
    except ConfigError:
        return
    assert isinstance(show(data, data_type), str)


@given(st.binary(max_size=300))
def test_any_bytes_can_be_shown_in_one_line_without_control_characters(data):
    assert show(data, None).isprintable()
    assert show(data, TEXT).isprintable()
