from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.hardware.command_limits import JointCommands, PlainCommand, limited_joint
from canopen_control.hardware.interfaces import CommandInterface, StateInterface
from canopen_control.urdf.joint_element import HardLimits, SoftLimits

QUANTITIES = ("position", "velocity", "effort", "acceleration", "jerk")
bounds = st.floats(0.5, 4.0) | st.just(math.inf)
lowest, highest = st.floats(-2.0, -1.0) | st.just(-math.inf), st.floats(1.0, 2.0) | st.just(math.inf)
limits = st.builds(HardLimits, lowest, highest, bounds, bounds, bounds, bounds, bounds)
values = st.floats(-5.0, 5.0) | st.sampled_from((math.nan, math.inf, -math.inf, 0.0, -0.0))
cycles = st.tuples(values, values, st.lists(values, min_size=5, max_size=5), st.sampled_from((True, True, True, False)))
periods = st.sampled_from((0.01, 0.5, 0.0, -0.1))


class Joint:
    """As much of a joint's element as limits read."""

    type = "revolute"

    def __init__(self, soft=None):
        self.soft = soft


class Bench:
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
        told = None
        if self.in_full or not (period > 0.0 and self.limited.passes(period)):
            told = self.limited.enforce(period, self.clock)
        return told, [repr(command.value) for command in self.commands]


@pytest.mark.rest
@given(
    limits,
    st.lists(st.sampled_from(QUANTITIES), min_size=1, max_size=5, unique=True),
    st.sampled_from(((), ("position",), ("position", "velocity"))),
    st.lists(st.tuples(cycles, periods), max_size=30),
)
def test_what_passes_is_what_judging_it_in_full_leaves_as_it_is(limits, names, measured, steps):
    quick = Bench(limits, names, measured)
    in_full = Bench(limits, names, measured, in_full=True)
    for (position, velocity, wanted, owned), period in steps:
        assert quick.cycle(position, velocity, wanted, owned, period) == in_full.cycle(
            position, velocity, wanted, owned, period
        )


@given(
    limits,
    st.sampled_from(QUANTITIES[:2]),
    st.lists(st.tuples(st.floats(-0.02, 0.02), st.floats(-2.0, 2.0)), min_size=2, max_size=30),
)
def test_small_steps_are_what_judging_them_in_full_leaves_as_they_are(limits, name, steps):
    quick = Bench(limits, [name], ("position", "velocity"))
    in_full = Bench(limits, [name], ("position", "velocity"), in_full=True)
    wanted = 0.0
    for step, velocity in steps:
        wanted += step
        assert quick.cycle(0.1, velocity, [wanted], True, 0.01) == in_full.cycle(0.1, velocity, [wanted], True, 0.01)


@pytest.mark.parametrize("name", QUANTITIES[:2])
def test_a_command_within_every_limit_passes(name):
    bench = Bench(HardLimits(-1.0, 1.0, 3.0, 4.0, 5.0), [name], ("position", "velocity"))
    bench.cycle(0.0, 0.0, [0.0], True, 0.01)
    bench.commands[0].value = 0.0002
    assert bench.limited.passes(0.01)
    bench.commands[0].value = 2.9
    assert not bench.limited.passes(0.01)


def test_a_joint_with_soft_limits_is_always_judged_in_full():
    command = CommandInterface("j", "position")
    limited = limited_joint(Joint(SoftLimits(-0.5, 0.5, 5.0)), HardLimits(-1.0, 1.0, 3.0), [command], [])
    assert not limited.passes(0.01)


def test_a_plain_command_is_kept_within_its_bounds_and_told_once_a_second():
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
