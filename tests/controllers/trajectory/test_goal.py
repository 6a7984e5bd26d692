from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.trajectory.goal import ResultCode, TrajectoryGoal
from canopen_control.controllers.trajectory.point import JointTrajectory


def test_only_the_first_result_counts():
    goal = TrajectoryGoal(JointTrajectory(["a"], []))
    assert (goal.state, goal.ended) == (GoalState.EXECUTING, False)
    goal.end(GoalState.CANCELED, ResultCode.SUCCESSFUL, "cancelled")
    goal.end(GoalState.ABORTED, ResultCode.INVALID_GOAL, "too late")
    assert (goal.state, goal.code, goal.text, goal.ended) == (GoalState.CANCELED, 0, "cancelled", True)
