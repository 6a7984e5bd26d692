"""Our own master at a judged device: robby in virtual time."""

import pytest
from support.simulated import S, setup_of

from canopen_control.bus.channel import open_port
from canopen_control.bus.memory import provide
from canopen_control.conformance import master_run
from canopen_control.conformance.master_run import MasterRun
from canopen_control.simulation.event_player import EventPlayer
from canopen_control.simulation.robot_under_test import RobotUnderTest, dictionary_of
from canopen_control.virtual.device import make_device
from canopen_control.virtual.scenario import ScenarioEvent

NODE = 2
COMMAND = ScenarioEvent(0, "command", "robby_forward_controller", for_ns=200 * S, values=(5.0, 5.0))


class Operator:
    """Resets faults and enables the drives between two faults."""

    def __init__(self, robot, run):
        self.player, self.run = EventPlayer(robot), run

    def act(self):
        state = self.run.judge.node.drives[0].state.name
        if self.run._stage is None and state != "OPERATION_ENABLED":
            name = "fault-reset" if state == "FAULT" else "enable"
            self.player.play(ScenarioEvent(0, "axis", "all", name=name))


@pytest.mark.rest
def test_robby_passes_in_virtual_time(monkeypatch):
    monkeypatch.setattr(master_run, "FIRST_NS", 3 * S)
    robot = RobotUnderTest(setup_of("robby"), 1)
    replaced = robot.drives.pop(NODE)
    actor = robot.actor("judge", robot.timings.drive)
    replaced.wire.members["judge"] = actor
    with provide(replaced.wire.name, replaced.wire):
        port = open_port(replaced.wire.channel, label="judge")
    run = MasterRun(actor.reactor, port, make_device(dictionary_of(replaced._eds), NODE), 120.0, lambda _line: None)
    operator = Operator(robot, run)
    robot.start()
    robot.run_for(S)
    operator.player.play(COMMAND)
    while not run.done:
        robot.run_for(S)
        operator.act()
        assert robot.errors == []
    run.close()
    actor.reactor.close()
    report = run.report()
    robot.close()
    assert {result.id: result.observed for result in report.results if result.verdict == "failed"} == {}
    skipped = {result.id for result in report.results if result.verdict == "skipped"}
    assert not any(check_id.startswith("MF") for check_id in skipped), skipped
    assert report.count("passed") >= 58
