import gc
import itertools
import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.control import Hardware, S, add
from support.trajectories import cases
from support.trajectory_player import Player

from canopen_control.controllers.command_timeout import GoalState
from canopen_control.controllers.limiters import SLOW_STOP
from canopen_control.controllers.manager import ControllerManager
from canopen_control.controllers.trajectory.goal import ResultCode, TrajectoryGoal
from canopen_control.controllers.trajectory.params import POINT_LIMITER, GoalTolerances
from canopen_control.controllers.trajectory.point import JointTrajectory, Point
from canopen_control.errors import ControlError, TrajectoryRefused
from canopen_control.hardware.interfaces import InterfaceRegistry
from canopen_control.rpc.messages.parameters import ParameterValue
from canopen_control.urdf.joint_element import Joint, UrdfLimits

CASES = cases("jtc_scenarios")
#: upstream's behaviour there is harmful; the tests below specify this package's behaviour
DEVIATES = {
    "stop trajectory rewritten in place while it runs": "the second stop jumps to where the time of the first one is",
    "goal tolerance on a continuous joint uses the short way": "a joint is commanded to another turn at once",
}


@pytest.mark.parametrize(
    "case", [item for item in CASES if item["name"] not in DEVIATES], ids=lambda case: case["name"]
)
def test_it_behaves_as_upstream_does(case):
    player = Player(case)
    assert player.configured == (case["expect"].get("configure") == "SUCCESS")
    if player.configured:
        assert player.controller.command_interface_names() == case["expect"]["claimed_command"]
        assert player.controller.state_interface_names() == case["expect"]["claimed_state"]
    for step, expect in zip(case["in"]["steps"], case["expect"].get("steps", ()), strict=True):
        wrong = player.play(step, expect)
        assert not wrong, (step, wrong)


def test_only_what_is_named_deviates():
    for name in DEVIATES:
        case = next(item for item in CASES if item["name"] == name)
        player = Player(case)
        steps = zip(case["in"]["steps"], case["expect"]["steps"], strict=True)
        assert any(player.play(step, expect) for step, expect in steps)


# ------------------------------------------------------------------------------------- ours: safer than upstream

JOINTS = ("a", "b")
TYPE = "joint_trajectory_controller/JointTrajectoryController"
MS = 1_000_000
BRAKES = {"decelerate_on_cancel": True, **{each: {"max_deceleration_on_cancel": 2.0} for each in JOINTS}}


class Arm:
    """Two joints that follow their commands within a cycle, under a controller that is active."""

    def __init__(self, limits=(-3.0, 3.0, 2.0), kind="revolute", **params):
        names = tuple(f"{joint}/position" for joint in JOINTS)
        self.hardware = Hardware(*names, states=(*names, *(f"{joint}/velocity" for joint in JOINTS)), name="arm")
        for interface in self.hardware.state_interfaces:
            interface.value = 0.0
        registry = InterfaceRegistry()
        registry.register(self.hardware)
        description = {item: Joint(item, kind, "", "", limits=UrdfLimits(*limits)) for item in JOINTS}
        self.manager = ControllerManager(registry, 100, description=description)
        inputs = {"command_interfaces": ["position"], "state_interfaces": ["position", "velocity"], **params}
        self.controller = add(self.manager, "arm", TYPE, joints=list(JOINTS), **inputs)
        self.now, self.events = S, []
        self.manager.switch(["arm"], now=self.now)

    def run(self, cycles=1):
        for _ in range(cycles):
            self.now += 10 * MS
            self.manager.update(self.now, 0.01)
            self.events += self.manager.events()
            for command in self.hardware.command_interfaces:
                if command.enabled and math.isfinite(command.value):
                    before = self.state(command.joint)
                    self.hardware.set(command.name, command.value)
                    self.hardware.set(f"{command.joint}/velocity", (command.value - before) / 0.01)

    def state(self, joint):
        return next(
            interface.value for interface in self.hardware.state_interfaces if interface.name == f"{joint}/position"
        )

    def positions(self):
        return [self.state(joint) for joint in JOINTS]

    def enable(self, joint, enabled=True):
        for interface in self.hardware.command_interfaces:
            if interface.joint == joint:
                interface.enabled = enabled

    def send(self, *points, names=JOINTS, **tolerances):
        """Send a goal through (time in s, position of both joints)."""
        created = [Point([p] * len(names), time=round(t * S)) for t, p in points]
        goal = TrajectoryGoal(JointTrajectory(names, created), GoalTolerances(**tolerances))
        self.controller.send_goal(goal, self.now)
        return goal


@pytest.fixture
def arm():
    return Arm()


def test_a_goal_is_reached_and_held(arm):
    goal = arm.send((0.5, 0.2), (1.0, 1.0))
    arm.run(99)
    assert not goal.ended
    arm.run(2)
    assert (goal.state, goal.code) == (GoalState.SUCCEEDED, ResultCode.SUCCESSFUL)
    arm.run(50)
    assert arm.positions() == [1.0, 1.0]


def test_a_joint_without_end_goes_to_a_goal_on_the_turn_on_which_it_is():
    arm = Arm(kind="continuous")
    goal, way = arm.send((3.0, 10.0)), [arm.positions()[0]]
    for _ in range(302):
        arm.run()
        way.append(arm.positions()[0])
    assert goal.state is GoalState.SUCCEEDED
    assert way[-1] == pytest.approx(10.0 - 4 * math.pi)
    assert max(abs(b - a) for a, b in itertools.pairwise(way)) < 0.02  # rad in 10 ms: 2 rad/s
    arm.run(50)
    assert arm.positions() == [way[-1]] * 2
    arm.send((2.0, 0.0))
    arm.run(250)
    assert arm.positions() == pytest.approx([0.0, 0.0], abs=1e-12)


def test_one_trajectory_after_the_other_never_leaps():
    """Each takes the place of the one before, also of one that is blended in."""
    for replacement in (False, True):
        arm = Arm(kind="continuous", allow_trajectory_replacement=replacement, allowed_start_tolerance=0.0)
        way = []
        for place in (10.0, -8.0, 0.5, 40.0):
            arm.send((3.0, place))
            for _ in range(150):
                arm.run()
                way.append(arm.positions()[0])
        assert max(abs(b - a) for a, b in itertools.pairwise(way)) < 0.06


def test_a_continuous_joint_whose_interface_has_ends_is_judged_by_them():
    arm = Arm(kind="continuous")
    arm.manager.switch([], ["arm"], now=arm.now)
    for interface in arm.hardware.command_interfaces:
        interface.minimum, interface.maximum = -3.0, 3.0
    arm.manager.switch(["arm"], now=arm.now)
    with pytest.raises(ControlError, match="a at 10 is beyond its limits of -3 to 3"):
        arm.send((9.0, 10.0))


def test_what_the_object_cannot_hold_is_judged_on_the_turn_on_which_the_joint_is():
    arm = Arm(kind="continuous")
    for interface in arm.hardware.command_interfaces:
        interface.lowest, interface.highest = -4.0, 4.0
    assert arm.send((3.0, 1000.0)).ended is False
    with pytest.raises(ControlError, match="a to 7, and"):
        arm.send((3.0, 1.0), (9.0, 7.0))


def test_a_joint_that_is_lost_ends_the_goal_with_its_name_and_nothing_is_commanded_to_any(arm):
    goal = arm.send((1.0, 1.0))
    arm.run(30)
    arm.enable("b", False)
    arm.run()
    assert (goal.state, goal.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    assert goal.text == "b: not enabled; enable it, then send the goal again"
    assert [event.kind for event in arm.events][-1] == "goal_aborted"
    assert all(math.isnan(item) for item in arm.hardware.values())


def test_after_an_enable_the_joints_are_held_where_they_are_and_never_where_they_were_going(arm):
    arm.send((1.0, 1.0))
    arm.run(30)
    arm.enable("b", False)
    arm.run(10)
    arm.hardware.set("b/position", -0.4)  # it sank
    arm.enable("b")
    where = arm.positions()
    for _ in range(100):
        arm.run()
        assert arm.hardware.values() == where
    assert where[1] == -0.4


def test_a_goal_for_a_joint_that_is_not_enabled_is_refused_with_its_name(arm):
    arm.enable("b", False)
    arm.run()
    with pytest.raises(ControlError, match="b: not enabled"):
        arm.send((1.0, 1.0))
    assert arm.controller.rejected == 1


def test_an_unknown_position_ends_the_goal_too(arm):
    goal = arm.send((1.0, 1.0))
    arm.run(10)
    arm.hardware.set("a/position", math.nan)
    arm.run()
    assert goal.text.startswith("a: its position is unknown")


@pytest.mark.parametrize(
    ("points", "text"),
    [
        ([(1.0, math.nan)], "the position of a is nan"),
        ([(5.0, 3.1)], "a at 3.1 is beyond its limits of -3 to 3"),
        ([(0.1, 1.0)], "it begins with a at 1 after 0.1 s, but a is at 0"),
        ([], "it has no points"),
        ([(1.0, 0.1), (0.5, 0.2)], "time_from_start must increase"),
    ],
)
def test_a_bad_goal_is_refused_and_nothing_moves(arm, points, text):
    running = arm.send((1.0, 1.0))
    arm.run(10)
    with pytest.raises(ControlError, match=text):
        arm.send(*points)
    assert not running.ended
    arm.run(100)
    assert arm.positions() == [1.0, 1.0]


def test_the_death_of_the_sender_ends_the_goal_in_a_decelerated_hold():
    arm = Arm(
        constraints={"decelerate_on_cancel": True, **{joint: {"max_deceleration_on_cancel": 2.0} for joint in JOINTS}}
    )
    goal = arm.send((1.0, 1.0))
    sender = arm.controller.command_timeout.holder = object()
    arm.controller.command_timeout.source = "test"
    assert arm.manager.running.clients_with_commands == {sender}
    arm.run(40)
    where = arm.positions()[0]
    arm.manager.running.client_disconnected(sender)
    assert goal.state is GoalState.ABORTED
    assert "test" in goal.text
    steps = []
    for _ in range(100):
        before = arm.positions()[0]
        arm.run()
        steps.append(arm.positions()[0] - before)
    assert steps == sorted(steps, reverse=True)
    assert arm.positions()[0] == pytest.approx(where + 1.0 / (2 * 2.0), abs=0.02)  # v^2/2a


def test_a_second_stop_begins_where_the_joints_are():
    arm = Arm(
        constraints={"decelerate_on_cancel": True, **{joint: {"max_deceleration_on_cancel": 2.0} for joint in JOINTS}}
    )
    arm.controller.cancel(arm.send((1.0, 1.0)))
    first = arm.send((1.0, 1.0))
    arm.run(40)
    arm.controller.cancel(first)
    arm.run(20)
    where = arm.positions()[0]
    second = arm.send((1.0, 1.0))
    arm.controller.cancel(second)
    arm.run()
    assert 0.0 <= arm.positions()[0] - where < 0.01  # half its speed is 5 mm a cycle; upstream jumps by tenths


def test_a_slow_look_ahead_does_not_jump_to_the_end(arm):
    arm.controller.set_speed_scaling(0.1)
    arm.send((0.1, 0.05), (0.2, 0.1))
    before = 0.0
    for _ in range(250):
        arm.run()
        assert 0.0 <= arm.positions()[0] - before < 0.006
        before = arm.positions()[0]
    assert before == 0.1


def test_a_command_time_out_does_not_make_a_goal_that_was_missed_a_success():
    arm = Arm(cmd_timeout=0.2, constraints={joint: {"goal": 0.01} for joint in JOINTS})
    goal = arm.send((0.5, 0.5))
    arm.run(20)
    arm.hardware.command_interfaces[0].value = math.nan
    for interface in arm.hardware.command_interfaces:
        interface.value = 0.0
    for _ in range(60):
        arm.run()
        arm.hardware.set("a/position", 0.2)  # it is stuck
    assert (goal.state, goal.code) == (GoalState.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED)


def test_what_is_set_while_it_is_inactive_counts_once_it_is_active(arm):
    arm.manager.switch((), ["arm"])
    arm.manager.set_parameters("arm", [ParameterValue(name="cmd_timeout", kind="double", value=0.2)])
    arm.manager.switch(["arm"], now=arm.now)
    arm.run(5)
    arm.controller.set_trajectory(JointTrajectory(JOINTS, [Point([0.1, 0.1], time=S // 10)]), arm.now)
    arm.run(25)
    assert not arm.controller.holding
    arm.run(10)
    assert arm.controller.holding


@pytest.mark.parametrize(
    "name", ["joints", "interpolation_method", "gains.a.antiwindup_strategy", "action_monitor_rate"]
)
def test_what_is_read_only_upstream_is_so_here(arm, name):
    reading = {parameter.name: parameter for parameter in arm.manager.parameters("arm")}
    assert reading[name].read_only
    assert not reading["gains.a.p"].read_only
    assert not reading["constraints.a.goal"].read_only


def test_a_joint_that_is_held_back_ends_the_goal_with_its_name_and_what_it_was():
    arm = Arm(constraints={joint: {"trajectory": 0.05} for joint in JOINTS})
    goal = arm.send((1.0, 1.0))
    for _ in range(20):
        arm.run()
        arm.hardware.set("b/position", 0.0)
    assert goal.code == ResultCode.PATH_TOLERANCE_VIOLATED
    assert goal.text.startswith("b is 0.0")
    assert "with a tolerance of 0.05" in goal.text


def test_a_deactivation_ends_the_goal(arm):
    goal = arm.send((1.0, 1.0))
    arm.run(10)
    arm.manager.switch((), ["arm"])
    assert (goal.state, goal.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    assert "deactivated" in goal.text


def test_a_trajectory_that_is_not_a_goal_is_cancelled_too(arm):
    arm.controller.set_trajectory(JointTrajectory(JOINTS, [Point([1.0, 1.0], time=S)]), arm.now)
    arm.run(30)
    arm.controller.cancel_goal()
    where = arm.positions()
    arm.run(50)
    assert arm.positions() == pytest.approx(where, abs=0.011)  # where they were when that was read
    assert arm.controller.holding
    with pytest.raises(ControlError, match="nothing was cancelled"):
        arm.controller.cancel_goal()


@pytest.mark.parametrize(
    ("inputs", "reported"),
    [
        ({"constraints": BRAKES}, None),
        ({"constraints": {"decelerate_on_cancel": True}}, "a has no constraints.a.max_deceleration_on_cancel"),
        ({"constraints": BRAKES, "state_interfaces": ["position"]}, "state_interfaces have no velocity"),
        ({"constraints": BRAKES, "limits": (-3.0, 3.0, math.inf)}, "no velocity limit of a"),
    ],
)
def test_a_deceleration_that_has_no_effect_is_reported(inputs, reported):
    arm = Arm(**inputs)
    texts = [event.text for event in arm.manager.events() if event.kind == "decelerate_on_cancel"]
    assert (reported in texts[0]) if reported else not texts


@pytest.mark.parametrize(("deceleration", "slow"), [(2.0, False), (0.001, True)])
def test_a_deceleration_with_which_a_stop_takes_long_is_reported(deceleration, slow):
    arm = Arm(constraints={**BRAKES, "b": {"max_deceleration_on_cancel": deceleration}})
    texts = [event.text for event in arm.manager.events() if event.kind == SLOW_STOP]
    key = "constraints.b.max_deceleration_on_cancel"
    assert bool(texts) is slow
    assert all("b needs " in text and text.endswith(f"raise the magnitude of {key}") for text in texts)


@pytest.mark.parametrize("factor", [-0.1, math.nan, math.inf])
def test_a_scaling_that_is_none_is_refused(arm, factor):
    with pytest.raises(ControlError, match="give 0 or more"):
        arm.controller.set_speed_scaling(factor)


def test_numbers_are_refused(arm):
    with pytest.raises(
        ControlError, match="only trajectories and goals; send one with canopen-control trajectory play FILE"
    ):
        arm.manager.command("arm", [0.0, 0.0], arm.now)


def test_positions_alone_are_upsampled_where_that_is_requested():
    arm = Arm(positions_upsampling__enable=True, positions_upsampling__policy_frequency=10.0)
    message = JointTrajectory(JOINTS, [Point([p, p]) for p in (0.0, 0.1, 0.3)])
    arm.controller.set_trajectory(message, arm.now)
    assert [point.time for point in message.points] == [100 * MS, 200 * MS, 300 * MS]
    assert message.points[1].velocities[0] > 0.0


def test_any_time_of_the_trajectory_can_be_asked_for_and_changes_nothing(arm):
    out = Point()
    arm.send((1.0, 1.0), (2.0, 0.0))
    arm.run(50)
    begin = arm.now - 490 * MS
    assert arm.controller.query(begin + S, out)
    assert out.positions == [1.0, 1.0]
    assert arm.controller.query(begin + S // 2, out)
    assert out.positions == [0.5, 0.5]
    assert not arm.controller.query(begin + 3 * S, out)
    assert out.positions == [0.0, 0.0]
    arm.run(50)
    assert arm.positions()[0] == pytest.approx(1.0)


def blending(**params):
    return Arm(allow_trajectory_replacement=True, allow_partial_joints_goal=True, **params)


def test_a_trajectory_that_comes_ahead_of_its_time_leaves_the_one_that_runs_until_then():
    arm = blending()
    first = arm.send((2.0, 1.0))
    arm.run(50)
    created = [Point([0.2, 0.2], time=S)]
    second = TrajectoryGoal(JointTrajectory(JOINTS, created, arm.now + S))
    arm.controller.send_goal(second, arm.now)
    assert (first.state, first.code) == (GoalState.ABORTED, ResultCode.INVALID_GOAL)
    arm.run(99)
    assert arm.positions() == pytest.approx([0.75] * 2, abs=0.01)
    arm.run(102)
    assert second.state is GoalState.SUCCEEDED
    assert arm.positions() == pytest.approx([0.2] * 2)


def test_without_it_the_trajectory_that_runs_ends_at_once():
    arm = Arm()
    arm.send((2.0, 1.0))
    arm.run(50)
    arm.controller.send_goal(TrajectoryGoal(JointTrajectory(JOINTS, [Point([0.2, 0.2], time=S)], arm.now + S)), arm.now)
    arm.run(99)
    assert max(arm.positions()) < 0.3


def test_a_blend_keeps_time_where_speed_is_scaled():
    arm = blending()
    arm.controller.set_speed_scaling(0.5)
    arm.send((1.0, 1.0))
    arm.run(100)
    arm.send((1.0, 0.0))
    before = arm.positions()[0]
    assert before == pytest.approx(0.5, abs=0.01)
    for _ in range(250):
        arm.run()
        assert abs(arm.positions()[0] - before) < 0.006
        before = arm.positions()[0]
    assert arm.positions() == pytest.approx([0.0, 0.0])


def test_a_new_trajectory_is_judged_by_where_it_takes_over():
    arm = blending()
    arm.send((4.0, 2.0))
    arm.run(50)
    with pytest.raises(ControlError, match="it begins with a at 0 "):
        arm.controller.send_goal(TrajectoryGoal(JointTrajectory(JOINTS, [Point([0.0] * 2)], arm.now + 3 * S)), arm.now)
    arm.controller.send_goal(TrajectoryGoal(JointTrajectory(JOINTS, [Point([1.7] * 2)], arm.now + 3 * S)), arm.now)


def test_what_ends_a_trajectory_ends_those_that_wait_too():
    arm = blending()
    arm.send((2.0, 1.0))
    arm.run(50)
    goal = TrajectoryGoal(JointTrajectory(JOINTS, [Point([0.2, 0.2], time=S)], arm.now + S))
    arm.controller.send_goal(goal, arm.now)
    arm.run(20)
    arm.controller.cancel(goal)
    arm.run(2)
    where = arm.positions()
    arm.run(300)
    assert arm.positions() == where


@given(st.lists(st.floats(-0.09, 0.09), min_size=1, max_size=20))
def test_a_hold_never_moves_whatever_the_joints_do(drift):
    arm = Arm()
    arm.run()
    held = arm.hardware.values()
    for item in drift:
        arm.hardware.set("a/position", item)
        arm.run()
        assert arm.hardware.values() == held


PATHS = st.lists(st.tuples(st.integers(20, 200), st.floats(-1.0, 1.0)), min_size=1, max_size=5)


@pytest.mark.parametrize("holds", [False, True])
def test_its_cycles_leave_no_object_behind(holds):
    arm = Arm(constraints={joint: {"trajectory": 2000.0, "goal": 2000.0} for joint in JOINTS})
    if not holds:
        arm.send((1000.0, 1.0))
    arm.run(10)
    update, now = arm.controller.update, arm.now
    for cycle in range(300):
        update(now + cycle * 10 * MS, 0.01)
    gc.collect()
    gc.disable()
    try:
        before, waiting = sys.getallocatedblocks(), gc.get_count()[0]
        for cycle in range(300, 2300):
            update(now + cycle * 10 * MS, 0.01)
        assert sys.getallocatedblocks() - before < 20
        assert gc.get_count()[0] - waiting < 10
    finally:
        gc.enable()


@given(PATHS, st.integers(0, 100), PATHS, st.booleans())
def test_whatever_follows_whatever_the_commands_never_jump(first, cycles, second, blends):
    arm = Arm(limits=(-3.0, 3.0, math.inf), allow_trajectory_replacement=blends)
    for path in (first, second):
        time, points = 0, []
        for ms, position in path:
            time += ms
            points.append((time / 1000, position))
        arm.send(*points)
        for _ in range(cycles):
            before = arm.positions()[0]
            arm.run()
            assert abs(arm.positions()[0] - before) <= 2.0 / 0.02 * 0.01 + 1e-9


def test_a_tolerance_that_is_set_counts_for_the_goals_to_come(arm):
    parameter_value = ParameterValue(name="constraints.a.trajectory", kind="double", value=0.125)
    arm.manager.set_parameters("arm", [parameter_value])
    arm.run()
    arm.send((0.5, 0.2))
    assert [item.position for item in arm.controller.tolerances.path] == [0.125, 0.0]
    with pytest.raises(ControlError, match="'joints' cannot be set because it is read-only"):
        arm.manager.set_parameters("arm", [ParameterValue(name="joints", kind="string_array", value=["b"])])


# ------------------------------------------------------------------------------------------------- limits of points

LIMITED = {"joint_limiter_type": POINT_LIMITER, "joint_limits": {each: {"max_acceleration": 4.0} for each in JOINTS}}


def steps_of(arm, cycles):
    """Return how far joint a goes in each cycle."""
    places = [arm.state("a")]
    for _ in range(cycles):
        arm.run()
        places.append(arm.state("a"))
    return [b - a for a, b in itertools.pairwise(places)]


def test_without_a_limiter_a_trajectory_may_jump_if_feasibility_is_not_checked():
    arm = Arm(unreachable_points="off")
    arm.send((0.1, 0.0), (0.2, 1.0))
    assert max(steps_of(arm, 30)) == pytest.approx(0.1)


def test_points_that_a_joint_cannot_reach_in_time_are_refused_or_taken_and_reported():
    arm = Arm(unreachable_points="refuse")
    with pytest.raises(TrajectoryRefused, match=r"point 1: a would have to move 1 in 0\.1 s.*give it 0\.5 s"):
        arm.send((0.1, 0.0), (0.2, 1.0))
    arm = Arm()
    arm.send((0.1, 0.0), (0.2, 1.0))
    assert max(steps_of(arm, 30)) == pytest.approx(0.1)
    (reported,) = [event.text for event in arm.events if event.kind == "unreachable"]
    assert "a would have to move 1 in 0.1 s, faster than its limit of 2" in reported


def test_a_point_limiter_holds_velocity_and_acceleration_and_reports_it_once():
    arm = Arm(**LIMITED)
    arm.send((0.1, 0.0), (0.2, 1.0))
    speeds = [0.0]
    for _ in range(120):
        assert max(steps_of(arm, 1)) <= 2.0 * 0.01 + 1e-9  # 2 rad/s of the description
        speeds.append(arm.controller.output.velocities[0])
    assert max(speeds) == pytest.approx(2.0)
    assert max(abs(b - a) for a, b in itertools.pairwise(speeds)) <= 4.0 * 0.01 + 1e-9
    assert [event.text for event in arm.events if event.kind == "limited"] == [
        "arm: a is slowed down by its limits; plan slower, or raise joint_limits"
    ]


def test_a_spline_that_swings_beyond_the_end_is_held_within_it():
    arm = Arm(limits=(-1.0, 1.0, 50.0), joint_limiter_type=POINT_LIMITER)
    points = [Point([p] * 2, [v] * 2, time=round(t * S)) for t, p, v in ((0.4, 0.95, 10.0), (0.8, 0.95, 0.0))]
    arm.controller.send_goal(TrajectoryGoal(JointTrajectory(JOINTS, points)), arm.now)
    places = []
    for _ in range(90):
        arm.run()
        places.append(arm.state("a"))
    assert max(places) <= 1.0


def test_a_goal_between_the_enabling_and_the_next_update_is_accepted(arm):
    """With an update_rate below the SYNC rate, the robot runs before its controller has seen that."""
    arm.enable("b", False)
    arm.run()
    arm.enable("b", True)
    goal = arm.send((1.0, 1.0))
    arm.run(300)
    assert goal.text == "the goal was reached", goal.text
