"""What an end wants to hear: it travels among the frames, in any number, and is none of them."""

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.bus.wanted import MARK, Wanted, pack_wanted
from canopen_control.frame import RECORD_SIZE, CanFrame, pack_records

FRAME = pack_records([CanFrame(0x181, b"\xff" * 8)])


@given(st.sets(st.integers(0, 0xFFFFFFFF), max_size=50))
def test_what_is_asked_for_is_what_is_heard(can_ids):
    wanted = Wanted()
    assert wanted.take(FRAME + pack_wanted(can_ids) + FRAME) == FRAME * 2
    assert wanted.ids == can_ids


def test_nothing_changes_before_the_last_identifier_is_there():
    wanted, asked = Wanted(), pack_wanted([0x80, 0x202, 0x602])
    assert wanted.ids is None
    wanted.take(asked[:RECORD_SIZE])
    assert wanted.ids is None
    wanted.take(asked[RECORD_SIZE:])
    assert wanted.ids == {0x80, 0x202, 0x602}
    wanted.take(pack_wanted([0x80]))
    assert wanted.ids == {0x80}


def test_who_asks_for_more_than_can_be_kept_hears_everything():
    wanted = Wanted()
    wanted.take(pack_wanted(range(5000)))
    assert wanted.ids is None


def test_data_that_look_like_the_mark_are_data():
    record = pack_records([CanFrame(0x181, MARK + b"abc")])
    assert Wanted().take(record + pack_wanted([])) == record
