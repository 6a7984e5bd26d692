"""Programs outside and a robot in virtual time: their connections are real, real time does not pass."""

import contextlib
import socket

import pytest
from support.simulated import FORWARD, Played, setup_of

from canopen_control.errors import RobotConfigError
from canopen_control.host.lineclient import LineBuffer
from canopen_control.host.sockets import list_sockets, socket_path
from canopen_control.rpc import wire
from canopen_control.rpc.messages.robot import ROBOT, CommandController, GetStatus, Stop, Subscribe
from canopen_control.simulation.invariants import Invariants
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.served_simulation import ServedSimulation
from canopen_control.simulation.simulation_run import SimulationRun


class Program:
    """A program at the socket of the robot, which reads only on request."""

    def __init__(self, name="robby"):
        self.sock = socket.socket(socket.AF_UNIX)
        self.sock.connect(str(socket_path("robot", name)))
        self.sock.setblocking(False)
        self._lines, self._number, self.ended = LineBuffer(), 0, False

    def ask(self, request):
        self._number += 1
        self.sock.sendall(wire.request_line(self._number, ROBOT.of(type(request)).name, request))

    def lines(self):
        try:
            while data := self.sock.recv(1 << 16):
                self._lines.feed(data)
            self.ended = True
        except BlockingIOError:
            pass
        except OSError:
            self.ended = True
        results = []
        while (line := self._lines.next_line()) is not None:
            results.append(bytes(line))
        return results

    def close(self):
        self.sock.close()


class Served(Played):
    def __init__(self):
        super().__init__()
        self.invariants = Invariants(self.robot, self.player, motions_of(self.robot.setup))
        self.served = ServedSimulation(self.player)
        self.programs = []

    def program(self):
        self.programs.append(Program())
        return self.programs[-1]

    def pass_by(self, seconds):
        for _ in range(round(seconds / 0.005)):
            self.run(0.005)
            self.served.wait(0.0)

    def close(self):
        for program in self.programs:
            program.close()
        self.served.close()
        super().close()


@pytest.fixture
def served():
    created = Served()
    yield created
    created.close()


def test_a_program_outside_is_answered_in_the_time_of_the_robot(served):
    program = served.program()
    program.ask(GetStatus())
    program.ask(Subscribe(state_rate=50.0))
    served.pass_by(0.5)
    lines = program.lines()
    assert any(b'"state":"running"' in line for line in lines)
    samples = [line for line in lines if b'"sim_time":' in line]
    assert len(samples) == pytest.approx(24, abs=3)
    assert all(b'"sim_epoch":0.0' in line for line in samples)
    assert list_sockets("robot") == ["robby"]


def test_what_it_commands_moves_the_robot_and_is_not_a_breach(served):
    program = served.program()
    program.ask(CommandController(controller=FORWARD, values=[5.0, 5.0]))
    served.pass_by(1.0)
    assert served.speed(2) > 1000.0
    program.ask(Stop())
    served.pass_by(1.0)
    assert served.speed(2) == 0.0
    assert served.invariants.breaches == []


def test_a_command_without_a_recorded_request_counts_as_one(served, monkeypatch):
    monkeypatch.setattr(served.player, "requested", lambda _act: None)
    program = served.program()
    program.ask(CommandController(controller=FORWARD, values=[5.0, 5.0]))
    served.pass_by(2.0)
    assert {breache.rule for breache in served.invariants.breaches} == {"motion_uncommanded"}


def test_a_command_dies_with_its_program(served):
    program = served.program()
    program.ask(CommandController(controller=FORWARD, values=[5.0, 5.0], dead_man=True))
    served.pass_by(0.3)
    assert served.speed(2) > 1000.0
    program.close()
    served.pass_by(0.5)
    assert served.speed(2) == 0.0
    assert "commander_gone" in served.kinds


def test_a_robot_that_is_killed_ends_its_connections_and_takes_new_ones_when_it_is_back(served):
    first = served.program()
    first.ask(GetStatus())
    served.pass_by(0.1)
    assert first.lines()
    served.do("kill", seconds=0.3)
    served.pass_by(0.05)
    assert (first.lines(), first.ended) == ([], True)
    early = served.program()
    served.pass_by(0.05)
    assert (early.lines(), early.ended) == ([], True)
    served.pass_by(1.5)
    second = served.program()
    second.ask(GetStatus())
    served.pass_by(0.1)
    assert any(b'"commander":' in line for line in second.lines())


def test_a_client_that_never_reads_is_dropped_and_blocks_no_other(served):
    program = served.program()
    program.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    with contextlib.suppress(BrokenPipeError):
        for _ in range(600):
            program.ask(GetStatus())
            served.pass_by(0.005)
    cycles = served.robot.core.pacer.count
    served.pass_by(0.4)
    assert served.robot.core.pacer.count - cycles == pytest.approx(20, abs=1)
    program.lines()
    assert program.ended


def test_the_name_of_a_robot_that_runs_is_refused(served):
    with pytest.raises(RobotConfigError, match="a robot named robby is already running"):
        ServedSimulation(served.player)


def test_a_simulation_that_is_served_waits_by_serving_and_ends_with_its_socket(monkeypatch):
    run = SimulationRun(setup_of(), 1, ())
    run.served = ServedSimulation(run.player)
    waits = []
    monkeypatch.setattr(ServedSimulation, "wait", lambda _self, seconds: waits.append(seconds))
    run.run(100_000_000)
    assert waits == [0.0] * 20
    run.close()
    assert list_sockets("robot") == []


def test_time_passes_no_faster_than_it_is_allowed_to(served, monkeypatch):
    waits = []
    monkeypatch.setattr(ServedSimulation, "wait", lambda _self, seconds: waits.append(seconds))
    served.served.run(50_000_000, speed=0.001)
    assert len(waits) == 10
    assert waits[-1] > 40.0
