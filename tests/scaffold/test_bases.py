"""The bases that a new robot may be: how many drives, which joints, which interfaces."""

import pytest

from canopen_control.scaffold.bases import BASES
from canopen_control.scaffold.drive_choice import POSITION, VELOCITY


def test_joints_without_a_base_are_numbered_and_there_may_be_any_number():
    assert BASES["none"].joints(3) == ("joint_1", "joint_2", "joint_3")
    assert BASES["none"].problem(17) == ""
    assert BASES["none"].interfaces(3, 0) == (VELOCITY, POSITION)


@pytest.mark.parametrize(
    ("drives", "text"), [(0, "but none were given"), (1, "but 1 was given"), (3, "but 3 were given")]
)
def test_a_differential_base_has_two_drives_or_four(drives, text):
    assert f"two drives (left, right) or four (front left, front right, rear left, rear right), {text}" in (
        BASES["diff"].problem(drives)
    )
    assert BASES["diff"].problem(2) == BASES["diff"].problem(4) == ""


def test_wheels_are_velocities_and_steering_a_position():
    tricycle = BASES["tricycle"]
    assert [tricycle.interfaces(3, number) for number in range(3)] == [(VELOCITY,), (VELOCITY,), (POSITION,)]


def test_the_left_wheels_are_mirrored_and_the_steering_is_not():
    assert [BASES["mecanum"].mirrored(4, number) for number in range(4)] == [True, False, True, False]
    assert [BASES["tricycle"].mirrored(3, number) for number in range(3)] == [True, False, False]
    assert not BASES["none"].mirrored(1, 0)
