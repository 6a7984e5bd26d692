from __future__ import annotations

import math
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.joint_limits import expect_as_recorded, hard, limiter_cases, quantities

from canopen_control.controllers.command_limits import CommandLimits, JointCommands, PlainCommand, limited_joint
from canopen_control.controllers.limiters import EFF, JERK, NOTHING, POS, VEL, JointLimiter
from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
from canopen_control.hardware.plugins import GenericSystem
from canopen_control.urdf.description import parse_description
from canopen_control.urdf.joint_element import HardLimits, SoftLimits

QUANTITIES = ("position", "velocity", "effort", "acceleration", "jerk")
bounds = st.floats(0.5, 4.0) | st.just(math.inf)
lowest, highest = st.floats(-2.0, -1.0) | st.just(-math.inf), st.floats(1.0, 2.0) | st.just(math.inf)
limits = st.builds(HardLimits, lowest, highest, bounds, bounds, bounds, bounds, bounds)
values_of_limited_commands = st.floats(-5.0, 5.0) | st.sampled_from((math.nan, math.inf, -math.inf, 0.0, -0.0))
cycles = st.tuples(
    values_of_limited_commands,
    values_of_limited_commands,
    st.lists(values_of_limited_commands, min_size=5, max_size=5),
    st.sampled_from((True, True, True, False)),
)
periods = st.sampled_from((0.01, 0.5, 0.0, -0.1))


class Joint:
    """As much of a joint's element as limits read."""

    type = "revolute"

    def __init__(self, soft=None):
        self.soft = soft


class LimitedCommandsBench:
    def __init__(self, limits, names, measured, *, in_full=False):
        make = JointCommands if in_full else limited_joint
        self.in_full = in_full
        self.commands = [CommandInterface("j", name) for name in names]
        self.states = [StateInterface("j", name) for name in measured]
        self.limited = make(Joint(), limits, self.commands, self.states)
        self.clock = 0.0

    def cycle(self, position, velocity, wanted, owned, period):
        for state, value in zip(self.states, (position, velocity), strict=False):
            state.value = value
        for command, value in zip(self.commands, wanted, strict=False):
            command.value, command.owner = value, "c" if owned else None
        self.clock += period
        reported = None
        if self.in_full or not (period > 0.0 and self.limited.passes(period)):
            reported = self.limited.enforce(period, self.clock)
        return reported, [repr(command.value) for command in self.commands]


@pytest.mark.rest
@given(
    limits,
    st.lists(st.sampled_from(QUANTITIES), min_size=1, max_size=5, unique=True),
    st.sampled_from(((), ("position",), ("position", "velocity"))),
    st.lists(st.tuples(cycles, periods), max_size=30),
)
def test_what_passes_is_what_judging_it_in_full_leaves_as_it_is(limits, names, measured, steps):
    quick = LimitedCommandsBench(limits, names, measured)
    in_full = LimitedCommandsBench(limits, names, measured, in_full=True)
    for (position, velocity, expected, owned), period in steps:
        assert quick.cycle(position, velocity, expected, owned, period) == in_full.cycle(
            position, velocity, expected, owned, period
        )


@given(
    limits,
    st.sampled_from(QUANTITIES[:2]),
    st.lists(st.tuples(st.floats(-0.02, 0.02), st.floats(-2.0, 2.0)), min_size=2, max_size=30),
)
def test_small_steps_are_what_judging_them_in_full_leaves_as_they_are(limits, name, steps):
    quick = LimitedCommandsBench(limits, [name], ("position", "velocity"))
    in_full = LimitedCommandsBench(limits, [name], ("position", "velocity"), in_full=True)
    expected = 0.0
    for step, velocity in steps:
        expected += step
        assert quick.cycle(0.1, velocity, [expected], True, 0.01) == in_full.cycle(
            0.1, velocity, [expected], True, 0.01
        )


@pytest.mark.parametrize("name", QUANTITIES[:2])
def test_a_command_within_every_limit_passes(name):
    bench = LimitedCommandsBench(HardLimits(-1.0, 1.0, 3.0, 4.0, 5.0), [name], ("position", "velocity"))
    bench.cycle(0.0, 0.0, [0.0], True, 0.01)
    bench.commands[0].value = 0.0002
    assert bench.limited.passes(0.01)
    bench.commands[0].value = 2.9
    assert not bench.limited.passes(0.01)


def test_a_joint_with_soft_limits_is_always_judged_in_full():
    command = CommandInterface("j", "position")
    limited = limited_joint(Joint(SoftLimits(-0.5, 0.5, 5.0)), HardLimits(-1.0, 1.0, 3.0), [command], [])
    assert not limited.passes(0.01)


def test_a_plain_command_is_kept_within_its_bounds_and_reported_once_a_second():
    command = CommandInterface("tool", "width", minimum=0.0, maximum=1.0)
    limited = PlainCommand(command)
    command.owner, command.value = "c", 2.0
    assert not limited.passes(0.1)
    assert limited.enforce(0.1, 0.1) == "tool/width: 2 is limited to 1"
    command.value = -1.0
    assert limited.enforce(0.1, 0.2) is None
    assert command.value == 0.0
    command.value = -1.0
    assert limited.enforce(0.1, 1.3) == "tool/width: -1 is limited to 0"


CASES = limiter_cases("saturation")


@pytest.mark.parametrize("case", CASES, ids=[item["name"] for item in CASES])
def test_commands_are_limited_as_by_ros2_control(case):
    expect_as_recorded(JointLimiter(hard(case["in"]["limits"])), case)


def test_nothing_is_changed_without_time():
    limiter, desired = JointLimiter(HardLimits(max_velocity=1.0)), quantities({"velocity": 5.0})
    assert limiter.enforce(list(NOTHING), desired, 0.0) is False
    assert desired[VEL] == 5.0


def test_without_limits_everything_passes():
    limiter, desired = JointLimiter(HardLimits()), [1e9, -1e9, 1e9, -1e9, 1e9]
    assert limiter.enforce(list(NOTHING), desired, 0.01) is False
    assert desired == [1e9, -1e9, 1e9, -1e9, 1e9]


values = st.floats(-50, 50) | st.just(math.nan)


@given(st.lists(st.tuples(st.floats(-1.0, 2.0), values, st.lists(values, min_size=5, max_size=5)), max_size=12))
def test_no_limit_is_exceeded_and_what_is_not_given_stays_so(steps):
    limits = HardLimits(-1.0, 2.0, 3.0, 4.0, max_jerk=7.0)
    limiter, before = JointLimiter(limits), math.nan
    for position, velocity, expected in steps:
        desired = list(expected)
        limited = limiter.enforce([position, velocity, math.nan, math.nan, math.nan], desired, 0.01)
        assert [math.isnan(item) for item in desired] == [math.isnan(item) for item in expected]
        assert limited == any(a != b for a, b in zip(desired, expected, strict=True) if not math.isnan(b))
        for result, most in ((desired[VEL], 3.0), (desired[EFF], 4.0), (desired[JERK], 7.0)):
            assert not abs(result) > most + 1e-9
        if not math.isnan(desired[POS]):
            assert -1.0 <= desired[POS] <= 2.0
            assert not abs(desired[POS] - before) > 3.0 * 0.01 + 1e-9
            before = desired[POS]


URDF = """<robot name="r"><link name="a"/><link name="b"/>
<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>
  <limit lower="-1" upper="2" velocity="3" effort="4"/>{safety}</joint>
<ros2_control name="s" type="system"><hardware><plugin>mock_components/GenericSystem</plugin></hardware>
<joint name="j">{inside}{states}</joint></ros2_control></robot>"""
VELOCITY = '<command_interface name="velocity"/>'
POSITION = '<command_interface name="position"/>'
EFFORT = '<command_interface name="effort"/>'
ACCELERATION = '<command_interface name="acceleration"><param name="max">5</param></command_interface>'


class Bench:
    def __init__(
        self,
        inside: str,
        kind: str = "continuous",
        safety: str = "",
        states: tuple[str, ...] = ("position", "velocity"),
    ) -> None:
        known = "".join(f'<state_interface name="{state}"/>' for state in states)
        description = parse_description(URDF.format(kind=kind, inside=inside, safety=safety, states=known))
        self.registry = InterfaceRegistry()
        mock = GenericSystem(description.hardware[0])
        mock.configure()
        self.registry.register(mock)
        self.limits = CommandLimits(description, self.registry)

    def send(self, interface: str, value: float, period: float = 0.1) -> float:
        command = self.registry.command(f"j/{interface}")
        command.owner, command.value = "c", value
        self.collected = self.limits.enforce(period)
        return command.value

    def at(self, position: float) -> None:
        self.registry.state("j/position").value = position


def test_a_velocity_stays_within_the_urdfs_limit_and_the_smaller_of_min_and_max():
    assert Bench(VELOCITY).send("velocity", 10.0) == 3.0
    assert Bench(VELOCITY).send("velocity", -10.0) == -3.0
    bounds = '<param name="min">-1</param><param name="max">2</param>'
    tighter = f'<command_interface name="velocity">{bounds}</command_interface>'
    assert Bench(tighter).send("velocity", 10.0) == 1.0
    assert Bench(EFFORT).send("effort", 10.0) == 4.0


def test_a_velocity_never_leads_past_the_end_of_the_joint_within_the_cycle():
    bench = Bench(VELOCITY, "revolute")
    bench.at(1.9)
    assert bench.send("velocity", 3.0) == pytest.approx(1.0)
    bench.at(2.5)
    assert bench.send("velocity", 3.0) == 0.0
    assert bench.send("velocity", -3.0) == -3.0


def test_a_position_stays_within_the_joint_and_moves_by_the_velocity_limit():
    bench = Bench(POSITION, "revolute")
    bench.at(0.0)
    assert bench.send("position", 5.0) == pytest.approx(0.3)
    assert bench.send("position", 5.0) == pytest.approx(0.6)
    for _ in range(20):
        last = bench.send("position", 5.0)
    assert last == 2.0


def test_an_acceleration_comes_from_its_tag_only():
    bench = Bench(VELOCITY + ACCELERATION)
    assert [bench.send("velocity", 2.0) for _ in range(5)] == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.0])
    assert bench.send("velocity", -2.0) == pytest.approx(1.5)


def test_what_is_limited_is_reported_once_with_the_value_asked_for_and_the_limit():
    bench = Bench(VELOCITY)
    bench.send("velocity", 10.0)
    assert bench.collected == "j/velocity: 10 rad/s is limited to 3 rad/s"
    for value in (10.0, 1.0, -9.0, 10.0):  # the same occasion, also through commands that pass
        bench.send("velocity", value)
        assert bench.collected is None
    for _ in range(11):
        bench.send("velocity", 1.0)
    bench.send("velocity", -9.0)
    assert bench.collected == "j/velocity: -9 rad/s is limited to -3 rad/s"


@pytest.mark.parametrize(
    ("inside", "kind", "interface", "value", "reported"),
    [
        (POSITION, "revolute", "position", 2.0, "j/position: 2 rad is limited to changes of 3 rad/s"),
        (POSITION, "prismatic", "position", 5.0, "j/position: 5 m is limited to 2 m and to changes of 3 m/s"),
        (EFFORT, "revolute", "effort", 9.0, "j/effort: 9 Nm is limited to 4 Nm"),
        (EFFORT, "prismatic", "effort", -9.0, "j/effort: -9 N is limited to -4 N"),
        (
            VELOCITY + ACCELERATION,
            "continuous",
            "velocity",
            2.0,
            "j/velocity: 2 rad/s is limited to changes of 5 rad/s²",
        ),
    ],
)
def test_the_limit_is_reported_in_the_units_of_the_description_not_of_a_cycle(inside, kind, interface, value, reported):
    bench = Bench(inside, kind)
    bench.at(0.0)
    bench.send(interface, value)
    assert bench.collected == reported


def test_the_end_of_a_joint_is_reported_as_such():
    bench = Bench(VELOCITY, "revolute")
    bench.at(1.9)
    bench.send("velocity", 3.0)
    assert bench.collected == "j/velocity: 3 rad/s is limited to a velocity that ends at 2 rad"


def test_a_position_under_way_is_one_occasion_whatever_the_controllers_rate():
    bench = Bench(POSITION, "revolute")
    bench.at(0.0)
    reports = []
    for cycle in range(30):  # a controller of a third of the rate writes its target now and then
        value = 5.0 if cycle % 3 == 0 else bench.registry.command("j/position").value
        bench.send("position", value, 0.02)
        reports.append(bench.collected)
    assert reports[0] is not None
    assert reports[1:] == [None] * 29


@pytest.mark.parametrize(
    "inside",
    [
        '<limits enable="false"/>' + VELOCITY,
        '<command_interface name="velocity"><limits enable="false"/></command_interface>',
    ],
)
def test_limits_can_be_switched_off(inside):
    assert Bench(inside).send("velocity", 10.0) == 10.0


def test_no_command_stays_none_and_unclaimed_interfaces_are_left_unchanged():
    bench = Bench(VELOCITY)
    assert math.isnan(bench.send("velocity", math.nan))
    command = bench.registry.command("j/velocity")
    command.owner, command.value = None, 99.0
    assert bench.limits.enforce(0.1) is None
    assert command.value == 99.0


@given(st.lists(st.floats(-1e6, 1e6), max_size=30), st.floats(0.001, 0.5))
def test_no_limit_is_exceeded_whatever_is_commanded(commands, period):
    bench = Bench(VELOCITY + ACCELERATION, "revolute")
    position, before = 0.0, 0.0
    for command in commands:
        bench.at(position)
        now = bench.send("velocity", command, period)
        assert abs(now) <= 3.0
        assert abs(now - before) <= 5.0 * period + 1e-9
        before = now
        position = min(2.0, max(-1.0, position + now * period))


SAFETY = '<safety_controller soft_lower_limit="-0.5" soft_upper_limit="1.5" k_position="5" k_velocity="10"/>'


@pytest.mark.parametrize(("safety", "low", "high"), [("", "-1", "2"), (SAFETY, "-0.5", "1.5")])
def test_a_joint_that_is_outside_moves_only_by_a_command_into_its_range_and_not_at_once(safety, low, high):
    """A controller that holds the position commands the actual position, which does not command a motion."""
    bench = Bench(POSITION, "revolute", safety)
    bench.at(2.5)
    assert [bench.send("position", 2.5) for _ in range(3)] == [2.5, 2.5, 2.5]
    assert bench.collected is None  # once
    assert bench.send("position", 9.0) == 2.5
    bench = Bench(POSITION, "revolute", safety)
    bench.at(2.5)
    bench.send("position", 2.5)
    assert bench.collected == (
        f"j/position: the joint is at 2.5 rad, outside its range from {low} to {high} rad, and is held there; "
        "a position within the range moves it back"
    )
    assert bench.send("position", 2.4) == 2.4
    assert bench.send("position", 2.5) == 2.4  # no farther out again
    sent = [bench.send("position", 1.0) for _ in range(600)]
    assert sent[0] > 2.09
    assert sent == sorted(sent, reverse=True)
    assert sent[-1] == pytest.approx(1.0)


def test_a_joint_that_is_outside_at_the_lower_end_is_held_too():
    bench = Bench(POSITION, "revolute")
    bench.at(-1.5)
    sent = [bench.send("position", value) for value in (-1.5, -9.0, -1.4, -1.0)]
    assert sent == pytest.approx([-1.5, -1.5, -1.4, -1.1])


def test_soft_limits_come_from_the_safety_controller():
    bench = Bench(POSITION, "revolute", SAFETY)
    bench.at(1.3)
    sent = [bench.send("position", 2.0) for _ in range(40)]
    assert sent[0] == pytest.approx(1.4)  # 5/s times the 0.2 rad that are left
    assert sent == sorted(sent)
    assert 1.499 < sent[-1] <= 1.5
    bench = Bench(POSITION, "revolute", SAFETY)
    bench.at(1.5)
    bench.send("position", 2.0)
    assert bench.collected == "j/position: 2 rad is limited to its soft limit 1.5 rad"
    bench = Bench(POSITION, "revolute", SAFETY)
    bench.at(1.3)
    bench.send("position", 1.5)
    assert bench.collected == "j/position: 1.5 rad is limited to its soft limits, -0.5 to 1.5 rad"
    bench = Bench(POSITION, "revolute", SAFETY)
    bench.at(0.0)
    bench.send("position", 9.0)
    assert bench.collected == "j/position: 9 rad is limited to its soft limit 1.5 rad and to changes of 3 rad/s"


def test_an_effort_drives_no_joint_further_out():
    bench = Bench(EFFORT + VELOCITY, "revolute")
    bench.at(2.0)
    bench.registry.state("j/velocity").value = 0.1
    assert bench.send("effort", 3.0) == 0.0
    assert (
        bench.collected == "j/effort: 3 Nm is limited to an effort that drives the joint neither further out nor faster"
    )
    assert bench.send("effort", -3.0) == -3.0


def test_a_position_speeds_up_by_the_acceleration_only_where_the_velocity_is_known():
    known = Bench(POSITION + ACCELERATION, "revolute")
    known.at(0.0)
    known.registry.state("j/velocity").value = 0.0
    assert known.send("position", 1.0) == pytest.approx(0.05)  # 5 rad/s² for 0.1 s makes 0.5 rad/s
    assert known.collected == "j/position: 1 rad is limited to changes of 5 rad/s²"
    unknown = Bench(POSITION + ACCELERATION, "revolute", states=("position",))
    unknown.at(0.0)
    assert unknown.send("position", 1.0) == pytest.approx(0.3)


def test_an_acceleration_is_limited_by_max_and_in_braking_by_min():
    limits = '<param name="min">-2</param><param name="max">5</param>'
    bench = Bench(f'<command_interface name="acceleration">{limits}</command_interface>')
    bench.registry.state("j/velocity").value = 1.0
    assert bench.send("acceleration", 9.0) == 5.0
    assert bench.send("acceleration", -9.0) == -2.0


def test_limiting_leaves_nothing_behind():
    bench = Bench(POSITION + EFFORT + ACCELERATION, "revolute", SAFETY)
    bench.at(0.5)
    command = bench.registry.command("j/position")
    command.owner = "c"

    def run(cycles):
        for cycle in range(cycles):
            command.value = 0.5 + cycle % 7
            bench.limits.enforce(0.01)

    run(1000)
    before = sys.getallocatedblocks()
    run(1000)
    assert sys.getallocatedblocks() - before < 10
