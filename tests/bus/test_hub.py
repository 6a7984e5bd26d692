"""Hub on real sockets and a manual clock: it ends at most two seconds after its last member, and never blocks."""

from __future__ import annotations

import errno
import json
import os
import select
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.host import eventually
from support.jsonserver import line_of

from canopen_control.bus.hub import LINGER_NS, Hub
from canopen_control.bus.local import LocalPort, open_local
from canopen_control.bus.subscription import HELLO_SIZE, VERSION, pack_hello, parse_hello
from canopen_control.frame import CanFrame, frames_of, pack_records
from canopen_control.host.lineclient import LineClient
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import list_sockets, lock, peer_pid, socket_path
from canopen_control.host.timer import ManualClock

MS = 1_000_000


def frame(number, can_id=0x181):
    return CanFrame(can_id, number.to_bytes(4, "little"))


class Bench:
    """A hub in this process; `settle` lets it serve everything that is ready, without any time passing."""

    def __init__(self):
        self.reactor = Reactor(ManualClock(10**12))
        self.ended = []
        self.hub = Hub(self.reactor, "bench")
        self.hub.on_end = lambda: self.ended.append(self.reactor.now())
        self.open = []

    def settle(self):
        self.reactor.run_for(0)

    def connect(self):
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.open.append(sock)
        sock.connect(str(socket_path("bus", "bench")))
        return sock

    def join(self, label):
        sock = self.connect()
        sock.sendall(pack_hello(os.getpid(), label))
        self.settle()
        hello = parse_hello(sock.recv(HELLO_SIZE))
        port = LocalPort("bench", sock, hello.label, hello.abilities)
        self.open.append(port)
        return port

    def ask(self, method, **params):
        client = LineClient(socket_path("busctl", "bench"))
        client.send(line_of({"id": 7, "method": method, "params": params}))
        self.settle()
        hello, answer = json.loads(client.receive(1)), json.loads(client.receive(1))
        client.close()
        self.settle()
        assert hello["hello"]["bus"] == "bench"
        assert answer.pop("id") == 7
        return answer

    def close(self):
        for thing in self.open:
            thing.close()
        self.hub.close()
        self.reactor.close()
        assert self.reactor.errors == 0


@pytest.fixture
def bench(runtime):
    bench = Bench()
    yield bench
    bench.close()


def received(port):
    return list(frames_of(port.receive()))


def test_a_cycle_goes_through_and_comes_out_in_one_piece(bench):
    master, left, right = (bench.join(label) for label in ("master", "left", "right"))
    cycle = [CanFrame(0x80), *(frame(n, 0x200 + n) for n in range(1, 5))]
    master.send(pack_records(cycle))
    bench.settle()
    assert left.receive() == right.receive() == pack_records(cycle)
    left.send(pack_records([frame(1)]))
    right.send(pack_records([frame(2)]))
    bench.settle()
    assert sorted(received(master)) == [frame(1), frame(2)]
    assert received(left) == [frame(2)]


def test_a_subscriber_is_not_woken_for_other_frames(bench):
    master, left, right = (bench.join(label) for label in ("master", "left", "right"))
    left.set_filter([0x80, 0x202])
    right.send(pack_records([frame(1, 0x183)]))
    bench.settle()
    assert received(left) == []
    assert received(master) == [frame(1, 0x183)]
    left.set_filter({0x183: "anything"})
    left.send(pack_records([frame(2)]))
    right.send(pack_records([frame(3, 0x183)]))
    bench.settle()
    assert received(left) == [frame(3, 0x183)]
    assert left.stats.tx == 1


def test_a_greeting_and_frames_may_come_in_any_pieces(bench):
    reader = bench.join("reader")
    sock = bench.connect()
    stream = pack_hello(1, "slow") + pack_records([frame(n) for n in range(3)])
    for begin in range(0, len(stream), 7):
        sock.sendall(stream[begin : begin + 7])
        bench.settle()
    assert received(reader) == [frame(n) for n in range(3)]


def test_the_hub_is_gone_two_seconds_after_the_last_has_left(bench):
    port = bench.join("only")
    bench.reactor.run_for(10 * LINGER_NS)
    port.close()
    left = bench.reactor.now()
    bench.reactor.run_for(LINGER_NS - 1)
    assert bench.ended == []
    bench.reactor.run_for(1)
    assert bench.ended == [left + LINGER_NS]
    assert list_sockets("bus") == list_sockets("busctl") == []


def test_a_hub_that_is_not_joined_is_gone_after_two_seconds(bench):
    bench.reactor.run_for(LINGER_NS)
    assert len(bench.ended) == 1


def test_a_member_that_joins_within_two_seconds_keeps_it(bench):
    bench.join("first").close()
    bench.reactor.run_for(LINGER_NS // 2)
    second = bench.join("second")
    bench.reactor.run_for(5 * LINGER_NS)
    assert bench.ended == []
    second.close()
    bench.reactor.run_for(LINGER_NS)
    assert len(bench.ended) == 1


def test_a_hub_whose_folder_was_removed_ends_all_the_same(bench):
    port = bench.join("only")
    shutil.rmtree(socket_path("bus", "bench").parent)
    bench.reactor.run_for(2 * LINGER_NS)
    assert bench.ended == []
    port.close()
    bench.reactor.run_for(LINGER_NS)
    assert len(bench.ended) == 1
    assert bench.reactor.errors == 0


def test_it_does_not_end_while_an_opener_holds_the_lock(bench):
    with lock(socket_path("bus", "bench")):
        bench.reactor.run_for(2 * LINGER_NS)
        assert bench.ended == []
    bench.reactor.run_for(LINGER_NS)
    assert len(bench.ended) == 1


def test_an_opener_in_the_backlog_at_the_last_moment_is_served(bench):
    bench.reactor.run_for(LINGER_NS - 1)
    sock = bench.connect()
    sock.sendall(pack_hello(1, "late"))
    bench.hub._expire()
    assert bench.ended == []
    bench.settle()
    assert parse_hello(sock.recv(HELLO_SIZE)).label == "late"


def was_hung_up(sock):
    try:
        return sock.recv(1) == b""
    except ConnectionResetError:  # the hub left something unread
        return True


@pytest.mark.parametrize("data", [b"GET / HTTP/1.1\r\n" + bytes(60), bytes(HELLO_SIZE)], ids=["http", "zeros"])
def test_a_client_without_a_handshake_is_disconnected(bench, data):
    sock = bench.connect()
    sock.sendall(data)
    bench.settle()
    assert select.select([sock], [], [], 0)[0]
    assert was_hung_up(sock)


def test_a_silent_client_is_dropped_after_a_timeout_and_delays_no_other(bench):
    silent = bench.connect()
    a, b = bench.join("a"), bench.join("b")
    a.send(pack_records([frame(1)]))
    bench.settle()
    assert received(b) == [frame(1)]
    bench.reactor.run_for(10**10)
    assert silent.recv(1) == b""


def test_many_silent_clients_do_not_block_another_client(bench):
    crowd = []
    for _ in range(70):
        crowd.append(bench.connect())
        bench.settle()
    assert [sock.recv(1) for sock in crowd[:6]] == [b""] * 6  # the oldest frame was dropped
    bench.join("late").close()


def test_out_of_descriptors_it_retries_later_instead_of_spinning(bench):
    accepted = []

    def refuse():
        accepted.append(bench.reactor.now())
        raise OSError(errno.EMFILE, "Too many open files")

    listener = bench.hub._hello_server._listener
    bench.hub._hello_server._listener = SimpleNamespace(accept=refuse, fileno=listener.fileno, close=listener.close)
    bench.connect()
    bench.reactor.run_for(120 * MS)
    assert 2 <= len(accepted) <= 4
    bench.hub._hello_server._listener = listener
    bench.reactor.run_for(60 * MS)
    bench.join("late")


def test_another_version_is_answered_with_ours(bench):
    sock = bench.connect()
    sock.sendall(pack_hello(1, "future", VERSION + 1))
    bench.settle()
    assert parse_hello(sock.recv(HELLO_SIZE)) == (VERSION, os.getpid(), "", 0)
    assert sock.recv(1) == b""


@pytest.mark.rest
def test_a_stalled_reader_loses_only_its_own_frames_and_gets_their_number(bench):
    sender, quick, stalled = (bench.join(label) for label in ("sender", "quick", "stalled"))
    sent = 0
    (member,) = bench.hub.router.labelled("stalled")
    while member.lost == 0:
        batch = [frame(sent + n) for n in range(500)]
        sender.send(pack_records(batch))
        bench.settle()
        assert received(quick) == batch
        sent += 500
    assert quick.stats.lost == 0
    observed = []
    while records := stalled.receive():
        observed += [f for f in frames_of(records) if not f.is_error]
        bench.settle()
    assert observed == [frame(n) for n in range(len(observed))]
    assert len(observed) + stalled.stats.lost == sent
    assert stalled.stats.lost == member.lost
    sender.send(pack_records([frame(sent)]))
    bench.settle()
    assert received(stalled) == [frame(sent)]


def test_a_member_that_leaves_with_frames_in_transit_does_not_affect_others(bench):
    a, b, c = (bench.join(label) for label in "abc")
    b.close()
    a.send(pack_records([frame(1)]))
    bench.settle()
    assert received(c) == [frame(1)]
    assert [m["label"] for m in bench.ask("status")["result"]["members"]] == ["a", "c"]


def test_a_paced_wire_pushes_back_and_loses_nothing(bench):
    a, b = bench.join("a"), bench.join("b")
    bench.ask("bitrate", bitrate=1_000_000)
    count = 3000
    a.send(pack_records([frame(n) for n in range(count)]))
    observed = []
    for _ in range(10):
        bench.reactor.run_for(50 * MS)
        observed += received(b)
    assert observed == [frame(n) for n in range(count)]
    assert bench.ask("status")["result"]["load"] is not None


def test_delay_and_clear_through_the_control_socket(bench):
    a, b = bench.join("a"), bench.join("b")
    assert bench.ask("delay", label="a", ms=5) == {"result": {}}
    a.send(pack_records([frame(1)]))
    bench.reactor.run_for(5 * MS - 1)
    assert received(b) == []
    bench.reactor.run_for(1)
    assert received(b) == [frame(1)]
    bench.ask("cut", label="b")
    a.send(pack_records([frame(2)]))
    bench.reactor.run_for(10 * MS)
    assert received(b) == []
    bench.ask("clear")
    a.send(pack_records([frame(3)]))
    bench.settle()
    assert received(b) == [frame(3)]


def test_the_first_end_has_its_answer_before_the_control_socket_is_served(bench, monkeypatch):
    greeted = []
    sock = bench.connect()
    monkeypatch.setattr(bench.hub, "_serve_control", lambda: greeted.append(sock.recv(HELLO_SIZE)))
    sock.sendall(pack_hello(1, "first"))
    bench.settle()
    assert [parse_hello(item).label for item in greeted] == ["first"]


@pytest.mark.process
def test_the_hub_needs_the_standard_library_alone_and_little_of_it():
    program = (
        f"import json, sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r});"
        "import canopen_control.bus.hub; print(json.dumps([*sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-I", "-S", "-c", program], capture_output=True, check=True)
    loaded = {name.partition(".")[0] for name in json.loads(done.stdout)}
    assert "canopen_control" in loaded
    assert not loaded & {"can", "numpy", "yaml", "asyncio", "dataclasses", "inspect", "msgspec"}


@pytest.mark.process
def test_what_the_control_socket_needs_is_loaded_before_anybody_asks(runtime):
    port = open_local("early", "me")
    pid = peer_pid(port._socket)
    assert eventually(lambda: "msgspec" in Path(f"/proc/{pid}/maps").read_text())
    port.close()
