"""Clients that misbehave, and frames that nobody sent: the robot goes on as if nothing was."""

import contextlib
import json
import random
import socket
import time

import pytest
from support.host import eventually
from support.processes import seconds_until

from canopen_control.bus.channel import open_port
from canopen_control.client import RobotClient
from canopen_control.errors import RemoteError
from canopen_control.frame import RECORD
from canopen_control.host.sockets import socket_path

# what drives and master of robby send or listen to, beside what everybody does
USED = {0x000, 0x080, 0x100, *(base + node for node in (1, 2, 3) for base in range(0x80, 0x800, 0x80)), 0x7E4, 0x7E5}

BUSY = ("sync_overrun",)  # what a machine that has no time brings about by itself


def raw(name):
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(10)
    assert eventually(lambda: is_let_in(sock, name))
    return sock


def is_let_in(sock, name):
    try:
        sock.connect(str(socket_path("robot", name)))
    except BlockingIOError:  # too many wait at the door
        return False
    return True


def test_garbage_on_the_bus_changes_nothing_but_a_counter(stage):
    robot = stage.robby("noise")
    stage.start("command", "robby_forward_controller", 10, 10)
    port = open_port("local:noise", label="noise")
    dice = random.Random(7)
    sent = 0
    with RobotClient.connect("noise") as client:
        joints = lambda: [each["velocity"] for each in client.call("status")["joints"].values()]  # noqa: E731
        assert eventually(lambda: joints() == pytest.approx([10, 10], rel=0.01))
        before = client.call("status")
        count = len(before["events"])
        while sent < 20_000:
            records = bytearray()
            for _ in range(100):
                identifier = dice.choice((dice.randrange(0x800), dice.randrange(1 << 29) | 0x80000000))
                if identifier not in USED:
                    records += RECORD.pack(identifier, dice.randrange(9), dice.randbytes(8))
            port.send(records)
            sent += len(records) // RECORD.size
            assert joints() == pytest.approx([10, 10], rel=0.01)
        assert eventually(lambda: client.call("status")["buses"]["can"]["unknown"] >= sent)
        after = client.call("status")
    port.close()
    assert after["state"] == "running"
    fresh = [event["text"] for event in after["events"][count:] if event["kind"] not in BUSY]
    assert fresh == []
    assert after["buses"]["can"]["unknown"] - before["buses"]["can"]["unknown"] == sent
    assert after["buses"]["can"]["lost"] == 0
    assert robot.end() == 0, robot


def test_garbage_in_the_name_of_the_drives_ends_nothing(stage):
    """Frames with the drives' own identifiers may fake whatever they like; the runtime lives and can be ended."""
    robot = stage.robby("forged")
    port = open_port("local:forged", label="forger")
    dice = random.Random(11)
    identifiers = sorted(USED - {0x000})
    with RobotClient.connect("forged") as client:
        for _ in range(300):
            port.send(
                b"".join(RECORD.pack(dice.choice(identifiers), dice.randrange(9), dice.randbytes(8)) for _ in range(10))
            )
            assert client.call("status")["state"] in ("running", "fault")
        port.close()
        begin = client.call("status")["cycle"]["count"]
        assert eventually(lambda: client.call("status")["cycle"]["count"] > begin + 10)
    assert robot.end() == 0, robot
    assert "Traceback" not in robot.out + robot.err


GARBAGE = (
    b"\x00\xff\xfe nonsense\n",
    b"[1, 2, 3]\n",
    b'{"id": 1, "method": "command", "params": {"controller": "robby_forward_controller", "values": [NaN, 1]}}\n',
    b"{" * 5000 + b"\n",
    b"x" * (3 << 20),
    b'{"id": 1, "method": "stat',
)


def test_clients_that_send_garbage_are_told_and_dropped(stage):
    stage.robby("garbled")
    with RobotClient.connect("garbled") as other:
        for line in GARBAGE:
            sock = raw("garbled")
            try:
                sock.sendall(line)
                sock.shutdown(socket.SHUT_WR)
                answer = sock.makefile("rb").read()
            except ConnectionError:  # dropped while it was still talking
                answer = b"error"
            finally:
                sock.close()
            assert b"error" in answer or line.endswith(b"stat"), line
        status = other.call("status")
    assert status["state"] == "running"
    assert not any(joint["command"] for joint in status["joints"].values())


BAD_REQUESTS = (
    {"method": "fly"},
    {"method": ["status"]},
    {},
    {"method": "command"},
    {"method": "command", "params": {"controller": 1, "values": "ab"}},
    {"method": "command", "params": {"controller": "robby_forward_controller", "values": [1e999, 1]}},
    {"method": "command", "params": [1]},
    {"method": "axis", "params": {"action": "explode", "node": "all"}},
    {"method": "axis", "params": {"action": "enable", "node": {"a": 1}}},
    {"method": "subscribe", "params": {"state_rate": -1}},
    {"method": "subscribe", "params": {"state_rate": "often"}},
    {"method": "switch", "params": {"activate": ["nobody"]}},
    {"method": "switch", "params": {"activate": 7}},
    {"method": "nmt", "params": {"command": "explode", "node": "all"}},
    {"method": "sdo_read", "params": {"node": "left_drive", "index": "x"}},
    {"method": "sdo_read", "params": {"node": "left_drive", "index": 1 << 40}},
    {"method": "sdo_read", "params": {"node": "left_drive", "index": 0x1000, "subindex": -1}},
    {"method": "sdo_write", "params": {"node": "left_drive", "index": 0x2000, "data": "xyz"}},
)


def test_every_bad_request_is_answered_with_an_error(stage):
    stage.robby("asked")
    for request in BAD_REQUESTS:
        sock = raw("asked")
        with sock, sock.makefile("rwb") as lines:
            assert b"hello" in lines.readline()
            lines.write((json.dumps({"id": 5, **request}) + "\n").replace("Infinity", "1e999").encode())
            lines.flush()
            answer = json.loads(lines.readline())
            assert answer["error"]["message"], request
            if "id" in answer:  # an answer, and not the end of the conversation
                lines.write(b'{"id": 6, "method": "status"}\n')
                lines.flush()
                assert json.loads(lines.readline())["result"]["state"] == "running"


def test_a_client_that_never_reads_is_dropped_and_the_cycle_does_not_mind(stage):
    stage.robby("slow")
    with raw("slow") as sock, RobotClient.connect("slow") as other:
        before = other.call("status")["cycle"]
        sock.sendall(b'{"method": "subscribe", "params": {"state_rate": 50, "events": true}}\n')
        with contextlib.suppress(ConnectionError):  # it may be dropped while it still asks
            for _ in range(200):
                sock.sendall(b'{"id": 1, "method": "description"}\n')
        dropped = lambda: [e for e in other.call("status")["events"] if e["kind"] == "client_dropped"]  # noqa: E731
        assert eventually(lambda: len(dropped()) == 1)
        assert "read too slowly" in dropped()[0]["text"]
        after = other.call("status")
    assert after["state"] == "running"
    assert after["cycle"]["missed"] - before["missed"] < 10  # none, where the machine has time


def test_a_crowd_of_clients_is_turned_away_at_the_door(stage):
    stage.robby("crowd")
    with RobotClient.connect("crowd") as first:
        with contextlib.ExitStack() as stack:
            crowd = [stack.enter_context(raw("crowd")) for _ in range(100)]
            greetings = [sock.recv(4096) for sock in crowd]
            assert sum(b"hello" in each for each in greetings) == 63  # sixty-four with the first
            assert sum(b"too many" in each for each in greetings) == 37
            assert first.call("status")["state"] == "running"
        assert eventually(lambda: can_connect("crowd"))


def can_connect(name):
    try:
        RobotClient.connect(name).close()
    except RemoteError:
        return False
    return True


def test_commands_of_two_clients_the_last_one_counts(stage):
    stage.robby("two")
    with RobotClient.connect("two") as one, RobotClient.connect("two") as other:
        one.call("command", controller="robby_forward_controller", values=[5, 5], source="one")
        other.call("command", controller="robby_forward_controller", values=[2, 2], source="other")
        velocities = lambda: [each["velocity"] for each in one.call("status")["joints"].values()]  # noqa: E731
        took = seconds_until(lambda: velocities() == pytest.approx([2, 2], rel=0.01), 1.5)
        assert took < 1.5
        assert one.call("status")["commander"] == "other"
        begin = time.monotonic()
        seconds_until(lambda: velocities() == [0, 0], 5)
        assert 1.0 < time.monotonic() - begin < 2.5
