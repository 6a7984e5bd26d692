"""A robot of processes on any machine: run, stop, loss of a drive, fault, end. No time is checked.

The robot is robby with heartbeats that a busy machine keeps. What times have to be kept is tested by test_run,
test_deaths, test_recovery and test_verbs, on a machine that does nothing else.
"""

import contextlib
import json
import signal
from functools import partial

import pytest
from support.commander import Commander
from support.host import eventually
from support.processes import cycles_pass
from support.robots import PATIENT_ROBBY, copy_robby

from canopen_control.client import RobotClient
from canopen_control.rpc.messages.robot import GetStatus

LEFT, RIGHT = 3, 2
SPEED = 10 / 0.003926990816987242  # microsteps/s at 10 rad/s
HEARTBEATS = "heartbeat_multiplier: 5"
LONG_S = 60.0  # nothing here takes as long, whatever else the machine does


class Robot:
    """Robby, its drives as processes of their own, and a source that commands both wheels without a pause."""

    def __init__(self, stage, probe, folder, name, bus):
        self.stage, self.name, self._probe = stage, name, probe
        config = copy_robby(folder, bus=bus)
        self.drives = {node_id: stage.drive(name, node_id) for node_id in (LEFT, RIGHT)}
        self.program = stage.start("run", config, "--as", name, "--can", f"local:{name}", "--no-drives")
        self.program.until(f"{name} runs", LONG_S)
        self.probes = {node_id: probe(name, node_id) for node_id in (LEFT, RIGHT)}
        self.client = RobotClient.connect(name)
        self.commander = Commander(name)

    def start_drive(self, node_id):
        self.drives[node_id] = self.stage.drive(self.name, node_id)
        self.probes[node_id] = self._probe(self.name, node_id)

    @property
    def state(self):
        return self.client.ask(GetStatus()).state

    def axis(self, action):
        return self.stage.call("axis", action, "all", "--name", self.name, seconds=LONG_S)

    def turns(self):
        return all(abs(probe.speed) == pytest.approx(SPEED, rel=0.01) for probe in self.probes.values())

    def stands(self, *nodes):
        return all(abs(self.probes[node_id].speed) < 1 for node_id in nodes or self.probes)

    def reaches(self, condition):
        assert eventually(condition, LONG_S), [event.text for event in self.client.ask(GetStatus()).events][-12:]

    def stays_standing(self, *nodes):
        """Look whether the commands, which go on, move anything: three more of them, each with some cycles after it."""
        self.reaches(lambda: self.stands(*nodes))
        for sent in range(self.commander.sent + 1, self.commander.sent + 4):
            self.reaches(partial(self.commander.has_sent, sent))
            cycles_pass(self.client, 4)
            assert self.stands(*nodes)

    def close(self):
        self.commander.end()
        self.client.close()


@pytest.fixture
def start(stage, probe, tmp_path):
    with contextlib.ExitStack() as stack:

        def start(name, bus=PATIENT_ROBBY):
            robot = Robot(stage, probe, tmp_path, name, bus)
            stack.callback(robot.close)
            robot.reaches(robot.turns)
            return robot

        yield start


def test_wheels_turn_as_commanded_and_ctrl_c_stops_and_disables_them(start):
    robot = start("turns")
    status = json.loads(robot.stage.call("status", "--json", "--name", "turns").out)
    assert (status["robot"], status["state"]) == ("turns", "running")
    assert {axis["cia402_state"] for node in status["nodes"].values() for axis in node["axes"]} == {"OPERATION_ENABLED"}
    assert robot.program.end(signal.SIGINT, LONG_S) == 0, robot.program
    assert robot.stands()
    assert {probe.power for probe in robot.probes.values()} <= {"SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON"}
    assert "Traceback" not in robot.program.out + robot.program.err


def test_stop_holds_until_enable_although_a_client_keeps_commanding(start):
    robot = start("stops")
    assert robot.stage.call("stop", "--name", "stops", seconds=LONG_S).wait() == 0
    assert robot.stands()
    assert robot.state == "disabled"
    robot.stays_standing()
    assert robot.axis("enable").wait() == 0
    robot.reaches(robot.turns)


def test_a_drive_that_is_killed_stops_the_robot_is_named_and_returns_without_moving(start):
    robot = start("lost", {HEARTBEATS: "heartbeat_multiplier: 30", "missed_syncs: 10": "missed_syncs: 500"})
    robot.drives[LEFT].end(signal.SIGKILL)
    robot.reaches(lambda: robot.state == "fault")
    robot.stays_standing(RIGHT)
    robot.program.until("node 3 (left_drive): no heartbeat", LONG_S)
    refused = robot.axis("enable")
    assert refused.wait() == 1
    assert "left_drive" in refused.err
    robot.start_drive(LEFT)
    robot.reaches(lambda: all(node.ready for node in robot.client.ask(GetStatus()).nodes.values()))
    robot.stays_standing()
    assert robot.axis("enable").wait() == 0
    robot.reaches(robot.turns)


def test_a_fault_stops_the_robot_and_its_reset_moves_nothing(start):
    robot = start("fault")
    robot.probes[LEFT].fault("undervoltage")
    robot.reaches(lambda: robot.state == "fault")
    robot.stays_standing()
    assert "left_drive" in robot.program.out
    assert robot.axis("fault-reset").wait() == 1  # its cause lasts
    robot.probes[LEFT].fault("undervoltage", on=False)
    assert robot.axis("fault-reset").wait() == 0
    robot.reaches(lambda: robot.state == "disabled")
    robot.stays_standing()
    assert robot.axis("enable").wait() == 0
    robot.reaches(robot.turns)


def test_drives_stop_by_themselves_when_their_master_is_killed(start):
    robot = start("orphans", {HEARTBEATS: "heartbeat_multiplier: 30", "missed_syncs: 10": "missed_syncs: 500"})
    robot.program.end(signal.SIGKILL)
    assert eventually(robot.stands, LONG_S)
    assert {probe.power for probe in robot.probes.values()} == {"FAULT"}
    assert all(0x8130 in probe.state.errors for probe in robot.probes.values())  # CiA 301, heartbeat error


def test_commands_end_with_their_sender(start):
    robot = start("sender")
    robot.commander.end()
    robot.reaches(robot.stands)
    assert robot.state == "running"
