"""The words for what is wanted."""

from canopen_control.hardware import joint
from canopen_control.hardware.wishes import Action, Wish


def test_the_actions_are_those_of_the_command_line():
    assert [each.value for each in Action] == ["enable", "disable", "halt", "quick-stop", "fault-reset", "home", "mode"]


def test_a_joint_speaks_of_the_same():
    assert joint.Action is Action
    assert joint.Wish is Wish
