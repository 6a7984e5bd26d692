import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.calibration.base_link import Driven, TypedEnds, parse_end, read_ends
from canopen_control.errors import ConfigError, ControlError

HERE = Driven((0.0, 0.0, 0.0))


@given(st.floats(-10, 10), st.floats(-10, 10), st.sampled_from([" ", ", ", ",", "\t"]))
def test_an_end_is_read_as_it_was_written(x, y, between):
    assert parse_end(f" {x!r}{between}{y!r}\n") == (x, y)


@given(st.text())
def test_whatever_is_typed_is_two_finite_numbers_or_a_sentence(text):
    with contextlib.suppress(ConfigError):
        assert all(map(math.isfinite, parse_end(text)))


def test_an_invalid_answer_is_asked_for_again():
    answers, reported = iter(["", "1", "nan 2", "0.01 -0.02"]), []
    ends = TypedEnds(lambda _prompt: next(answers), reported.append)
    ends.before("run 1")
    assert ends.end("run 1", HERE) == (0.01, -0.02)
    assert reported[0] == "run 1"
    assert ["is not an end" in item for item in reported[1:]] == [True, True]


def test_a_client_that_leaves_ends_it():
    def gone(_prompt):
        raise EOFError

    with pytest.raises(ControlError, match="standard input was closed"):
        TypedEnds(gone, print).before("run 1")


def test_a_file_gives_its_ends_in_order(tmp_path):
    path = tmp_path / "ends.txt"
    path.write_text("# measured\n0.01 0.02\n\n-0.03, 0.04  # second\n")
    reports = []
    ends = read_ends(path, 2, reports.append)
    ends.before("run 1")
    assert [ends.end("", HERE), ends.end("", HERE)] == [(0.01, 0.02), (-0.03, 0.04)]
    assert reports == ["run 1"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 0\nhere\n1\n", r"ends.txt:2: 'here' is not an end.*\n.*ends.txt:3: '1' is not an end"),
        ("0 0\n", "has 1 end positions for 2 squares"),
        (None, "cannot be read"),
    ],
)
def test_errors_of_a_file_are_reported_before_anything_moves(tmp_path, text, words):
    path = tmp_path / "ends.txt"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ConfigError, match=words):
        read_ends(path, 2, print)
