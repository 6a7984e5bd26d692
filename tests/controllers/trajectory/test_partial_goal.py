import math

import pytest
from support.trajectories import cases, differences, message

from canopen_control.controllers.trajectory.partial_goal import fill_up, put_in_order

#: upstream appends nothing then, and commands every joint what was meant for another one
UNKNOWN = "missing command value is NaN: nothing appended, rows not remapped"
CASES = cases("jtc_partial_goal")


def test_a_joint_without_a_command_stays_where_it_is():
    case = next(each for each in CASES if each["name"] == UNKNOWN)
    joints, made = case["in"]["params"]["joints"], message(case["in"]["trajectory"])
    given = dict(zip(made.joint_names, made.points[0].positions, strict=True))
    fill_up(made, joints, [math.nan] * len(joints), [9.0] * len(joints))
    put_in_order(made, joints)
    assert made.points[0].positions == [given.get(joint, 9.0) for joint in joints]


@pytest.mark.parametrize("case", [each for each in CASES if each["name"] != UNKNOWN], ids=lambda case: case["name"])
def test_it_fills_up_and_sorts_as_upstream_does(case):
    given, expect = case["in"], case["expect"]
    joints, made = given["params"]["joints"], message(given["trajectory"])
    commands = [given.get("command", {}).get(f"{joint}/position", math.nan) for joint in joints]
    states = [given.get("state", {}).get(f"{joint}/position", 0.0) for joint in joints]
    fill_up(made, joints, commands, states)
    assert made.joint_names == expect["joint_names_after_fill"]
    put_in_order(made, joints)
    assert made.joint_names == expect["joint_names_after_fill"]
    for found, wanted in zip(made.points, expect["points_after_sort"], strict=True):
        assert not differences(found, wanted)
        assert found.time == wanted["t_ns"]
