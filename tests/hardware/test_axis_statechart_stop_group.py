"""Up together, down together."""

import pytest

from canopen_control.cia402.drive import DriveMachine
from canopen_control.hardware.axis_statechart import (
    AxisPhase,
    AxisStatechart,
    PhaseTrigger,
    StopGroup,
    merge_base_groups,
)

pytestmark = pytest.mark.sources  # stand-ins for an axis or a joint

UP, DOWN = (PhaseTrigger.ENABLE,), (PhaseTrigger.ENABLE, PhaseTrigger.DRIVE_ENABLED, PhaseTrigger.STOP)


class Joint:
    """As much of a joint as a group sees: its power, and what the drive says."""

    def __init__(self, *triggers, ready=False):
        self.statechart = AxisStatechart(DriveMachine("a drive"))
        for trigger in triggers:
            self.statechart.fire(trigger, 0)
        self.is_enabled_or_ready = self.at_rest = ready
        self.stopped = False

    @property
    def enable_requested(self):
        return self.statechart.enable_requested

    @property
    def state(self):
        return self.statechart.state

    def has_settled(self, now):
        return self.at_rest

    def stop(self, now):
        self.stopped = True


def group_of(*joints):
    group = StopGroup()
    group.joints, group.busy = list(joints), True
    return group


def test_no_joint_is_enabled_before_all_are_ready():
    first, last = Joint(*UP, ready=True), Joint(*UP)
    group = group_of(first, last)
    group.coordinate(0)
    assert first.state is AxisPhase.SWITCHING_ON
    last.is_enabled_or_ready = True
    group.coordinate(0)
    assert first.state is last.state is AxisPhase.ENABLING
    first.statechart.fire(PhaseTrigger.DRIVE_ENABLED, 0)
    group.coordinate(0)
    assert first.state is AxisPhase.ENABLED, "until the other is enabled"
    last.statechart.fire(PhaseTrigger.DRIVE_ENABLED, 0)
    group.coordinate(0)
    assert first.state is last.state is AxisPhase.READY
    assert not group.busy


def test_others_stay_at_standstill_until_an_enabling_joint_is_enabled():
    first, last = (
        Joint(*UP, PhaseTrigger.DRIVE_ENABLED, PhaseTrigger.GROUP_ENABLED, PhaseTrigger.MOTION_PERMITTED),
        Joint(*UP),
    )
    group = group_of(first, last)
    assert first.statechart.following
    group.coordinate(0)
    assert first.state is AxisPhase.ENABLED
    assert not first.statechart.following


def test_no_joint_is_disabled_before_all_are_at_standstill():
    first, last = Joint(*DOWN, ready=True), Joint(*DOWN)
    group = group_of(first, last)
    group.coordinate(0)
    assert first.state is AxisPhase.RAMPING_DOWN
    last.at_rest = True
    group.coordinate(0)
    assert first.state is last.state is AxisPhase.DISABLING
    group.coordinate(0)
    assert not group.busy


def test_a_group_is_looked_at_no_longer_than_one_of_it_rises_or_falls():
    group = group_of(Joint(*DOWN, ready=True), Joint(*DOWN, ready=True))
    group.coordinate(0)
    assert [joint.state for joint in group.joints] == [AxisPhase.DISABLING] * 2
    assert not group.busy, "in the cycle that disables them"


def test_a_joint_that_did_not_stop_in_time_no_longer_blocks_the_others():
    first, last = Joint(*DOWN, ready=True), Joint(*DOWN)
    group = group_of(first, last)
    last.statechart.fire(PhaseTrigger.TIMEOUT, 0)
    group.coordinate(0)
    assert (first.state, last.state) == (AxisPhase.DISABLING, AxisPhase.FORCED_QUICK_STOP)


def named(**groups):
    """Return a joint for each name, in the stop groups that are given."""
    created = {group: StopGroup(group) for group in groups.values()}
    joints = {}
    for name, group in groups.items():
        joint = Joint()
        joint.joint, joint.base = name, None
        joint.stop_group = joint.group = created[group]
        created[group].joints.append(joint)
        joints[name] = joint
    return joints


def test_the_joints_of_a_base_are_one_group_with_whatever_theirs_were():
    joints = named(left="a", right="b", arm="b", lamp="c")
    merge_base_groups(joints.values(), {"base": ("left", "right")}, 0)
    left = joints["left"].group
    assert [joints[item].group is left for item in ("right", "arm", "lamp")] == [True, True, False]
    assert left.joints == [joints["left"], joints["right"], joints["arm"]]
    assert left.busy
    assert [joint.base and joint.base.name for joint in joints.values()] == ["base", "base", None, None]
    merge_base_groups(joints.values(), {"base": ("left", "right")}, 0)
    assert joints["arm"].group is left, "the same one as long as nothing changes"
    merge_base_groups(joints.values(), {}, 0)
    assert [joint.group.name for joint in joints.values()] == ["a", "b", "b", "c"]
    assert joints["left"].base is None


def test_two_bases_that_share_a_group_are_one():
    joints = named(one="a", two="b", three="b", four="c")
    merge_base_groups(joints.values(), {"front": ("one", "two"), "rear": ("three", "four")}, 0)
    assert len({joint.group for joint in joints.values()}) == 1
    assert joints["three"].base.name == "rear"


def test_a_base_of_which_a_part_is_enabled_is_stopped():
    joints = named(left="a", right="a")
    joints["left"].statechart.fire(PhaseTrigger.ENABLE, 0)
    merge_base_groups(joints.values(), {"base": ("left", "right")}, 0)
    assert joints["left"].stopped
    assert not joints["right"].stopped


@pytest.mark.parametrize("expected", [True, False])
def test_a_stop_is_for_all_and_names_those_that_were_to_move(expected):
    joints = [Joint(*(UP if expected else ())), Joint()]
    group = group_of(*joints)
    assert group.stop(0) == ([joints[0]] if expected else [])
    assert all(joint.stopped for joint in joints)
