import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.client.teleop_keys import HELP, MOTIONS, SIDEWAYS, SPEEDS, KeyDecoder, Teleop, Velocities

MS = 1_000_000


def press(teleop, key, *times_ms):
    for at in times_ms:
        teleop.key(key, at * MS)


def moving(teleop, at_ms):
    teleop.tick(at_ms * MS)
    return teleop.velocities.moving


# -- keys


@pytest.mark.parametrize(
    ("key", "linear", "angular"),
    [("i", 1, 0), (",", -1, 0), ("j", 0, 1), ("l", 0, -1), ("u", 1, 1), ("o", 1, -1), ("m", -1, -1), (".", -1, 1)],
)
def test_the_keys_are_those_of_teleop_twist_keyboard(key, linear, angular):
    teleop = Teleop(0.5, 1.0)
    press(teleop, key, 0)
    assert teleop.velocities == Velocities(0.5 * linear, 1.0 * angular)


@pytest.mark.parametrize(("key", "linear", "lateral"), [(key, *motion) for key, motion in SIDEWAYS.items()])
def test_with_shift_a_base_that_can_drives_sideways(key, linear, lateral):
    teleop = Teleop(0.5, 1.0, sideways=True)
    press(teleop, key, 0)
    assert teleop.velocities == Velocities(0.5 * linear, 0.0, 0.5 * lateral)
    assert teleop.velocities.moving
    press(teleop, "k", 1)
    assert teleop.velocities == Velocities()


@pytest.mark.parametrize("key", ["k", "space", "other", "p", "5", "focus-out"])
def test_anything_else_stops_at_once(key):
    teleop = Teleop()
    press(teleop, "i", 0)
    press(teleop, key, 1)
    assert teleop.velocities == Velocities()
    assert not teleop.ended


def test_the_speeds_change_by_ten_percent_also_while_it_moves():
    teleop = Teleop(1.0, 1.0)
    press(teleop, "u", 0)
    for key in "qwx":
        press(teleop, key, 1)
    assert teleop.velocities.linear == pytest.approx(1.0 * 1.1 * 1.1 * 0.9)
    assert teleop.velocities.angular == pytest.approx(1.1)
    for key in "zec":
        press(teleop, key, 2)
    assert teleop.turn == pytest.approx(1.1 * 0.9 * 1.1 * 0.9)


def test_a_speed_key_does_not_keep_the_wheels_turning():
    teleop = Teleop()
    press(teleop, "i", 0)
    press(teleop, "q", *range(100, 700, 100))
    assert moving(teleop, 699)
    press(teleop, "q", 700)
    assert not moving(teleop, 700)


def test_no_number_of_presses_makes_a_speed_useless():
    teleop = Teleop(0.5, 1.0)
    press(teleop, "z", *[0] * 500)
    assert teleop.speed == teleop.turn == pytest.approx(1e-3)
    press(teleop, "q", *[0] * 500)
    assert teleop.speed == pytest.approx(1e3)


@pytest.mark.parametrize("key", ["J", "<", "t"])
def test_sideways_is_reported_to_be_unsupported_and_stops(key):
    teleop = Teleop()
    press(teleop, "i", 0)
    press(teleop, key, 1)
    assert not teleop.velocities.moving
    assert "sideways" in teleop.note
    press(teleop, "i", 2)
    assert teleop.note == ""


@pytest.mark.parametrize("key", ["ctrl-c", "ctrl-d"])
def test_ctrl_c_ends_it(key):
    teleop = Teleop()
    press(teleop, "i", 0)
    press(teleop, key, 1)
    assert teleop.ended
    assert not teleop.velocities.moving


def test_the_focus_that_returns_moves_nothing_and_stops_nothing():
    teleop = Teleop()
    press(teleop, "focus-in", 0)
    assert not teleop.velocities.moving
    press(teleop, "i", 1)
    press(teleop, "focus-in", 2)
    assert teleop.velocities.moving


# -- the dead-man


def test_a_tap_moves_for_the_first_time_only():
    teleop = Teleop(first=0.7, repeat=0.25)
    press(teleop, "i", 0)
    assert teleop.next_deadline() == 700 * MS
    assert moving(teleop, 699)
    assert not moving(teleop, 700)
    assert teleop.next_deadline() is None


@pytest.mark.parametrize("delay_ms", [250, 500, 660])
def test_a_held_key_moves_without_a_gap_and_stops_soon_after_its_release(delay_ms):
    teleop, at = Teleop(), 0
    press(teleop, "i", at)
    for at in range(delay_ms, 3000, 40):
        assert moving(teleop, at), at
        press(teleop, "i", at)
    assert moving(teleop, at + 249)
    assert not moving(teleop, at + 250)


def test_another_motion_starts_the_count_again():
    teleop = Teleop()
    press(teleop, "i", 0, 500, 540)
    press(teleop, "j", 580)  # the other key: its repetition rate is not known yet
    assert moving(teleop, 580 + 699)
    assert teleop.velocities == Velocities(0.0, 1.0)
    assert not moving(teleop, 580 + 700)


def test_a_key_after_the_end_of_a_hold_is_a_first_press_again():
    teleop = Teleop()
    press(teleop, "i", 0, 500)
    press(teleop, "i", 800)  # later than 250 ms: it had stopped meanwhile
    assert teleop.next_deadline() == 1500 * MS


keys = st.sampled_from([*MOTIONS, *SPEEDS, "k", "space", "other", "focus-in", "focus-out", "T"])


@given(st.lists(st.tuples(keys, st.integers(0, 2_000)), max_size=40))
def test_whatever_is_pressed_nothing_moves_longer_than_the_first_time_after_the_last_motion_key(presses):
    teleop, now, last = Teleop(), 0, None
    for key, gap in presses:
        now += gap
        press(teleop, key, now)
        last = now if key in MOTIONS else last
        assert not teleop.velocities.moving or now - last < 700
        assert (teleop.next_deadline() is not None) == teleop.velocities.moving
    assert not moving(teleop, now + 700)


# -- the decoder


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (b"i,K ", ["i", ",", "K", "space"]),
        (b"\x1b[A\x1b[B\x1bOC\x1bOD", ["up", "down", "right", "left"]),
        (b"\x1b[Oi\x1b[I", ["focus-out", "i", "focus-in"]),
        (b"\x03\x04\x1a\xc3", ["ctrl-c", "ctrl-d", "other", "other"]),
        (b"\x1b[1;5A\x1b[3~", ["other", "other"]),
        (b"\x1bi", ["other", "i"]),
    ],
)
def test_bytes_are_keys(data, expected):
    assert KeyDecoder().feed(data, 0) == expected


@given(st.lists(st.binary(max_size=4), max_size=8))
def test_any_split_gives_the_same_keys(pieces):
    whole, split = KeyDecoder(), KeyDecoder()
    expected = whole.feed(b"".join(pieces), 0) + whole.tick(10**9)
    result = [key for piece in pieces for key in split.feed(piece, 0)] + split.tick(10**9)
    assert result == expected


def test_a_lone_escape_is_a_key_after_a_moment():
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b", 0) == []
    assert decoder.tick(49 * MS) == []
    assert decoder.tick(50 * MS) == ["other"]
    assert decoder.next_deadline() is None


def test_a_sequence_without_end_does_not_grow():
    decoder = KeyDecoder()
    assert decoder.feed(b"\x1b[" + b"1" * 100, 0)[0] == "other"


def test_the_help_names_every_key_of_one_letter():
    assert all(key in HELP for key in [*MOTIONS, *SPEEDS] if len(key) == 1)
