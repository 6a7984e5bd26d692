from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia402 import objects
from canopen_control.commissioning.object_rows import (
    TYPE_NAMES,
    LiveObject,
    bits_of,
    has_changed,
    is_scanned,
    parse_type,
    parse_value,
    rows_of,
    select_objects,
    show,
    statusword_bits,
    unit_of,
)
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry

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
    ("text", "data_type", "message"),
    [
        ("300", DataType.INTEGER8, "300 is not a valid INTEGER8: the range is -128 to 127"),
        ("0x1FF", DataType.INTEGER8, "511 is not a valid INTEGER8"),
        ("-1", U16, "-1 is not a valid UNSIGNED16"),
        ("1.5", U16, "expected a whole number"),
        ("ten", F32, "expected a number"),
        ("yes", DataType.BOOLEAN, "expected a whole number"),
        ("XY", DataType.DOMAIN, "write bytes in hexadecimal"),
        ("1e99", F32, "too large for REAL32"),
    ],
)
def test_what_the_type_cannot_hold_is_refused_in_words(text, data_type, message):
    with pytest.raises(ConfigError, match=message):
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
    with pytest.raises(ConfigError, match="no data type 'u9'; data types: bool, i8"):
        parse_type("u9")


@given(st.text(), st.sampled_from(list(DataType)))
def test_no_text_is_a_traceback(text, data_type):
    try:
        data = parse_value(text, data_type)
    except ConfigError:
        return
    assert isinstance(show(data, data_type), str)


OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


@pytest.mark.parametrize(
    ("index", "unit"),
    [
        (0x607A, "counts"),
        (0x60FF, "counts/s"),
        (0x6083, "counts/s^2"),
        (0x6077, "1/1000 of the rated torque"),
        (0x1017, "ms"),
        (0x1000, ""),
        (0x2000, ""),
        (0x6877 - 0x800 + 0x800, "1/1000 of the rated torque"),  # of the second axis
    ],
)
def test_objects_of_the_profile_have_units(index, unit):
    assert unit_of(OD, index, 0) == unit


def test_a_count_of_subindices_has_none():
    od = replace(OD, entries=dict(OD.entries))
    for subindex in (0, 1):
        od.add(Entry(objects.SOFTWARE_POSITION_LIMIT, subindex, "x", DataType.INTEGER32))
    assert [unit_of(od, objects.SOFTWARE_POSITION_LIMIT, value) for value in (0, 1)] == ["", "counts"]


def test_the_drive_reports_that_its_velocities_are_revolutions():
    od = replace(OD, entries=dict(OD.entries))
    unit = 0x00B44700  # revolutions per minute
    od.add(Entry(objects.SI_UNIT_VELOCITY, 0, "SI unit velocity", DataType.UNSIGNED32, default=unit))
    assert (unit_of(od, 0x60FF, 0), unit_of(od, 0x607A, 0)) == ("rpm", "counts")
    od.add(Entry(objects.SI_UNIT_VELOCITY, 0, "SI unit velocity", DataType.UNSIGNED32, default=unit | 0xFD << 24))
    assert unit_of(od, 0x60FF, 0) == "0.001 rpm"


def addresses(*words):
    return [entry.address for entry in select_objects(OD, words)]


@pytest.mark.parametrize(
    ("words", "result"),
    [
        (["0x6081"], [(0x6081, 0)]),
        (["6081", "0x1018:2"], [(0x1018, 2), (0x6081, 0)]),
        (["0x1018:0?"], [(0x1018, sub) for sub in range(5)]),
        (["profile velocity"], [(0x6081, 0)]),
        (["vendor-id"], [(0x1018, 1)]),
        (["identity*revision*"], [(0x1018, 3)]),
    ],
)
def test_objects_are_meant_by_address_pattern_or_name(words, result):
    assert addresses(*words) == result


def test_without_a_word_all_are_meant_by_address():
    assert addresses() == sorted(OD.entries)
    assert set(addresses("0x60*")) == {item for item in OD.entries if item[0] >> 8 == 0x60}


@pytest.mark.parametrize("word", ["0x6FFF", "0x1018:99", "nosuch", "zz*", ""])
def test_a_word_that_means_nothing_is_reported_with_what_may_be_written(word):
    with pytest.raises(ConfigError, match=r"no object .* in the EDS; write an address such as 0x6081"):
        addresses("0x6081", word)


def entry(default=None, access="rw", data_type=DataType.UNSIGNED16, **others):
    return Entry(0x2000, 0, "x", data_type, access, default=default, **others)


@pytest.mark.parametrize(
    ("object_", "value", "changed"),
    [
        (entry(5), 5, False),
        (entry(5), 6, True),
        (entry(None), 6, False),
        (entry(5, "ro"), 6, False),
        (entry(5, data_type=DataType.REAL32), 5.0, False),
        (entry("a", data_type=DataType.VISIBLE_STRING), "b", True),
    ],
)
def test_changed_is_what_can_be_written_and_is_not_the_default(object_, value, changed):
    assert has_changed(object_, value) is changed


@pytest.mark.parametrize(
    ("object_", "scanned"),
    [
        (entry(), True),
        (entry(access="wo"), False),
        (entry(data_type=DataType.DOMAIN), False),
        (entry(obj_flags=2), False),
        (entry(obj_flags=1), True),
    ],
)
def test_reading_everything_omits_objects_that_cannot_or_must_not_be_read(object_, scanned):
    assert is_scanned(object_) is scanned


def on(bits):
    return [bit.name for bit in bits if bit.on]


def test_a_statusword_has_the_bits_of_its_mode():
    assert on(statusword_bits(0x0637)) == [
        *("ready to switch on", "switched on", "operation enabled", "voltage enabled", "no quick stop", "remote"),
        "target reached",
    ]
    assert "speed is zero" in on(statusword_bits(0x1637, 3))
    assert statusword_bits(0x1637, "PV") == statusword_bits(0x1637, 3)
    assert statusword_bits(0x1637, "mode -3 (manufacturer)") == statusword_bits(0x1637)
    assert "set-point acknowledged" in on(bits_of(0x6041, 0, 0x1637, 1))


def test_other_objects_have_theirs_and_most_have_none():
    assert on(bits_of(0x6840, 0, 0x010F))[-1] == "halt"
    assert on(bits_of(0x6040, 0, 0x001F, 1)) == [
        *("switch on", "enable voltage", "no quick stop", "enable operation"),
        "new set-point",
    ]
    assert on(bits_of(0x1001, 0, 0x05)) == ["generic", "voltage"]
    assert on(bits_of(0x6502, 0, 0x05)) == ["PP", "PV"]
    assert on(bits_of(0x60FD, 0, 0x06)) == ["positive limit switch", "home switch"]
    assert bits_of(0x6083, 0, 500) == []
    assert bits_of(0x1001, 0, "text") == []
    assert bits_of(0x6041, 1, 3) == []


HELD = {(0x6041, 0): 0x0250, (0x1017, 0): 1600, (0x1A00, 1): 0x60410010}


def rows(*addresses):
    return rows_of(OD, [LiveObject(OD[address], HELD[address]) for address in addresses], 5)


def test_a_value_comes_with_its_unit_its_meaning_and_whether_it_is_the_default():
    status, speed, mapped = rows((0x6041, 0), (0x1017, 0), (0x1A00, 1))
    assert (status.value, status.meaning, status.changed) == ("0x0250", "SWITCH ON DISABLED", False)
    assert (speed.value, speed.unit, speed.default, speed.changed, speed.meaning) == ("1600", "ms", "0", True, None)
    assert mapped.meaning == "0x6041:00 Statusword, 16 bits"


def test_what_was_not_read_has_no_value_and_is_not_taken_for_changed():
    (unread,) = rows_of(OD, [LiveObject(OD[0x1017, 0])], 5)
    assert (unread.value, unread.meaning, unread.changed, unread.error) == (None, None, False, None)
    (refused,) = rows_of(OD, [LiveObject(OD[0x1017, 0], why="abort 0x06020000")], 5)
    assert (refused.value, refused.error) == (None, "abort 0x06020000")


def test_no_control_character_is_in_a_text():
    (name,) = rows_of(OD, [LiveObject(OD[0x1008, 0], "TMCM\x1b[2J")], 5)
    assert "\x1b" not in name.value
