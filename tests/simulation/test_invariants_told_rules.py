import sys

import pytest
from support.simulated import Judged, S

from canopen_control.controllers.manager import ControllerManager
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.simulation.invariants import ToldRules


@pytest.fixture
def judged():
    made = Judged(lambda judged, views, tell: ToldRules(judged.robot, views, tell))
    yield made
    made.close()


def test_the_truth_is_no_news(judged):
    judged.drive(5.0, 5.0).run(1.0).do("fault", 3, 0.5, name="drive_fault").run(1.0).do("power", 2, 1.0).run(4.0)
    assert judged.told == []


@pytest.mark.sources
def test_running_while_a_drive_is_in_fault_or_silent_is_told_once(judged, monkeypatch):
    monkeypatch.setattr(RobotCore, "state", property(lambda self: RobotState.RUNNING))
    judged.do("fault", 3, name="drive_fault").run(1.5)
    assert judged.told == [("state_told", "running, and node 3 is in fault")]
    judged.do("power", 2).run(2.0)
    assert judged.told[1:] == [("state_told", "running, and node 2 is silent")]


def test_an_error_of_the_program_is_told(judged):
    judged.robot.errors.append(ValueError("no"))
    judged.rules.sampled(judged.robot.now_ns)
    judged.rules.sampled(judged.robot.now_ns)
    assert judged.told == [("program_error", "ValueError: no")]


def test_memory_that_grows_is_told(judged, monkeypatch):
    weights = iter((1000, 50_000, 80_000))
    monkeypatch.setattr(sys, "getallocatedblocks", lambda: next(weights))
    for minute in range(1, 4):
        judged.rules.sampled(judged.robot.now_ns + 61 * minute * S)
    assert judged.broken.count("memory") == 1


def test_a_latch_holds_until_it_is_released_whoever_leaves_or_restarts(judged):
    judged.do("latch").run(0.3).do("ask", seconds=0.2).run(0.5).do("kill", seconds=0.3).run(1.5)
    assert judged.robot.core.latch.held
    judged.do("release").run(0.5).do("axis", name="fault-reset").run(0.3).do("axis", name="enable").run(0.5)
    assert judged.told == []
    assert judged.robot.core.state is RobotState.RUNNING


@pytest.mark.parametrize(
    ("kind", "held", "words"), [("latch", None, "is not any more"), ("", "me", "nobody asked for it")]
)
def test_a_latch_that_is_lost_is_told_and_one_that_nobody_asked_for(judged, kind, held, words):
    if kind:
        judged.do(kind).run(0.3)
    judged.robot.core.latch.by = held
    judged.run(0.6)
    assert judged.broken == ["state_told"]
    assert judged.told[0][1].endswith(words)


@pytest.mark.sources
def test_running_is_a_lie_while_a_claimed_drive_is_off(judged, monkeypatch):
    monkeypatch.setattr(RobotCore, "state", property(lambda self: RobotState.RUNNING))
    judged.do("axis", name="disable").run(1.0)
    told = {f"running, and {side}_wheel_joint is claimed by a controller and off" for side in ("left", "right")}
    assert {text for _, text in judged.told} == told


@pytest.mark.sources
def test_a_command_is_not_taken_while_its_drives_are_off(judged, monkeypatch):
    judged.player.on_taken = judged.rules.taken
    judged.do("axis", name="disable").run(1.0).drive(5.0, 5.0, seconds=0.1).run(0.3)
    assert (judged.told, judged.player.refused) == ([], 1)
    monkeypatch.setattr(ControllerManager, "_require_enabled", lambda self, controller: None)
    judged.drive(5.0, 5.0, seconds=0.1).run(0.3)
    assert judged.broken == ["command_taken"]
