import pytest
from support.observers import Watch
from support.simulated import BASE, FORWARD, Judged

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.controller import (
    JointTrajectoryController,
    ToleranceMonitor,
    ToleranceResult,
)
from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.controllers.update_loop import UpdateLoop
from canopen_control.errors import ControlError
from canopen_control.hardware.system import CanopenSystem
from canopen_control.simulation.status_invariants import GoalInvariants, StatusInvariants

ARM = "arm_controller"
MISSED = ToleranceResult(GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED, "it was missed")
REACHED = ToleranceResult(GoalState.SUCCEEDED, ResultCode.SUCCESSFUL, "it was reached")


class Rules:
    """The goals, with the faces by which a shaft's place is known."""

    def __init__(self, judged, views, tell):
        self.faces = StatusInvariants(judged.robot, views, judged.disturbed, tell)
        self.goals = GoalInvariants(judged.robot, judged.player, self.faces, tell)
        judged.robot.observers.append(Watch(goal=self.goals.applied))
        self.requested = self.goals.requested

    def on_sample(self, now):
        self.faces.on_sample(now)
        self.goals.on_sample(now)


@pytest.fixture
def arm():
    created = Judged(Rules, "arm6")
    created.run(1.2).do("activate", ARM).run(0.4)
    yield created
    created.close()


@pytest.fixture
def judged():
    created = Judged(Rules)
    yield created
    created.close()


def go(arm, seconds=1.0):
    return arm.do("trajectory", ARM, seconds, values=(0.1, 0.1, 0.1, 0.1, 0.1, 0.1))


@pytest.mark.rest
def test_a_goal_that_ends_as_its_tolerances_specify_is_not_reported(arm):
    go(arm).run(2.0)
    go(arm).run(0.5).do("cancel", ARM).run(1.5)
    go(arm).run(0.5).do("stop").run(2.0)
    assert arm.collected == []


@pytest.mark.rest
@pytest.mark.sources
@pytest.mark.parametrize(
    ("verdict", "when", "words"),
    [
        (REACHED, lambda self: True, "is reported as reached, but joint_1 is off by"),
        (MISSED, lambda self: self.over, "is reported as missed, but all joints are within their tolerances"),
        (None, lambda self: True, "was reached but does not end"),
    ],
)
def test_a_goal_that_ends_otherwise_is_reported(arm, monkeypatch, verdict, when, words):
    monkeypatch.setattr(ToleranceMonitor, "verdict", lambda self, tolerances: verdict if when(self) else None)
    go(arm).run(0.3 if verdict is REACHED else 3.0)
    assert arm.broken
    assert set(arm.broken) == {"goal_wrong"}
    assert words in arm.collected[0][1]


@pytest.mark.rest
@pytest.mark.sources
@pytest.mark.parametrize("newer", [False, True])
def test_a_cancelled_trajectory_that_continues_is_reported_unless_something_newer_leads_it(arm, monkeypatch, newer):
    monkeypatch.setattr(JointTrajectoryController, "_brake", lambda self: None)
    go(arm, 2.5).run(0.5).do("cancel", ARM).run(0.2)
    assert arm.speed(2) > 1000
    if newer:
        go(arm, 3.0)
    arm.run(0.8)
    assert set(arm.broken) == (set() if newer else {"goal_wrong"})
    assert newer or arm.collected[0][1] == f"the goal of {ARM} was cancelled, but joint_1 still moves"


@pytest.mark.sources
def test_a_goal_that_a_stop_has_ended_reports_this(arm, monkeypatch):
    monkeypatch.setattr(UpdateLoop, "forget", lambda self, now, why: None)
    go(arm).run(0.5).do("stop").run(0.2)
    assert arm.broken == ["goal_wrong"]
    assert (
        "a stop has ended the goal of arm_controller, whose result is: joint_1 (joint_1_drive)" in arm.collected[0][1]
    )


@pytest.mark.sources
def test_a_switch_that_is_refused_changes_nothing(judged, monkeypatch):
    def refuse(self, start, stop):
        raise ControlError("not now")

    monkeypatch.setattr(CanopenSystem, "prepare_command_mode_switch", refuse)
    judged.do("activate", BASE).run(0.2)
    assert (judged.collected, judged.player.refused) == ([], 1)

    def tear(self, start, stop):
        judged.robot.core.manager.get(FORWARD).state = judged.robot.core.manager.get(BASE).state
        raise ControlError("not now")

    monkeypatch.setattr(CanopenSystem, "prepare_command_mode_switch", tear)
    judged.do("activate", BASE).run(0.2)
    assert judged.broken == ["switch_torn"]
