from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.lineclient import LineBuffer, too_many_values

lines = st.binary(min_size=1).map(lambda data: data.replace(b"\n", b" ").strip()).filter(bool)


def pieces_of(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [data[start:end] for start, end in itertools.pairwise(edges)]


def lines_of(buffer: LineBuffer) -> list[bytes]:
    return list(iter(buffer.next_line, None))


@given(st.lists(lines, max_size=4), st.lists(st.integers(0), max_size=30))
def test_any_split_of_the_stream_reassembles(sent, cuts):
    buffer = LineBuffer()
    received = []
    for piece in pieces_of(b"".join(line + b"\n" for line in sent), cuts):
        buffer.feed(piece)
        received += lines_of(buffer)
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


@pytest.mark.parametrize("line", [b"[" * 4097, b'{"a":[' + b"1," * 4096 + b"1]}", b'"' + rb"\u0041" * 4097 + b'"'])
def test_what_takes_long_to_decode_shows_without_decoding_it(line):
    assert too_many_values(line)
    assert not too_many_values(line[:4000])


@pytest.mark.parametrize("tail", [b"", b"\n", b"\nmore\n"])
def test_a_line_beyond_the_limit_stops_everything(tail):
    buffer = LineBuffer(limit=10)
    buffer.feed(b"0123456789\n01234567890" + tail)
    assert buffer.next_line() == b"0123456789"
    assert buffer.next_line() is None
    assert buffer.overflow
    buffer.feed(b"fine\n")
    assert buffer.next_line() is None


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
