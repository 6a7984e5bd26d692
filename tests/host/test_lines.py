from __future__ import annotations

import itertools
import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.lines import LineBuffer, decode, encode, encode_strict

scalars = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
values = st.recursive(scalars, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=6)
messages = st.dictionaries(st.text(), values, max_size=5)


def pieces_of(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[start:end] for start, end in itertools.pairwise(edges)]


def lines_of(buffer: LineBuffer) -> list[bytes]:
    return list(iter(buffer.next_line, None))


@given(messages)
def test_a_message_comes_back_as_it_was(message):
    line = encode(message)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert decode(line) == message
    assert encode_strict(message) == line


@given(st.lists(messages, max_size=4), st.lists(st.integers(0), max_size=30))
def test_any_split_of_the_stream_reassembles(sent, cuts):
    buffer = LineBuffer()
    received = []
    for piece in pieces_of(b"".join(map(encode, sent)), cuts):
        buffer.feed(piece)
        received += map(decode, lines_of(buffer))
    assert received == sent


@given(st.binary(max_size=200), st.lists(st.integers(0), max_size=30))
def test_any_split_of_garbage_gives_the_same_lines(stream, cuts):
    def read(pieces):
        buffer = LineBuffer(limit=20)
        lines = []
        for piece in pieces:
            buffer.feed(piece)
            lines += lines_of(buffer)
        return lines, buffer.overflow

    assert read(pieces_of(stream, cuts)) == read([stream])


@given(st.binary(max_size=60))
def test_a_line_decodes_or_is_refused_with_a_sentence(line):
    try:
        assert isinstance(decode(line), dict)
    except ValueError as error:
        assert str(error)  # noqa: PT017 - any of both is right


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        (b"[1]", "a message is a JSON object, this is a list"),
        (b"3", "this is a int"),
        (b"{", "Expecting property name"),
        (b'{"a": NaN}', "NaN is no JSON"),
        (b'{"a": -Infinity}', "-Infinity is no JSON"),
        (b"\xff{}", "utf-8"),
        (b'{"a":' * 100_000, "nested too deeply"),
        (b'{"a": ' + b"1" * 10_000 + b"}", "limit"),
    ],
)
def test_what_is_no_message_is_refused(line, sentence):
    with pytest.raises(ValueError, match=sentence):
        decode(line)


def test_what_is_not_finite_becomes_unknown():
    message = {"a": math.nan, "b": [1.5, math.inf, (-math.inf,)], "c": {"d": math.nan}, "e": "x"}
    assert json.loads(encode(message)) == {"a": None, "b": [1.5, None, [None]], "c": {"d": None}, "e": "x"}


def test_who_commands_must_not_send_what_is_not_finite():
    with pytest.raises(ValueError, match="JSON compliant"):
        encode_strict({"values": [math.nan]})


def test_text_of_any_kind_stays_on_one_line():
    line = encode({"text": "one\ntwo\r\n\u2028 \u00e4"})
    assert line.count(b"\n") == 1
    assert decode(line) == {"text": "one\ntwo\r\n\u2028 \u00e4"}


def test_half_a_surrogate_pair_can_be_answered():
    message = decode(b'{"text": "\\ud800"}')
    assert decode(encode(message)) == message


def test_empty_lines_are_skipped():
    buffer = LineBuffer()
    buffer.feed(b"\n\r\n  \n{}\r\n\n")
    assert [decode(line) for line in lines_of(buffer)] == [{}]


@pytest.mark.parametrize("tail", [b"", b"\n", b"\nmore\n"])
def test_a_line_beyond_the_limit_stops_everything(tail):
    buffer = LineBuffer(limit=10)
    buffer.feed(b"0123456789\n01234567890" + tail)
    assert buffer.next_line() == b"0123456789"
    assert buffer.next_line() is None
    assert buffer.overflow
    buffer.feed(b"fine\n")
    assert buffer.next_line() is None


def test_an_endless_line_does_not_grow_the_memory():
    buffer = LineBuffer(limit=1000)
    for _ in range(100):
        buffer.feed(b"x" * 500)
        buffer.next_line()
    assert len(buffer._data) <= 1000


def test_a_long_line_in_small_pieces_is_not_searched_over_and_over():
    class Counting(bytearray):
        searched = 0

        def find(self, what, start=0):
            Counting.searched += len(self) - start
            return super().find(what, start)

    buffer = LineBuffer()
    buffer._data = Counting()
    for _ in range(1000):
        buffer.feed(b"x" * 100)
        assert buffer.next_line() is None
    assert Counting.searched == 100_000
