"""Clients that misbehave, and unexpected frames: the robot continues unaffected."""

import contextlib
import random
import socket
import threading
import time

import pytest
from support.host import eventually
from support.processes import cycles_pass, seconds_until

from canopen_control.bus.channel import open_port
from canopen_control.client import RobotClient
from canopen_control.frame import RECORD
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages.robot import CommandController, GetStatus, Subscribe

pytestmark = pytest.mark.alone

# what drives and master of robby, or another master, send or listen to, beside what everybody does
USED = {
    0x000,
    0x080,
    0x100,
    *(base + node for node in (1, 2, 3) for base in range(0x80, 0x800, 0x80)),
    0x77F,
    0x7E4,
    0x7E5,
}


def raw(name):
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.settimeout(60)
    assert eventually(lambda: is_let_in(sock, name))
    return sock


def is_let_in(sock, name):
    try:
        sock.connect(str(socket_path("robot", name)))
    except BlockingIOError:  # too many wait at the door
        return False
    return True


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
            assert client.ask(GetStatus()).state in ("running", "disabled", "fault")
        port.close()
        cycles_pass(client, 11)
    assert robot.end() == 0 or "could not confirm that" in robot.err, robot.err  # forged frames hide the drives
    assert "Traceback" not in robot.out + robot.err


def test_a_crowd_of_idle_clients_makes_way_for_stop_and_status(stage):
    stage.robby("crowd")
    with contextlib.ExitStack() as stack, RobotClient.connect("crowd") as watching:
        watching.ask(Subscribe(state_rate=1.0))
        crowd = [stack.enter_context(raw("crowd")) for _ in range(120)]
        assert stage.call("status", "--name", "crowd").wait() == 0
        assert stage.call("stop", "--name", "crowd").wait() == 0
        assert watching.ask(GetStatus()).state == "disabled"
        reported = b"".join(sock.recv(4096) for sock in crowd[:40])
        assert reported.count(b"too many connections are open") == 40


def test_eight_hostile_clients_do_not_make_the_cycle_late(stage):
    stage.robby("hostile")
    with RobotClient.connect("hostile") as robot:
        before = robot.ask(GetStatus()).cycle
        floods = (
            b'{"id":1,"method":"status"}\n' * 50,
            b'{"x":[' + b"1.5," * 16_000 + b"1]}\n",
            b'{"id":1,"method":"layout"}\n' * 50,
            b"\n" * 60_000,
        )
        until, slowest = time.monotonic() + 3.0, 0.0
        attackers = [threading.Thread(target=flood, args=("hostile", floods[number % 4], until)) for number in range(8)]
        for attacker in attackers:
            attacker.start()
        while time.monotonic() < until:
            requested = time.monotonic()
            robot.ask(GetStatus())
            slowest = max(slowest, time.monotonic() - requested)
        for attacker in attackers:
            attacker.join()
        after = robot.ask(GetStatus()).cycle
    assert after.missed - before.missed < 0.2 * (after.count - before.count)  # it was eight of ten
    assert slowest < 1.0


def flood(name, lines, until):
    """Send the same again and again, on a new connection whenever one is ended."""
    while time.monotonic() < until:
        with contextlib.suppress(OSError), raw(name) as sock:
            sock.setblocking(False)
            while time.monotonic() < until:
                with contextlib.suppress(BlockingIOError):
                    sock.send(lines)
                try:
                    if not sock.recv(1 << 20):
                        break
                except BlockingIOError:
                    time.sleep(0.001)


def test_commands_of_two_clients_the_last_one_counts(stage):
    stage.robby("two")
    with RobotClient.connect("two") as one, RobotClient.connect("two") as other:
        one.ask(CommandController(controller="robby_forward_controller", values=[5, 5], source="one"))
        other.ask(CommandController(controller="robby_forward_controller", values=[2, 2], source="other"))
        velocities = lambda: [joint.velocity for joint in one.ask(GetStatus()).joints.values()]  # noqa: E731
        took = seconds_until(lambda: velocities() == pytest.approx([2, 2], rel=0.01), 1.5)
        assert took < 1.5
        assert one.ask(GetStatus()).commander == "other"
        begin = time.monotonic()
        seconds_until(lambda: velocities() == [0, 0], 5)
        assert 1.0 < time.monotonic() - begin < 2.5
