from canopen_control.controllers.command_life import GoalState
from canopen_control.controllers.trajectory.goal import Goal, ResultCode
from canopen_control.controllers.trajectory.point import JointTrajectory


def test_only_the_first_result_counts():
    goal = Goal(JointTrajectory(["a"], []))
    assert (goal.state, goal.ended) == (GoalState.EXECUTING, False)
    goal.end(GoalState.CANCELED, ResultCode.SUCCESSFUL, "cancelled")
    goal.end(GoalState.ABORTED, ResultCode.INVALID_GOAL, "too late")
    assert (goal.state, goal.code, goal.text, goal.ended) == (GoalState.CANCELED, 0, "cancelled", True)
