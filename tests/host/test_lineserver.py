from __future__ import annotations

import errno
import itertools
import json
import os
import socket

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.jsonserver import json_server, line_of, say
from support.properties import examples

from canopen_control.host import lineserver, sockets
from canopen_control.host.lineclient import MAX_REQUEST
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import runtime_dir, socket_path
from canopen_control.host.timer import ManualClock

SECOND = 1_000_000_000


class Owner:
    """A server that echoes, and records what it received."""

    def __init__(self, reactor, path, **options):
        self.connections, self.messages, self.closed = [], [], []
        self.server = json_server(reactor, path, self.connections.append, self.on_message, self.on_close, **options)

    def on_message(self, connection, message):
        self.messages.append(message)
        say(connection, message)

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
        return [json.loads(line) for line in self.read()[0].splitlines()]


@pytest.fixture
def peer(owner):
    with Peer(owner) as peer:
        yield peer


def test_the_owner_receives_its_identity(reactor, owner, peer):
    reactor.run_for(1)
    (connection,) = owner.connections
    assert connection.name == "#1"
    assert connection.pid == os.getpid()
    assert owner.server.connections == [connection]
    assert connection.fileno() >= 0


def test_a_peer_that_leaves_is_reported_once(reactor, owner, peer):
    reactor.run_for(1)
    peer.socket.close()
    reactor.run_for(1)
    assert owner.closed == [("#1", "gone")]
    assert owner.server.connections == []
    say(owner.connections[0], {"a": 1})
    owner.connections[0].close()
    reactor.run_for(SECOND)
    assert owner.closed == [("#1", "gone")]


def test_an_endless_line_is_answered_and_ends_the_connection(reactor, owner):
    with Peer(owner) as peer:
        peer.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 << 20)
        peer.send(b'{"good": 1}\n')
        reactor.run_for(1)
        view = memoryview(b"x" * (MAX_REQUEST + 1) + b'{"never": "served"}\n')
        while view:
            try:
                view = view[peer.socket.send(view) :]
            except (BlockingIOError, BrokenPipeError):
                if not reactor.run_until(lambda: False, timeout_ns=1) and owner.closed:
                    break
        reactor.run_for(1)
        data, ended = peer.read()
    answers = [json.loads(line) for line in data.splitlines()]
    assert answers[0] == {"good": 1}
    assert answers[1]["error"]["kind"] == "RemoteProtocolError"
    assert "longer than" in answers[1]["error"]["message"]
    assert ended
    assert owner.messages == [{"good": 1}]
    assert owner.closed == [("#1", answers[1]["error"]["message"])]


def test_a_slow_reader_is_dropped_and_the_reason_named(reactor, small):
    with Peer(small) as peer, Peer(small) as other:
        reactor.run_for(1)
        slow, fine = small.connections
        text = "x" * 10_000
        for number in range(1000):
            say(slow, {"number": number, "text": text})
            say(fine, {"number": number})
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
            say(connection, sent[-1])
        sent.append({"last": True})
        say(connection, sent[-1])
        data = b""
        for _ in range(100):
            data += peer.read()[0]
            reactor.run_for(1)
            if not connection.pending:
                break
        data += peer.read()[0]
        assert [json.loads(line) for line in data.splitlines()] == sent
        assert connection.fileno() in reactor._watches
        assert reactor._watches[connection.fileno()].on_writable is None


def closed_while_full(reactor, small):
    """Close the connection of the only peer while it has more to say than the peer has read."""
    reactor.run_for(1)
    connection = small.connections[0]
    while not connection.pending:
        say(connection, {"text": "z" * 1000})
    connection.close("enough")
    return connection


def test_closing_waits_until_the_last_answer_has_left(reactor, small):
    with Peer(small) as peer:
        connection = closed_while_full(reactor, small)
        assert connection.closed
        say(connection, {"never": 1})
        data, ended = peer.read()
        assert not ended
        reactor.run_until(lambda: bool(small.closed), timeout_ns=SECOND // 2)
        rest, ended = peer.read()
        assert ended
        assert (data + rest).endswith(b'z"}\n')
        assert small.closed == [("#1", "enough")]


def test_a_peer_that_dies_while_the_last_answer_leaves_ends_it(reactor, small):
    with Peer(small) as peer:
        closed_while_full(reactor, small)
        peer.socket.close()
        reactor.run_for(1)
        assert small.closed == [("#1", "enough")]


def test_lines_encoded_once_go_to_all(reactor, owner):
    with Peer(owner) as first, Peer(owner) as second:
        reactor.run_for(1)
        for connection in owner.server.connections:
            connection.send(b'{"n": 1}\n{"n": 2}\n')
        assert first.messages() == second.messages() == [{"n": 1}, {"n": 2}]


def test_a_client_that_ends_during_a_broadcast_does_not_affect_the_others(reactor, small):
    with Peer(small) as first, Peer(small) as second:
        reactor.run_for(1)
        small.connections[0].close()
        for connection in small.server.connections:
            say(connection, {"n": 1})
        reactor.run_for(1)
        assert first.messages() == []
        assert second.messages() == [{"n": 1}]


def test_a_client_that_floods_leaves_time_for_the_others(reactor, owner, peer):
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
        server = json_server(loop, socket_path("robot", "r"), lambda _: None, on_message)
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

    server = json_server(reactor, socket_path("robot", "r"), lambda _: None, on_message)
    with sockets.connect(server.path) as peer:
        peer.sendall(b'{"n": 1}\n{"n": 2}\n')
        reactor.run_for(1)
    assert served == [{"n": 1}]
    server.close()


ALL = 72
LATE = []
GRACE = SECOND // 2


def crowd(reactor, owner, count=ALL):
    peers = []
    for _ in range(count):
        peers.append(Peer(owner))
        reactor.run_for(1)
    assert len(owner.server.connections) == count
    return peers


def place_of(reactor, owner):
    """Come as one more, and return who had to leave, by number."""
    LATE.append(Peer(owner))
    reactor.run_for(1)
    assert LATE[-1].read() == (b"", False)
    return [int(name.removeprefix("#")) for name, _ in owner.closed]


def test_if_all_connections_are_in_use_silent_clients_are_closed_first_then_idle_ones(reactor, owner):
    peers = crowd(reactor, owner)
    for peer in [*peers[:10], *peers[11:20], *peers[21:]]:  # the eleventh and the twenty-first never ask
        peer.send(b'{"n": 1}\n')
        reactor.run_for(1)
    reactor.run_for(GRACE)
    peers[0].send(b'{"n": 2}\n')
    reactor.run_for(1)
    assert place_of(reactor, owner) == [11]
    assert place_of(reactor, owner) == [11, 21]
    assert place_of(reactor, owner) == [11, 21, 2]
    assert "too many connections are open" in peers[1].messages()[-1]["error"]["message"]
    assert {reason for _, reason in owner.closed} == {lineserver._EVICTED}
    assert len(owner.server.connections) == ALL
    for peer in peers:
        peer.socket.close()
    reactor.run_for(1)
    assert len(owner.server.connections) == 3
    while LATE:
        LATE.pop().socket.close()


def test_a_new_connection_stays_and_the_next_one_waits_in_the_backlog(reactor, owner):
    peers = [*crowd(reactor, owner), Peer(owner)]
    peers[-1].send(b'{"late": 1}\n')
    reactor.run_for(GRACE // 2)
    assert owner.messages == []
    reactor.run_for(GRACE)
    assert owner.messages == [{"late": 1}]
    for peer in peers:
        peer.socket.close()


def test_a_kept_or_waiting_client_is_not_closed_while_another_is_idle(reactor, run_folder):
    served = []
    server = json_server(
        reactor,
        socket_path("robot", "kept"),
        lambda _: None,
        lambda connection, message: served.append((connection, message)),
        may_idle=lambda connection: int(connection.name[1:]) <= 64,
    )
    holder = type("Holder", (), {"server": server})
    peers = crowd(reactor, holder)
    for peer in peers[64:]:
        peer.send(b'{"id": 1}\n')
    reactor.run_for(1)
    say(served[3][0], {"id": 1})  # only the sixty-eighth is answered
    reactor.run_for(2 * GRACE)
    with Peer(holder):
        reactor.run_for(1)
        assert peers[67].read()[1]  # has ended
    with Peer(holder):  # and without an idle client, the client that has waited longest
        reactor.run_for(1)
        assert peers[64].read()[1]
    assert not any(peer.read()[1] for peer in peers[:64])
    for peer in peers:
        peer.socket.close()
    server.close()


def test_a_flood_of_dear_requests_takes_a_millisecond_of_each_turn_and_a_newcomer_is_served_next(run_folder):
    """Each request takes 0.4 ms: three of them a turn, one of each peer, and a timer is late by no more than that."""
    clock = ManualClock()
    order = []

    def on_message(_connection, message):
        clock.now_ns += 400_000
        order.append(message["who"])

    with Reactor(clock) as loop:
        server = json_server(loop, socket_path("robot", "dear"), lambda _: None, on_message)
        holder = type("Holder", (), {"server": server})
        floods = [Peer(holder) for _ in range(8)]
        for number, peer in enumerate(floods):
            peer.send(f'{{"who": {number}}}\n'.encode() * 100)
        late = []

        def tick(due):
            late.append(clock.now_ns - due)
            loop.call_at(due + 5_000_000, lambda: tick(due + 5_000_000))

        loop.call_at(5_000_000, lambda: tick(5_000_000))
        loop.run_until(lambda: len(order) >= 100)
        with Peer(holder) as stop:
            stop.send(b'{"who": "stop"}\n' * 2)
            begin = len(order)
            loop.run_until(lambda: "stop" in order)
            assert order.index("stop") - begin <= 3
            loop.run_until(lambda: order.count("stop") == 2)
            assert len(order) - begin <= 16
        loop.run_until(lambda: len(order) >= 802)
        assert max(late) <= 1_400_000
        assert [order.count(number) for number in range(8)] == [100] * 8
        for peer in floods:
            peer.socket.close()
        server.close()


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


def test_out_of_descriptors_an_idle_client_is_closed_for_one_that_stops_the_robot(reactor, owner, monkeypatch):
    class Full:
        """A listener whose process may have as many descriptors as it has now."""

        def __init__(self, real, most):
            self.fileno, self._real, self._max = real.fileno, real, most

        def accept(self):
            if len(owner.server.connections) >= self._max:
                raise OSError(errno.EMFILE, "too many open files")
            return self._real.accept()

    real = owner.server._socket
    idle = [Peer(owner) for _ in range(8)]
    reactor.run_for(SECOND)
    owner.server._socket = Full(real, 8)
    with Peer(owner) as peer:
        peer.send(b'{"id": 1}\n')
        reactor.run_for(SECOND)
        assert peer.messages() == [{"id": 1}]
        assert len(owner.server.connections) == 7, "one more is free for a file"
    owner.server._socket = real
    for item in idle:
        item.socket.close()


def test_closing_the_server_ends_all_and_removes_the_socket(reactor, owner, peer):
    reactor.run_for(1)
    owner.server.close()
    owner.server.close()
    assert owner.closed == [("#1", "closed")]
    assert peer.read() == (b"", True)
    assert not list(runtime_dir().glob("*.sock"))
    reactor.run_for(SECOND)
    assert len(owner.closed) == 1


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=examples(40))
@given(st.lists(st.integers(0), max_size=12))
def test_any_split_of_the_stream_gives_the_same_answers(reactor, owner, cuts):
    sent = [{"id": number, "text": "ä" * number} for number in range(8)]
    stream = b"".join(map(line_of, sent))
    edges = sorted({0, len(stream), *(cut % len(stream) for cut in cuts)})
    with Peer(owner) as peer:
        for start, end in itertools.pairwise(edges):
            peer.send(stream[start:end])
            reactor.run_for(1)
        assert peer.messages() == sent
    reactor.run_for(1)
