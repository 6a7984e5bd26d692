from dataclasses import replace

import pytest
from support.parameter_node import session_with

from canopen_control.commissioning.object_rows import EditHistory, limits_of, parsed_value, why_fixed
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
SPEED = (0x6081, 0)


def test_limits_are_those_of_the_eds_and_else_of_the_type():
    entry = Entry(0x2000, 0, "gain", DataType.INTEGER16, low=-5)
    assert limits_of(entry) == (-5, 32767)
    assert limits_of(Entry(0x2000, 0, "gain", DataType.REAL32)) == (None, None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("11", r"0x2000:00 gain accepts -5 to 10, not 11; nothing was written"),
        ("-6", "accepts -5 to 10"),
        ("70000", "0x2000:00 gain: value .*the range is -32768 to 32767; nothing was written"),
        ("fast", "'fast' is not a valid INTEGER16"),
        ("", "is not a valid INTEGER16"),
    ],
)
def test_a_value_that_the_object_cannot_take_is_refused_before_anything_is_sent(text, words):
    with pytest.raises(ConfigError, match=words):
        parsed_value(Entry(0x2000, 0, "gain", DataType.INTEGER16, low=-5, high=10), text)


def test_a_number_may_be_written_in_each_way():
    entry = Entry(0x2000, 0, "gain", DataType.INTEGER16)
    assert [parsed_value(entry, name) for name in ("10", " 0x0A ", "0xFFFF", "-1")] == [10, 10, -1, -1]
    assert parsed_value(Entry(0x2000, 0, "gain", DataType.REAL32), "0.5") == 0.5
    with pytest.raises(ConfigError, match=r"accepts at most 1\.0, not nan"):
        parsed_value(Entry(0x2000, 0, "gain", DataType.REAL32, high=1.0), "nan")


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ((0x6041, 0), "read-only"),
        ((0x6040, 0), "moves the axis"),
        ((0x60FF, 0), "moves the axis"),
        ((0x6060, 0), "moves the axis"),
        (SPEED, ""),
    ],
)
def test_values_that_are_never_written_by_hand(address, words):
    assert words in why_fixed(OD[address])
    assert bool(why_fixed(OD[address])) is bool(words)


def test_the_targets_of_a_second_axis_and_programs_and_domains_are_fixed_too():
    assert "moves the axis" in why_fixed(replace(OD[0x60FF, 0], index=0x68FF))
    assert "use Firmware" in why_fixed(Entry(0x1F51, 1, "Program control", DataType.UNSIGNED8))
    assert "DOMAIN" in why_fixed(Entry(0x2000, 0, "blob", DataType.DOMAIN))
    assert why_fixed(Entry(0x2000, 0, "name", DataType.VISIBLE_STRING, access="const")) == "is constant"


def test_an_edit_is_written_read_back_and_undone():
    session, history = session_with(OD), EditHistory()
    before = session.read_value(OD[SPEED])
    edit = history.write(session, OD[SPEED], "1234")
    assert edit.words == f"0x6081:00 Profile velocity: {before} -> 1234"
    history.write(session, OD[SPEED], "99")
    assert history.undo(session).words == "0x6081:00 Profile velocity: 99 -> 1234"
    assert history.undo(session).after == before
    with pytest.raises(ConfigError, match="no edit to undo"):
        history.undo(session)


def test_a_later_write_of_another_client_is_not_undone():
    session, history = session_with(OD), EditHistory()
    history.write(session, OD[SPEED], "1234")
    session.write_value(OD[SPEED], 77)
    with pytest.raises(DriveError, match="is 77 and not 1234 any more: another program has written it since"):
        history.undo(session)
    assert session.read_value(OD[SPEED]) == 77
    assert history.last is None


def test_what_the_drive_makes_another_value_of_is_reported_and_can_be_undone():
    session, history = session_with(OD), EditHistory()
    session.transfers.device.store.ceilings.inject({0x6081: 1})
    with pytest.raises(DriveError, match="1234 was written, but the drive reports 1"):
        history.write(session, OD[SPEED], "1234")
    assert history.undo(session).before == 1
