from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.service.object_rows import LiveObject, rows_of

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
HELD = {(0x6041, 0): 0x0250, (0x1017, 0): 1600, (0x1A00, 1): 0x60410010}


def rows(*addresses):
    return rows_of(OD, [LiveObject(OD[each], HELD[each]) for each in addresses], 5)


def test_a_value_comes_with_its_unit_its_meaning_and_whether_it_is_the_default():
    status, speed, mapped = rows((0x6041, 0), (0x1017, 0), (0x1A00, 1))
    assert (status.value, status.meaning, status.changed) == ("0x0250", "SWITCH ON DISABLED", False)
    assert (speed.value, speed.unit, speed.default, speed.changed, speed.meaning) == (
        "1600",
        "ms",
        "0",
        True,
        None,
    )
    assert mapped.meaning == "0x6041:00 Statusword, 16 bits"


def test_what_was_not_read_has_no_value_and_is_not_taken_for_changed():
    (unread,) = rows_of(OD, [LiveObject(OD[0x1017, 0])], 5)
    assert (unread.value, unread.meaning, unread.changed, unread.error) == (None, None, False, None)
    (refused,) = rows_of(OD, [LiveObject(OD[0x1017, 0], why="abort 0x06020000")], 5)
    assert (refused.value, refused.error) == (None, "abort 0x06020000")


def test_no_control_character_is_in_a_text():
    (name,) = rows_of(OD, [LiveObject(OD[0x1008, 0], "TMCM\x1b[2J")], 5)
    assert "\x1b" not in name.value
