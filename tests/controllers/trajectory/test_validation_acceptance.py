import pytest

from canopen_control.controllers.trajectory.goal import ResultCode
from canopen_control.controllers.trajectory.joint_group import JointGroup
from canopen_control.controllers.trajectory.params import TrajectoryParams
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.controllers.trajectory.validation import Acceptance, PointBuffer
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.urdf.joint_element import Joint, UrdfLimits

S = 1_000_000_000
JOINTS, HERE = ("a", "b"), [0.0, 0.0]


class Counted(PointBuffer):
    """Counts how many points are made."""

    made = 0

    def __getitem__(self, index):
        self.made += 1
        return super().__getitem__(index)


def acceptance(lower=-3.0, upper=3.0, kind="revolute"):
    params = TrajectoryParams(joints=JOINTS, command_interfaces=("position",), state_interfaces=("position",))
    group = JointGroup(JOINTS, JOINTS, ("position",), ("position",))
    commands = [CommandInterface(joint, "position") for joint in JOINTS]
    group.set_interfaces(commands, [StateInterface(joint, "position", 0.0) for joint in JOINTS])
    group.read()
    joints = {joint: Joint(joint, kind, "", "", limits=UrdfLimits(lower, upper, 2.0)) for joint in JOINTS}
    return Acceptance(params, group, joints), commands


def packed(count, position=lambda index: [0.0, 0.0]):
    counted = Counted()
    for at in range(0, count, 80):
        indices = range(at, min(at + 80, count))
        counted.add([TrajectoryPoint(positions=position(item), time_from_start=float(item)) for item in indices])
    return JointTrajectory(JOINTS, counted)


@pytest.mark.parametrize("count", [1, 500, 20_000])
def test_its_length_costs_the_answer_nothing(count):
    judge, _ = acceptance()
    message = packed(count)
    assert judge.mistake(message, S, HERE) is None
    assert message.points.made <= 3


@pytest.mark.parametrize("wrong", [0, 79, 80, 499])
def test_what_is_beyond_a_limit_is_found_among_many_and_only_its_piece_is_looked_through(wrong):
    judge, _ = acceptance()
    message = packed(500, lambda index: [0.0, 3.5 if index == wrong else 0.0])
    assert (
        judge.mistake(message, S, HERE).text
        == f"point {wrong}: b at 3.5 is beyond its limits of -3 to 3; plan within them"
    )
    assert message.points.made <= 90


def test_limits_of_the_interfaces_count_alongside_those_of_the_description():
    judge, commands = acceptance()
    commands[1].maximum = 1.0
    judge.apply_interface_limits()
    assert "beyond its limits of -3 to 1" in judge.mistake(packed(2, lambda index: [0.0, 1.5 * index]), S, HERE).text


def test_a_joint_has_its_limits_under_the_name_that_a_controller_exports_it_by():
    names = ("loops/a", "b")
    params = TrajectoryParams(joints=names, command_interfaces=("position",), state_interfaces=("position",))
    joints = {joint: Joint(joint, "revolute", "", "", limits=UrdfLimits(-3.0, 3.0, 2.0)) for joint in JOINTS}
    created = Acceptance(params, JointGroup(names, names, ("position",), ("position",)), joints)
    assert [(limit.upper, limit.velocity) for limit in created.limits.values()] == [(3.0, 2.0), (3.0, 2.0)]
    reported = created.mistake(JointTrajectory(names, [Point([4.0, 0.0], time=S)]), 0, [3.5, 0.0])
    assert "loops/a" in reported.text


def test_joints_that_turn_without_end_have_no_limits():
    judge, _ = acceptance(kind="continuous")
    assert judge.continuous == [True, True]
    assert judge.mistake(packed(8, lambda index: [0.0, 1.0 * index]), S, HERE) is None


def test_what_the_object_behind_cannot_hold_is_named():
    judge, commands = acceptance()
    commands[0].lowest, commands[0].highest = -1.0, 1.0
    text = judge.mistake(packed(3, lambda index: [-1.5 * (index == 1), 0.0]), S, HERE).text
    assert text == "it leads a to -1.5, and the range of a/position is -1 to 1; plan within this range"


def test_points_that_came_in_process_are_judged_too():
    judge, _ = acceptance()
    assert (
        "which is not a joint of this controller"
        in judge.mistake(JointTrajectory(["a", "c"], [Point([0.0, 0.0])]), S, HERE).text
    )


def test_an_error_has_the_code_that_a_goal_is_refused_with():
    judge, _ = acceptance()
    unknown = judge.mistake(JointTrajectory(["a", "c"], [Point([0.0, 0.0])]), S, HERE)
    beyond = judge.mistake(packed(2, lambda index: [0.0, 9.0 * index]), S, HERE)
    assert (unknown.code, beyond.code) == (ResultCode.INVALID_JOINTS, ResultCode.INVALID_GOAL)
