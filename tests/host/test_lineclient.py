from __future__ import annotations

import contextlib
import itertools
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import LocalProtocolError, RemoteError
from canopen_control.host.lineclient import MAX_LINE, LineBuffer, LineClient, too_many_values
from canopen_control.host.sockets import close_listener, listen, socket_path


@pytest.fixture
def listener(run_folder):
    sock = listen(socket_path("robot", "robby"))
    sock.setblocking(True)
    yield sock
    close_listener(sock)


@pytest.fixture
def pair(listener):
    """A client and the bare socket that it talks to."""
    with LineClient(socket_path("robot", "robby"), label="robot robby") as client:
        server, _ = listener.accept()
        with server:
            yield client, server


def test_what_is_sent_is_a_line_and_a_line_is_received(pair):
    client, server = pair
    client.send(b'{"a":1}\n')
    assert server.recv(100) == b'{"a":1}\n'
    server.send(b'{"b": 2}\n{"c": 3}\n{"d"')
    assert client.receive() == b'{"b": 2}'
    assert client.receive(0) == b'{"c": 3}'
    assert client.receive(0) is None
    server.send(b": 4}\n")
    assert client.receive() == b'{"d": 4}'


def test_an_empty_bus_is_one_sentence(run_folder):
    with pytest.raises(RemoteError, match="robot x is not running") as caught:
        LineClient(socket_path("robot", "x"), label="robot x")
    assert caught.value.kind == "BusClosed"


def test_a_path_that_cannot_be_reached_is_a_sentence(tmp_path):
    with pytest.raises(RemoteError, match="cannot be reached"):
        LineClient(tmp_path / ("x" * 200))


def test_it_wakes_when_something_comes(pair):
    client, server = pair
    later = threading.Timer(0.01, server.send, (b'{"late": 1}\n',))
    later.start()
    assert client.receive(None) == b'{"late": 1}'
    later.join()


def test_the_other_sides_end_is_an_error_after_its_last_words(pair):
    client, server = pair
    server.send(b'{"last": 1}\n{"half"')
    server.close()
    assert client.receive() == b'{"last": 1}'
    with pytest.raises(RemoteError, match="robot robby has closed the connection; it was shut down or killed"):
        client.receive()
    with pytest.raises(RemoteError, match="closed") as caught:
        client.send(b"{}\n")
    assert caught.value.kind == "BusClosed"


def test_a_client_that_does_not_read_is_not_awaited_for_ever(pair):
    client, _ = pair
    big = b"x" * 60_000 + b"\n"

    def fill():
        for _ in range(100):
            client.send(big, 0.01)

    with pytest.raises(RemoteError, match=r"has not read for 0\.01 s; check whether it is stopped") as caught:
        fill()
    assert caught.value.kind == "Timeout"
    with pytest.raises(RemoteError, match="closed"):  # half a line has left: the connection is of no more use
        client.send(b"{}\n")


def test_a_long_message_arrives_whole(pair):
    client, server = pair
    received = bytearray()

    def read():
        while not received.endswith(b"\n"):
            received.extend(server.recv(1 << 16))

    reader = threading.Thread(target=read)
    reader.start()
    client.send(b"x" * 60_000 + b"\n")
    reader.join(60)
    assert received == b"x" * 60_000 + b"\n"


def test_what_is_too_long_is_the_callers_error(pair):
    with pytest.raises(LocalProtocolError, match="request to robot robby too long: 65537 bytes, more than 65536"):
        pair[0].send(b"x" * 65_536 + b"\n")
    pair[0].send(b"fine\n")


def test_an_endless_line_is_not_read_to_its_end(pair):
    client, server = pair

    def write():
        with contextlib.suppress(OSError):  # the client leaves in the middle, as it should
            server.sendall(b"x" * (MAX_LINE + 200_000))

    writer = threading.Thread(target=write)
    writer.start()
    with pytest.raises(RemoteError, match="longer than"):
        client.receive()
    client.close()
    writer.join(60)
    assert not writer.is_alive()


def test_closing_twice_and_using_it_afterwards_is_reported(pair):
    client, _ = pair
    client.close()
    client.close()
    assert client.fileno() == -1
    for use in (lambda: client.send(b"{}\n"), client.receive):
        with pytest.raises(RemoteError, match="closed"):
            use()


def test_hanging_up_wakes_a_thread_that_waits(pair):
    client, _ = pair
    observed = []

    def wait():
        with pytest.raises(RemoteError):
            client.receive(None)
        observed.append("woken")

    waiting = threading.Thread(target=wait)
    waiting.start()
    client.hang_up()
    waiting.join(60)
    assert observed == ["woken"]


# -- lines


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
