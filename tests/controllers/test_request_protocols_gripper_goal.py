from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.request_protocols import GripperGoal, GripStatus, StallDetector

MS = 1_000_000


def test_only_the_first_end_counts_and_is_reported_once():
    reports = []
    goal = GripperGoal(0.04, 20.0, ended_now=lambda: reports.append(1))
    goal.end(GoalState.SUCCEEDED, "reached", 0.039, 5.0, GripStatus.REACHED)
    goal.end(GoalState.ABORTED, "too late", 0.0, 0.0, GripStatus.STALLED)
    assert (goal.state, goal.text, goal.at, goal.effort) == (GoalState.SUCCEEDED, "reached", 0.039, 5.0)
    assert (goal.reached, goal.stalled, reports) == (True, False, [1])


def test_an_unknown_position_is_not_reported_as_reached():
    progress = StallDetector(0.01, 0.001, 1.0)
    progress.begin(0)
    assert progress.update(0, math.nan, math.nan) is GripStatus.MOVING
    assert progress.update(1001 * MS, math.nan, math.nan) is GripStatus.STALLED


@given(st.lists(st.tuples(st.floats(-1, 1), st.floats(-0.01, 0.01)), max_size=40))
def test_it_agrees_with_the_definition(steps):
    progress, moved = StallDetector(0.1, 0.002, 0.05), 0
    progress.begin(0)
    for number, (error, velocity) in enumerate(steps, 1):
        now = number * 10 * MS
        result = progress.update(now, error, velocity)
        if abs(error) < 0.1:
            assert result is GripStatus.REACHED
            continue
        moved = now if abs(velocity) > 0.002 else moved
        assert result is (GripStatus.STALLED if now - moved > 50 * MS else GripStatus.MOVING)
