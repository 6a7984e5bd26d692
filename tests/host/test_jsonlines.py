from __future__ import annotations

import errno
import itertools
import os
import socket

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canopen_control.host import jsonlines, sockets
from canopen_control.host.jsonlines import LineServer, decode, encode
from canopen_control.host.reactor import ManualClock, Reactor
from canopen_control.host.sockets import SocketInUse, runtime_dir, socket_path

SECOND = 1_000_000_000


class Owner:
    """A server that echoes, and remembers what it was told."""

    def __init__(self, reactor, path, **options):
        self.connections, self.messages, self.closed = [], [], []
        self.server = LineServer(reactor, path, self.connections.append, self.on_message, self.on_close, **options)

    def on_message(self, connection, message):
        self.messages.append(message)
        connection.send(message)

    def on_close(self, connection):
        self.closed.append((connection.name, connection.reason))


@pytest.fixture
def owner(reactor, run_folder):
    owner = Owner(reactor, socket_path("robot", "robby"))
    yield owner
    owner.server.close()


@pytest.fixture
def small(reactor, run_folder):
    owner = Owner(reactor, socket_path("robot", "small"), limit=100_000)
    yield owner
    owner.server.close()


class Peer:
    def __init__(self, owner):
        self.socket = sockets.connect(owner.server.path)
        self.socket.setblocking(False)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, data):
        self.socket.sendall(data)

    def read(self):
        """Return what is there and whether the stream has ended."""
        data = b""
        while True:
            try:
                piece = self.socket.recv(1 << 20)
            except BlockingIOError:
                return data, False
            if not piece:
                return data, True
            data += piece

    def messages(self):
        return [decode(line) for line in self.read()[0].splitlines()]


@pytest.fixture
def peer(owner):
    with Peer(owner) as peer:
        yield peer


def test_a_message_reaches_the_owner_and_the_answer_the_peer(reactor, owner, peer):
    peer.send(b'{"id": 1}\n{"id": 2}\n')
    reactor.run_for(1)
    assert owner.messages == [{"id": 1}, {"id": 2}]
    assert peer.messages() == [{"id": 1}, {"id": 2}]


def test_the_owner_learns_who_it_is(reactor, owner, peer):
    reactor.run_for(1)
    (connection,) = owner.connections
    assert connection.name == "#1"
    assert connection.pid == os.getpid()
    assert owner.server.connections == [connection]
    assert connection.fileno() >= 0


def test_a_peer_that_leaves_is_told_of_once(reactor, owner, peer):
    reactor.run_for(1)
    peer.socket.close()
    reactor.run_for(1)
    assert owner.closed == [("#1", "gone")]
    assert owner.server.connections == []
    owner.connections[0].send({"a": 1})
    owner.connections[0].close()
    reactor.run_for(SECOND)
    assert owner.closed == [("#1", "gone")]


def test_a_peer_that_leaves_in_the_middle_of_a_line_is_just_gone(reactor, owner, peer):
    peer.send(b'{"half": ')
    peer.socket.close()
    reactor.run_for(1)
    assert owner.messages == []
    assert owner.closed == [("#1", "gone")]


@pytest.mark.parametrize(
    ("garbage", "sentence"),
    [
        (b"garbage\n", "not a JSON object on a line"),
        (b"[]\n", "this is a list"),
        (b"\xff\xfe\n", "utf-8"),
        (b"x" * (jsonlines.MAX_LINE + 1), "longer than"),
    ],
)
def test_garbage_is_answered_and_ends_the_connection(reactor, owner, garbage, sentence):
    with Peer(owner) as peer:
        peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
        peer.send(b'{"good": 1}\n')
        reactor.run_for(1)
        view = memoryview(garbage + b'{"never": "served"}\n')
        while view:
            try:
                view = view[peer.socket.send(view) :]
            except (BlockingIOError, BrokenPipeError):
                if not reactor.run_until(lambda: False, timeout_ns=1) and owner.closed:
                    break
        reactor.run_for(1)
        data, ended = peer.read()
    answers = [decode(line) for line in data.splitlines()]
    assert answers[0] == {"good": 1}
    assert answers[1]["error"]["kind"] == "RemoteProtocolError"
    assert sentence in answers[1]["error"]["message"]
    assert ended
    assert owner.messages == [{"good": 1}]
    assert owner.closed == [("#1", answers[1]["error"]["message"])]


def test_an_unread_end_of_the_stream_is_no_error(reactor, owner):
    with Peer(owner) as peer:
        peer.send(b"garbage\n" * 100)
    reactor.run_for(2 * SECOND)
    assert len(owner.closed) == 1


def test_a_slow_reader_is_dropped_and_the_reason_named(reactor, small):
    with Peer(small) as peer, Peer(small) as other:
        reactor.run_for(1)
        slow, fine = small.connections
        text = "x" * 10_000
        for number in range(1000):
            slow.send({"number": number, "text": text})
            fine.send({"number": number})
            assert slow.pending <= 100_000
            if slow.closed:
                break
        assert slow.reason == "slow"
        assert small.closed == []  # never from inside a send
        assert small.server.connections == [fine]
        reactor.run_for(1)
        assert small.closed == [("#1", "slow")]
        assert peer.read()[1]
        assert [message["number"] for message in other.messages()] == list(range(number + 1))


def test_what_the_kernel_does_not_take_at_once_comes_later_and_whole(reactor, small):
    with Peer(small) as peer:
        reactor.run_for(1)
        connection = small.connections[0]
        sent = []
        while not connection.pending:
            sent.append({"number": len(sent), "text": "y" * 1000})
            connection.send(sent[-1])
        sent.append({"last": True})
        connection.send(sent[-1])
        data = b""
        for _ in range(100):
            data += peer.read()[0]
            reactor.run_for(1)
            if not connection.pending:
                break
        data += peer.read()[0]
        assert [decode(line) for line in data.splitlines()] == sent
        assert connection.fileno() in reactor._watches
        assert reactor._watches[connection.fileno()].on_writable is None


def test_closing_waits_until_the_last_answer_has_left(reactor, small):
    with Peer(small) as peer:
        reactor.run_for(1)
        connection = small.connections[0]
        while not connection.pending:
            connection.send({"text": "z" * 1000})
        connection.close("enough")
        assert connection.closed
        connection.send({"never": 1})
        data, ended = peer.read()
        assert not ended
        reactor.run_until(lambda: bool(small.closed), timeout_ns=SECOND // 2)
        rest, ended = peer.read()
        assert ended
        assert (data + rest).endswith(b'z"}\n')
        assert small.closed == [("#1", "enough")]


def test_closing_does_not_wait_for_ever(reactor, small):
    with Peer(small):
        reactor.run_for(1)
        connection = small.connections[0]
        while not connection.pending:
            connection.send({"text": "z" * 1000})
        connection.close("enough")
        reactor.run_for(SECOND - 2)
        assert small.closed == []
        reactor.run_for(2)
        assert small.closed == [("#1", "enough")]
        assert connection.fileno() == -1


def test_a_peer_that_dies_while_the_last_answer_leaves_ends_it(reactor, small):
    with Peer(small) as peer:
        reactor.run_for(1)
        connection = small.connections[0]
        while not connection.pending:
            connection.send({"text": "z" * 1000})
        connection.close("enough")
        peer.socket.close()
        reactor.run_for(1)
        assert small.closed == [("#1", "enough")]


def test_sending_to_a_peer_that_has_died_is_no_error(reactor, owner, peer):
    reactor.run_for(1)
    peer.socket.close()
    owner.connections[0].send({"a": 1})
    owner.connections[0].send({"a": 1})
    reactor.run_for(1)
    assert owner.closed == [("#1", "gone")]


def test_a_line_encoded_once_goes_to_all(reactor, owner):
    with Peer(owner) as first, Peer(owner) as second:
        reactor.run_for(1)
        owner.server.broadcast({"n": 1})
        owner.server.broadcast({"n": 2}, [owner.connections[1]])
        owner.connections[0].send_encoded(encode({"n": 3}))
        assert first.messages() == [{"n": 1}, {"n": 3}]
        assert second.messages() == [{"n": 1}, {"n": 2}]


def test_dropping_while_broadcasting_skips_nobody(reactor, small):
    with Peer(small) as first, Peer(small) as second:
        reactor.run_for(1)
        small.connections[0].close()
        small.server.broadcast({"n": 1})
        reactor.run_for(1)
        assert first.messages() == []
        assert second.messages() == [{"n": 1}]


def test_one_who_floods_leaves_time_for_the_others(reactor, owner, peer):
    with Peer(owner) as other:
        peer.send(b"{}\n" * 5000)
        other.send(b'{"other": 1}\n')
        reactor.run_for(1)
        assert len(owner.messages) == 5001
        assert owner.messages.index({"other": 1}) <= 2 * 64


def test_a_message_that_makes_the_owner_raise_takes_no_other_with_it(run_folder):
    raised, served = [], []

    def on_message(connection, message):
        if "bad" in message:
            raise RuntimeError("owner's fault")
        served.append(message)

    with Reactor(ManualClock()) as loop:
        loop.on_error = raised.append
        server = LineServer(loop, socket_path("robot", "r"), lambda _: None, on_message)
        with sockets.connect(server.path) as peer:
            peer.sendall(b'{"bad": 1}\n{"n": 1}\n{"bad": 2}\n{"n": 2}\n')
            loop.run_for(1)
            assert served == [{"n": 1}, {"n": 2}]
            assert len(raised) == 2
            assert len(server.connections) == 1
        server.close()


def test_a_connection_closed_by_its_own_message_serves_no_more(reactor, run_folder):
    served = []

    def on_message(connection, message):
        served.append(message)
        connection.close("had enough")

    server = LineServer(reactor, socket_path("robot", "r"), lambda _: None, on_message)
    with sockets.connect(server.path) as peer:
        peer.sendall(b'{"n": 1}\n{"n": 2}\n')
        reactor.run_for(1)
    assert served == [{"n": 1}]
    server.close()


def test_the_sixty_fifth_is_turned_away(reactor, owner):
    peers = [Peer(owner) for _ in range(64)]
    reactor.run_for(1)
    with Peer(owner) as late:
        reactor.run_for(1)
        assert "too many" in late.messages()[0]["error"]["message"]
    assert owner.server.refused == 1
    assert len(owner.connections) == 64
    for peer in peers:
        peer.socket.close()
    reactor.run_for(1)
    assert len(owner.closed) == 64
    with Peer(owner):
        reactor.run_for(1)
        assert len(owner.server.connections) == 1


def test_another_user_is_turned_away(reactor, owner, monkeypatch):
    monkeypatch.setattr(sockets, "same_user", lambda sock: False)
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.connect(str(owner.server.path))
        reactor.run_for(1)
        assert owner.connections == []
        assert owner.server.refused == 1


def test_out_of_descriptors_it_pauses_instead_of_spinning(reactor, owner, monkeypatch):
    class Empty:
        calls = 0

        def __init__(self, real):
            self.fileno = real.fileno

        def accept(self):
            Empty.calls += 1
            raise OSError(errno.EMFILE, "too many open files")

    real = owner.server._socket
    with Peer(owner):
        owner.server._socket = Empty(real)
        reactor.run_for(SECOND)
        assert 1 < Empty.calls <= 11
        owner.server._socket = real
        reactor.run_for(SECOND)
        assert len(owner.connections) == 1


def test_closing_the_server_ends_all_and_removes_the_socket(reactor, owner, peer):
    reactor.run_for(1)
    owner.server.close()
    owner.server.close()
    assert owner.closed == [("#1", "closed")]
    assert peer.read() == (b"", True)
    assert not list(runtime_dir().glob("*.sock"))
    reactor.run_for(SECOND)
    assert len(owner.closed) == 1


def test_a_name_is_served_once(reactor, owner):
    with pytest.raises(SocketInUse, match=f"by process {os.getpid()}"):
        Owner(reactor, owner.server.path)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40, deadline=None)
@given(st.lists(st.integers(0), max_size=12))
def test_any_split_of_the_stream_gives_the_same_answers(reactor, owner, cuts):
    sent = [{"id": number, "text": "ä" * number} for number in range(8)]
    stream = b"".join(map(encode, sent))
    edges = sorted({0, len(stream), *(cut % len(stream) for cut in cuts)})
    with Peer(owner) as peer:
        for start, end in itertools.pairwise(edges):
            peer.send(stream[start:end])
            reactor.run_for(1)
        assert peer.messages() == sent
    reactor.run_for(1)
