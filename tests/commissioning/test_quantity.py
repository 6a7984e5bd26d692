import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.commissioning.quantity import JogScale, number_that, parse_quantity, whole_between
from canopen_control.errors import ConfigError

TOLD, GUESSED = JogScale(4096.0, is_known=True), JogScale(4096.0, is_known=False)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1", "velocity", 1.0),
        ("2rad/s", "velocity", 2.0),
        ("-60rpm", "velocity", -math.tau),
        ("4096 pps", "velocity", math.tau),
        ("1e3counts/s", "velocity", 1000 * math.tau / 4096),
        ("180deg", "position", math.pi),
        (".5turns", "position", math.pi),
        ("-1024counts", "position", -math.pi / 2),
    ],
)
def test_quantities_are_read_with_their_units(text, kind, value):
    assert TOLD.si(parse_quantity(text, kind)) == pytest.approx(value)


@pytest.mark.parametrize(
    ("text", "kind", "why"),
    [
        ("nan", "velocity", "is not a velocity that a drive could reach"),
        ("-infrpm", "velocity", "is not a velocity that a drive could reach"),
        ("1e999rad/s", "velocity", "is not a velocity that a drive could reach"),
        ("10knots", "velocity", "'knots' is not a unit of velocity; units: rad/s, rpm"),
        ("10rpm", "position", "'rpm' is not a unit of position; units: rad, deg"),
        ("fast", "velocity", "a number and its unit, such as 10rad/s"),
        ("", "position", "a number and its unit"),
    ],
)
def test_what_is_not_a_quantity_is_refused_with_what_there_is(text, kind, why):
    with pytest.raises(ConfigError, match=why):
        parse_quantity(text, kind)


def test_with_unknown_counts_per_turn_only_counts_are_accepted():
    assert GUESSED.si(parse_quantity("4096pps", "velocity")) == pytest.approx(math.tau)
    for text, kind in (("1rad/s", "velocity"), ("1rpm", "velocity"), ("90deg", "position"), ("1", "position")):
        with pytest.raises(ConfigError, match=r"the counts per turn \(0x608F\); give it with --counts N"):
            GUESSED.si(parse_quantity(text, kind))


def test_people_read_turns_where_these_are_known_and_counts_elsewhere():
    assert (TOLD.velocity_words(math.tau), TOLD.position_words(math.pi)) == ("6.28 rad/s (60.0 rpm)", "180.0 deg")
    assert TOLD.velocity_words(-1e-9) == "0.00 rad/s (0.0 rpm)"
    assert (GUESSED.velocity_words(math.tau), GUESSED.position_words(math.pi)) == ("4096 pps", "2048 counts")


def test_how_finely_a_drive_counts_is_not_known_of_a_joint_in_rad():
    assert TOLD.resolution == pytest.approx(math.tau / 4096)
    assert JogScale(math.tau, is_known=True, of_joint=True).resolution == 0.0


@given(st.floats(-1e6, 1e6), st.floats(1, 1e7))
def test_counts_return_as_they_were_whatever_a_turn_has(value, counts):
    scale = JogScale(counts, is_known=False)
    assert scale.si(parse_quantity(f"{value!r}counts", "position")) * counts / math.tau == pytest.approx(value)


@given(st.text(max_size=12), st.sampled_from(["position", "velocity"]))
def test_any_text_is_a_finite_quantity_or_a_sentence(text, kind):
    with contextlib.suppress(ConfigError):
        assert math.isfinite(parse_quantity(text, kind).value)


@pytest.mark.parametrize("text", ["0", "255", "x", "", "1.5"])
def test_a_whole_number_outside_is_refused(text):
    with pytest.raises(ConfigError, match=f"'{text}' is not a program"):
        whole_between(1, 254, "program")(text)


@pytest.mark.parametrize("text", ["-1", "nan", "inf", "x"])
def test_a_number_that_does_not_fit_is_refused(text):
    with pytest.raises(ConfigError, match=f"'{text}' is not a positive number"):
        number_that(lambda value: value > 0, "positive number")(text)
