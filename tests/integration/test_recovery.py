"""Drives that are killed, disconnected, faulted and power-cycled under a running robot: it stops, and resumes when
permitted.
"""

import pytest
from support.commander import Commander
from support.guest import scaled
from support.host import eventually
from support.localbus import hub_status
from support.processes import seconds_until

from canopen_control.bus.local import ask_hub
from canopen_control.client import RobotClient
from canopen_control.rpc.messages.hub import Cut, Uncut
from canopen_control.rpc.messages.robot import GetStatus

pytestmark = pytest.mark.timed

LEFT, RIGHT = 3, 2
SPEED = 10 / 0.003926990816987242  # microsteps/s at 10 rad/s
RAMP_S = SPEED / 16000  # by 0x6084 and 0x6085
HEARTBEAT_S = scaled(0.5)  # five of 100 ms
CYCLE_S = scaled(0.02)
SLACK_S = scaled(0.15)  # of a busy machine
CONTROLLERS = {"joint_state_broadcaster": "active", "robby_forward_controller": "active"}


class Turning:
    """A robot whose wheels turn under a commander that never rests; the drives are processes of their own."""

    def __init__(self, stage, probe, name):
        self.stage, self.name, self._probe = stage, name, probe
        self.drives = {node: stage.drive(name, node) for node in (LEFT, RIGHT)}
        self.robot = stage.robby(name, "--no-drives")
        self.commander = Commander(name)
        self.probes = {node: probe(name, node) for node in (LEFT, RIGHT)}
        self.client = RobotClient.connect(name)
        assert eventually(self.turns), self.texts()

    def turns(self):
        return all(abs(probe.speed) == pytest.approx(SPEED, rel=0.01) for probe in self.probes.values())

    def standing(self, *nodes):
        return all(abs(self.probes[node].speed) < 1 for node in nodes)

    def status(self):
        return self.client.ask(GetStatus())

    def texts(self):
        return [event.text for event in self.status().events]

    def is_back(self):
        status = self.status()
        assert status.controllers == CONTROLLERS, "never unloaded"
        return all(node.ready for node in status.nodes.values())

    def expect_stays_down(self, cycles=25):
        end = self.status().cycle.count + cycles

        def over():
            assert self.standing(*self.probes), "although somebody commands 10 rad/s"
            return self.status().cycle.count >= end

        assert eventually(over)

    def axis(self, *arguments):
        return self.stage.call("axis", *arguments, "--name", self.name).wait()

    def goes_on(self, *, reset=False):
        """Do what the policy asks for, and turn again."""
        if reset:
            assert self.axis("fault-reset", "all") == 0
            self.expect_stays_down(10)
        assert self.axis("enable", "all") == 0
        assert eventually(self.turns), self.texts()

    def end(self):
        self.commander.end()
        self.client.close()
        assert self.robot.end() == 0, self.robot


@pytest.fixture
def turning(stage, probe):
    robots = []

    def start(name):
        robots.append(Turning(stage, probe, name))
        return robots[-1]

    yield start
    for robot in robots:
        robot.end()


@pytest.mark.embedded
@pytest.mark.parametrize("seconds", [0.5, 5.0])
def test_a_cable_that_is_cut_for_a_while(turning, seconds):
    robby = turning(f"cut{round(seconds * 10)}")
    pid = robby.probes[LEFT].hello.pid
    label = next(member.label for member in hub_status(robby.name).members if member.pid == pid)
    ask_hub(robby.name, Cut(label))
    uncut = robby.status().cycle.count + seconds / CYCLE_S
    took = seconds_until(lambda: robby.standing(RIGHT), 5)
    assert took <= HEARTBEAT_S + CYCLE_S + RAMP_S + SLACK_S
    assert took <= 0.3 + RAMP_S + SLACK_S, "already its missing TPDOs stop the robot"
    assert eventually(lambda: robby.status().cycle.count >= uncut)
    ask_hub(robby.name, Uncut(label))
    assert eventually(robby.is_back)
    assert eventually(lambda: robby.standing(LEFT, RIGHT))
    robby.expect_stays_down()
    robby.goes_on(reset=True)


def test_a_drive_that_loses_its_power_for_a_moment_while_driving(turning):
    robby = turning("power")
    position = robby.status().joints["left_wheel_joint"].position
    robby.probes[LEFT].fault("spontaneous_reset")
    took = seconds_until(lambda: robby.standing(RIGHT), 5)
    assert took <= 2 * CYCLE_S + RAMP_S + SLACK_S
    assert eventually(robby.is_back)
    assert any("has restarted by itself" in text for text in robby.texts())
    robby.expect_stays_down()
    after = robby.status().joints["left_wheel_joint"].position
    assert 0 <= after - position < 10 * (took + 1), "continuous, although its counter began at 0 again"
    robby.goes_on()
