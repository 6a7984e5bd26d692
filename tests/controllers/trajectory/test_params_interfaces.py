import pytest
from support.trajectories import cases

from canopen_control.controllers.trajectory.params import wrong_commands, wrong_joints, wrong_states, wrong_together


@pytest.mark.parametrize("case", cases("jtc_interface_combinations"), ids=lambda case: case["name"])
def test_upstream_s_combinations_are_taken_and_no_others(case):
    judge = {"command": wrong_commands, "state": wrong_states}[case["in"]["kind"]]
    assert (judge(case["in"]["interfaces"]) is None) is case["expect"]["accept"]


@pytest.mark.parametrize("commands", [["velocity"], ["effort"], ["position", "effort"], ["effort", "position"]])
def test_a_loop_needs_position_and_velocity(commands):
    assert "[position, velocity]" in wrong_together(commands, ["position"])
    assert wrong_together(commands, ["position", "velocity"]) is None


def test_positions_need_no_states_but_their_own():
    assert wrong_together(["position", "velocity"], ["position"]) is None


def test_joints_of_another_hardware_are_as_many_and_fewer_are_some_of_them():
    assert wrong_joints(["a", "b"], ["x", "y"]) is None
    assert wrong_joints(["a", "b"], ["b"]) is None
    assert "x" in wrong_joints(["a", "b"], ["x"])
    assert "more" in wrong_joints(["a"], ["a", "b"])


@pytest.mark.parametrize(
    ("given", "word"), [([], "empty"), (["position", "position"], "twice"), (["torque"], "torque")]
)
def test_a_list_that_is_none_is_said(given, word):
    assert word in wrong_commands(given)
    assert word in wrong_states(given)
