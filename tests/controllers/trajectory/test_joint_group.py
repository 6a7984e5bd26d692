import math

import pytest
from support.trajectories import cases, close, point

from canopen_control.controllers.trajectory.joint_group import JointGroup, Loops
from canopen_control.controllers.trajectory.params import JointGains
from canopen_control.controllers.trajectory.point import Point
from canopen_control.hardware.interfaces import CommandInterface, StateInterface


def group(joints=("a", "b"), commanded=None, commands=("position",), states=("position", "velocity")):
    joint_group = JointGroup(joints, commanded or joints, commands, states)
    inputs = [CommandInterface(*name.rsplit("/", 1)) for name in joint_group.command_names]
    read = [StateInterface(*name.rsplit("/", 1), 0.0) for name in joint_group.state_names]
    joint_group.set_interfaces(inputs, read)
    return joint_group, inputs, read


@pytest.mark.parametrize("case", cases("jtc_compute_error"), ids=lambda case: case["name"])
def test_the_error_is_upstreams(case):
    params, expect = case["in"]["params"], case["expect"]["error"]
    created, *_ = group(
        tuple(params["joints"]), None, tuple(params["command_interfaces"]), tuple(params["state_interfaces"])
    )
    created.wrap[:] = [case["in"].get("wrap", {}).get(joint, False) for joint in params["joints"]]
    created.actual = point(case["in"]["current"])
    created.compare(point(case["in"]["desired"]))
    for key in ("positions", "velocities", "accelerations"):
        assert close(getattr(created.error, key), expect[key]), key


def test_interfaces_are_named_joint_by_joint():
    created, *_ = group(commands=("position", "velocity"))
    assert created.command_names == ["a/position", "a/velocity", "b/position", "b/velocity"]
    assert created.state_names == ["a/position", "a/velocity", "b/position", "b/velocity"]


def test_fewer_joints_are_commanded_by_name_and_as_many_by_place():
    created, commands, _ = group(commanded=("b",))
    created.write("position", [1.0, 2.0])
    assert [command.value for command in commands] == [2.0]
    assert created.targets()[1] == 2.0
    assert math.isnan(created.targets()[0])
    created, commands, _ = group(commanded=("x", "y"))
    created.write("position", [1.0, 2.0])
    assert [(command.joint, command.value) for command in commands] == [("x", 1.0), ("y", 2.0)]


def test_it_waits_for_a_joint_that_is_disabled_or_has_an_unknown_position():
    created, commands, states = group()
    assert created.waits_for() is None
    commands[1].enabled = False
    assert created.waits_for() == "b"
    commands[1].enabled = True
    states[0].value = math.nan
    assert created.waits_for() == "a"


def test_letting_go_leaves_positions_to_the_hardware_and_all_else_at_zero():
    created, commands, _ = group(commands=("position", "velocity"))
    for command in commands:
        command.value = 1.0
    created.release()
    assert [(command.interface, command.value) for command in commands if command.interface == "velocity"] == [
        ("velocity", 0.0)
    ] * 2
    assert all(math.isnan(command.value) for command in commands if command.interface == "position")


def test_it_begins_with_what_stands_commanded_where_all_of_it_is_known():
    created, commands, _ = group()
    commands[0].value = 1.0
    created.begin_with_commands()
    assert created.actual.positions == [0.0, 0.0]
    commands[1].value = 2.0
    created.begin_with_commands()
    assert created.actual.positions == [1.0, 2.0]


GAINS = [JointGains(p=2.0, ff_velocity_scale=1.0), JointGains(p=3.0, d=0.5)]
WANTED, ERROR = Point([1.0, 1.0], [4.0, 5.0], effort=[10.0, 20.0]), Point([0.1, 0.2], [0.0, 1.0])


def test_a_velocity_is_that_of_the_trajectory_and_the_loops():
    loops = Loops(GAINS, [0, 1], with_effort=False)
    assert loops.compute(0, WANTED, ERROR, 0.01) == pytest.approx(4.0 + 0.2)
    assert loops.compute(1, WANTED, ERROR, 0.01) == pytest.approx(0.6 + 0.5)


def test_an_effort_begins_with_that_of_the_trajectory():
    assert Loops(GAINS, [1], with_effort=True).compute(0, WANTED, ERROR, 0.01) == pytest.approx(20.0 + 0.6 + 0.5)


def test_other_gains_keep_the_integral_and_a_reset_does_not():
    loops = Loops([JointGains(i=1.0)], [0], with_effort=False)
    error = Point([1.0], [0.0])
    before = [loops.compute(0, Point([1.0]), error, 0.1) for _ in range(3)][-1]
    loops.set_gains([JointGains()])
    assert loops.compute(0, Point([1.0]), error, 0.1) == pytest.approx(before)
    loops.reset()
    assert loops.compute(0, Point([1.0]), error, 0.1) == 0.0
