"""The speed limit by interface: requested and limited values in each cycle."""

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.robots import Bench

from canopen_control.check.preflight_record import SpeedCap, limit_speed
from canopen_control.hardware.axis import AxisObjectLimits
from canopen_control.hardware.interfaces import CommandInterface, StateInterface

PERIOD = 0.02


class Registry:
    """Interfaces by name; `of` returns one."""

    def __init__(self, commands, states):
        self.command_interfaces = [CommandInterface("joint", name) for name in commands]
        self.state_interfaces = [StateInterface("joint", name, value) for name, value in states.items()]

    def of(self, name):
        (command,) = (item for item in self.command_interfaces if item.interface == name)
        command.owner = "controller"
        return command

    def state(self, name):
        (state,) = (item for item in self.state_interfaces if item.interface == name)
        return state


def capped(commands, **states):
    registry = Registry(commands, states)
    return registry, SpeedCap(registry, {"joint"}, 1.0)


def test_a_position_goes_to_its_command_at_the_cap_from_where_the_joint_is():
    registry, cap = capped(["position"], position=5.0)
    command, here = registry.of("position"), registry.state("position")
    values = []
    for _ in range(150):
        command.value = 7.0  # a controller that is due every cycle
        cap.enforce(PERIOD)
        values.append(command.value)
        here.value = command.value
    assert values[0] == pytest.approx(5.02)
    steps = [after - before for before, after in zip([5.0, *values], values, strict=False)]
    assert max(steps) == pytest.approx(PERIOD)
    assert values[-1] == 7.0
    assert sum(step > 1e-9 for step in steps) == 100


def test_a_controller_that_is_not_due_does_not_hold_the_joint_up():
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    command.value = -1.0
    for _ in range(50):
        cap.enforce(PERIOD)
        here.value = command.value
    assert command.value == -1.0


def test_a_joint_that_has_not_followed_restarts_where_it_is():
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    for _ in range(100):
        command.value = 10.0
        cap.enforce(PERIOD)
    assert command.value <= 0.5 + PERIOD, "it was not enabled, and nothing winds up"
    here.value = -3.0  # moved by hand
    command.value = 10.0
    cap.enforce(PERIOD)
    assert command.value == pytest.approx(-3.0 + PERIOD)


def test_without_a_controller_or_a_command_nothing_is_made_up():
    registry, cap = capped(["position", "effort"], position=1.0, velocity=3.0)
    command = registry.of("position")
    cap.enforce(PERIOD)
    assert math.isnan(command.value)
    command.value, command.owner = 4.0, None
    cap.enforce(PERIOD)
    assert command.value == 4.0


def test_a_joint_at_an_unknown_position_stays():
    registry, cap = capped(["position"], position=math.nan)
    command = registry.of("position")
    command.value = 1.0
    cap.enforce(PERIOD)
    assert math.isnan(command.value)


@pytest.mark.parametrize(
    ("speed", "expected", "left"),
    [(0.9, 5.0, 5.0), (1.1, 5.0, 0.0), (1.1, -5.0, -5.0), (-1.1, -5.0, 0.0), (-1.1, 5.0, 5.0), (math.nan, 5.0, 5.0)],
)
def test_an_effort_is_taken_away_above_the_cap_unless_it_brakes(speed, expected, left):
    registry, cap = capped(["effort"], velocity=speed)
    command = registry.of("effort")
    command.value = expected
    cap.enforce(PERIOD)
    assert command.value == left


def test_what_cannot_be_capped_is_named_and_other_joints_are_left_alone():
    registry = Registry(["position", "effort"], {})
    assert SpeedCap(registry, {"joint"}, 1.0).unlimited == ["joint/position", "joint/effort"]
    assert SpeedCap(registry, {"another"}, 1.0).unlimited == []


@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(0, 1)), max_size=60))
def test_whatever_is_commanded_the_target_moves_no_faster_than_the_cap(commands):
    registry, cap = capped(["position"], position=0.0)
    command, here = registry.of("position"), registry.state("position")
    last = 0.0
    for expected, followed in commands:
        command.value = expected
        cap.enforce(PERIOD)
        assert abs(command.value - here.value) <= 0.5 + PERIOD + 1e-9
        if abs(last - here.value) <= 0.5:
            assert abs(command.value - last) <= PERIOD + 1e-9
        last = command.value
        here.value += (command.value - here.value) * followed


@pytest.mark.parametrize("reduction", [1.0, 50.0, -0.5])
def test_a_drive_behind_a_transmission_is_capped_by_the_turns_of_its_joint(reduction):
    registry, cap = capped(["velocity"])
    drive = SimpleNamespace(
        joint="joint", commands={"velocity": registry.of("velocity")}, axis=SimpleNamespace(limits=AxisObjectLimits())
    )
    cap.bound([drive], {"joint": reduction})
    command, limits = registry.of("velocity"), drive.axis.limits
    assert (command.minimum, command.maximum) == (-abs(reduction), abs(reduction))
    assert (limits.described, limits.words) == (abs(reduction), "the speed limit of this run")


@pytest.mark.rest
def test_a_robot_that_is_commanded_positions_is_slow_too():
    bench = Bench("cappedarm", config="arm6", drives=range(2, 8))
    joints = list(bench.robot.joints)
    assert limit_speed(bench.robot, joints, 0.3) == []
    bench.start()
    before, fastest = positions(bench), 0.0
    for _ in range(100):
        bench.robot.command("arm_position_controller", [1.0] * 6, "test")
        bench.run(20)
        fastest = max(fastest, *((now - then) / 0.02 for now, then in zip(positions(bench), before, strict=True)))
        before = positions(bench)
    assert fastest == pytest.approx(0.3, rel=0.01), "the description says 2 rad/s"
    assert before == pytest.approx([0.3 * 2] * 6, abs=0.02)
    for _ in range(100):
        bench.robot.command("arm_position_controller", [1.0] * 6, "test")
        bench.run(20)
    assert positions(bench) == pytest.approx([1.0] * 6, abs=0.01)
    bench.close()


def positions(bench):
    return [bench.robot.registry.state(f"{joint}/position").value for joint in bench.robot.joints]


@pytest.mark.parametrize(
    ("quantity", "expected", "left"),
    [("velocity", 5.0, 1.0), ("velocity", -5.0, -1.0), ("velocity", 0.5, 0.5), ("velocity", math.nan, math.nan),
     ("position", 5.0, PERIOD), ("position", math.nan, math.nan), ("effort", 5.0, 0.0), ("target", math.nan, math.nan)],
)  # fmt: skip
def test_a_target_is_capped_as_what_the_mode_makes_of_it(quantity, expected, left):
    registry, cap = capped(["target"], position=0.0, velocity=2.0)
    command = registry.of("target")
    command.quantity, command.value = quantity, expected
    cap.enforce(PERIOD)
    assert command.value == pytest.approx(left, nan_ok=True)
    assert cap.unlimited == []
