"""Durations as text, in scenarios and options."""

import pytest

from canopen_control.duration import nanoseconds_of, seconds_of

S = 1_000_000_000


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("1h", 3600.0), ("5min", 300.0), ("5s", 5.0), ("500ms", 0.5), (2, 2.0), (0.25, 0.25), ("1.5 s", 1.5)],
)
def test_durations_have_units(text, seconds):
    assert seconds_of(text) == seconds
    assert nanoseconds_of(text) == round(seconds * S)


@pytest.mark.parametrize("text", ["", "soon", "-1s", "5m", "1e3s", "nan", "9999999"])
def test_other_durations_are_refused(text):
    with pytest.raises(ValueError, match="not a time"):
        seconds_of(text)
