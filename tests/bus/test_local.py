"""Local port: split data is reassembled, a slow hub costs the oldest frames, and a dead one is reported."""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.jsonserver import json_server, say
from support.localbus import TIMEOUT_S, hub_status, kill_hub, receive

from canopen_control.bus.error_frames import bus_off_frame, overrun_frame
from canopen_control.bus.local import LocalPort, ask_hub, greet, open_local
from canopen_control.bus.port import SEND_LIMIT, BusEventKind
from canopen_control.bus.subscription import HELLO_SIZE, VERSION, pack_hello
from canopen_control.errors import BusClosed, BusError, BusNotOpen, ConfigError
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import listen, socket_path
from canopen_control.rpc.messages.declare import Done
from canopen_control.rpc.messages.hub import Cut, GetHubStatus

ROOT = Path(__file__).parents[2]


def frame(number):
    return CanFrame(0x181, number.to_bytes(4, "little"))


@pytest.fixture
def wire():
    """A port and the hub's end of its connection."""
    ours, theirs = socket.socketpair()
    theirs.settimeout(TIMEOUT_S)
    port = LocalPort("test", ours, "me")
    yield port, theirs
    port.close()
    theirs.close()


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.integers(0, 0xFFFF), min_size=1, max_size=30), st.data())
def test_any_split_of_the_stream_reassembles(wire, numbers, data):
    port, hub = wire
    sent = [frame(number) for number in numbers]
    stream = pack_records(sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=20)))
    received, before = [], port.stats.rx
    for begin, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        hub.sendall(stream[begin:end])
        records = port.receive()
        assert len(records) % RECORD_SIZE == 0
        received += frames_of(records)
    assert received == sent
    assert port.stats.rx - before == len(sent)


def test_error_frames_pass_and_become_events_and_counters(wire):
    port, hub = wire
    hub.sendall(pack_records([frame(1), bus_off_frame(), overrun_frame(9)]))
    assert list(frames_of(port.receive())) == [frame(1), bus_off_frame(), overrun_frame(9)]
    assert [event.kind for event in port.events()] == [BusEventKind.BUS_OFF, BusEventKind.OVERRUN]
    assert (port.stats.errors, port.stats.lost) == (2, 9)


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_every_kind_of_buffer_is_sent_at_once(wire, kind):
    port, hub = wire
    port.send(kind(pack_records([frame(1), frame(2)])))
    assert list(frames_of(hub.recv(100))) == [frame(1), frame(2)]
    assert (port.stats.tx, port.stats.queued, port.wants_write) == (2, 0, False)


def drain(sock):
    data = b""
    while select.select([sock], [], [], 0)[0]:
        data += sock.recv(1 << 20)
    return data


@pytest.mark.rest
def test_what_the_kernel_does_not_take_waits_and_follows_in_order(wire):
    port, hub = wire
    count = 0
    while not port.wants_write:
        port.send(pack_records([frame(count + n) for n in range(1000)]))
        count += 1000
    assert port.stats.queued > 0
    stream = b""
    while port.wants_write:
        stream += drain(hub)
        port.flush()
    stream += drain(hub)
    assert list(frames_of(stream)) == [frame(n) for n in range(count)]
    assert (port.stats.lost, port.stats.queued) == (0, 0)


@pytest.mark.rest
def test_a_hub_that_does_not_read_costs_the_oldest_frames_and_they_are_counted(wire):
    port, hub = wire
    count = 0
    while port.stats.lost == 0:
        port.send(pack_records([frame(count + n) for n in range(1000)]))
        count += 1000
    assert port.stats.queued == SEND_LIMIT
    assert {event.kind for event in port.events()} == {BusEventKind.OVERRUN}
    stream = b""
    while port.wants_write:
        stream += drain(hub)
        port.flush()
    stream += drain(hub)
    numbers = [int.from_bytes(received.data, "little") for received in frames_of(stream)]
    assert numbers == sorted(numbers)
    assert numbers[-1] == count - 1
    assert len(numbers) + port.stats.lost == count


def test_when_the_hub_is_gone_each_verb_reports_this_and_an_event_once(wire):
    port, hub = wire
    hub.sendall(pack_records([frame(1)]))
    hub.close()
    assert list(frames_of(port.receive())) == [frame(1)]
    for verb in (port.receive, port.receive, lambda: port.send(pack_records([frame(2)]))):
        with pytest.raises(BusClosed, match="bus local:test: the hub process has ended; start this program again"):
            verb()
    assert [event.kind for event in port.events()] == [BusEventKind.CLOSED]
    assert port.events() == []


def test_a_closed_port_reports_that_it_was_closed_here(wire):
    port, _hub = wire
    port.close()
    port.close()
    assert port.fileno() == -1
    for verb in (port.receive, lambda: port.send(pack_records([frame(2)]))):
        with pytest.raises(BusClosed, match="closed on this side"):
            verb()
    assert port.events() == []


# Greeting


def answer(sock, data):
    def serve():
        sock.recv(HELLO_SIZE)
        sock.sendall(data)
        sock.close()

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


def test_a_hub_of_another_version_is_named():
    ours, theirs = socket.socketpair()
    thread = answer(theirs, pack_hello(4711, "", VERSION + 1))
    with pytest.raises(
        BusError, match=rf"hub \(process 4711\) uses protocol version {VERSION + 1}, this program {VERSION}"
    ):
        greet(ours, "x", "me")
    thread.join()
    assert ours.fileno() == -1


@pytest.mark.parametrize("data", [b"", b"short", bytes(HELLO_SIZE)])
def test_a_hub_that_goes_away_while_greeting_counts_as_none(data):
    ours, theirs = socket.socketpair()
    thread = answer(theirs, data)
    assert greet(ours, "x", "me") is None
    thread.join()
    assert ours.fileno() == -1


# With a hub process


@pytest.mark.process
def test_the_first_opener_starts_a_hub_that_is_not_its_child(runtime):
    a = open_local("one", "a")
    b = open_local("one", "b")
    status = hub_status("one")
    assert [(member.label, member.pid) for member in status.members] == [("a", os.getpid()), ("b", os.getpid())]
    parent = Path(f"/proc/{status.pid}/stat").read_text().rpartition(")")[2].split()[1]
    assert int(parent) != os.getpid()
    a.send(pack_records([frame(1), frame(2)]))
    assert receive(b, 2) == [frame(1), frame(2)]
    a.close()
    b.close()


@pytest.mark.process
def test_openers_that_race_start_one_hub(runtime):
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); from canopen_control.bus.local import open_local;"
        "port = open_local('race', sys.argv[2]); print('joined', flush=True); sys.stdin.read()"
    )
    children = [
        subprocess.Popen(
            [sys.executable, "-c", program, str(ROOT), f"opener{n}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        for n in range(4)
    ]
    try:
        assert [child.stdout.readline() for child in children] == [b"joined\n"] * 4
        assert {member.label for member in hub_status("race").members} == {f"opener{n}" for n in range(4)}
    finally:
        for child in children:
            child.communicate()
    assert [child.returncode for child in children] == [0] * 4


@pytest.mark.process
def test_a_killed_hub_is_noticed_and_the_next_opener_starts_another(runtime):
    port = open_local("dies", "a")
    kill_hub("dies")
    assert select.select([port], [], [], TIMEOUT_S)[0]
    with pytest.raises(BusClosed, match="the hub process has ended"):
        port.receive()
    port.close()
    assert socket_path("bus", "dies").exists(), "the stale socket is part of this test"
    again = open_local("dies", "a")
    assert hub_status("dies").members[0].label == "a"
    again.close()


@pytest.mark.process
def test_a_hub_that_cannot_start_is_one_sentence(runtime):
    listener = listen(socket_path("busctl", "taken"))
    with pytest.raises(BusError, match=r"bus local:taken: .*in use"):
        open_local("taken")
    listener.close()


def test_a_name_that_is_none_is_the_users_error(runtime):
    with pytest.raises(ConfigError):
        open_local("../etc")


# Asking the hub


@pytest.mark.process
def test_a_hub_answers(runtime):
    port = open_local("asked", "me")
    assert ask_hub("asked", GetHubStatus()).members[0].label == "me"
    assert ask_hub("asked", Cut("me")) == Done()
    assert ask_hub("asked", GetHubStatus()).cut == ["me"]
    with pytest.raises(ConfigError, match="no member called 'you' on local:asked; available: me"):
        ask_hub("asked", Cut("you"))
    port.close()


def test_a_bus_that_is_not_open_is_reported_to_be_so(runtime):
    with pytest.raises(BusNotOpen, match="bus local:none: no program has it open"):
        ask_hub("none", GetHubStatus())


def test_a_hub_of_another_version_is_not_an_error_of_the_request(runtime):
    reactor = Reactor()
    greet = lambda connection: say(connection, {"hello": {"bus": "old", "protocol": 1, "pid": 5}})  # noqa: E731
    server = json_server(reactor, socket_path("busctl", "old"), greet, lambda *_: None)
    thread = threading.Thread(target=reactor.run)
    thread.start()
    try:
        with pytest.raises(BusError, match="the hub of bus local:old speaks protocol 1, this client 2"):
            ask_hub("old", GetHubStatus())
    finally:
        reactor.call_threadsafe(reactor.stop)
        thread.join()
        server.close()
        reactor.close()
