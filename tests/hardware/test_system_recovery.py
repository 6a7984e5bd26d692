"""Who may be enabled again, and when."""

from types import SimpleNamespace

import pytest

from canopen_control.errors import DriveError
from canopen_control.hardware.axis_power import AxisState
from canopen_control.hardware.system import Recovery


def make(count=2):
    group = SimpleNamespace(joints=[])
    for number in range(count):
        joint = SimpleNamespace(
            joint=f"joint_{number}",
            node=SimpleNamespace(name=f"drive_{number}", ready=True),
            parameters=SimpleNamespace(loaded=True),
            machine=SimpleNamespace(fault=False, reached=True),
            state=object(),
            standing=True,
            resume=True,
            power=SimpleNamespace(state=AxisState.OFF),
            group=group,
            enabled=0,
            wanted=False,
            stopped=False,
        )
        joint.stop = lambda now, joint=joint: setattr(joint, "stopped", True)
        joint.enable = lambda joint=joint: vars(joint).update(enabled=joint.enabled + 1, wanted=True)
        group.joints.append(joint)
    events = []
    return Recovery(group.joints, events.append), group.joints, events


def test_all_that_wait_are_enabled_together_and_once():
    recovery, joints, events = make()
    recovery.step(0)
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [1, 1]
    assert len(events) == 1
    assert "joint_0, joint_1" in events[0].text


def unready(joint):
    joint.node.ready = False


def unloaded(joint):
    joint.parameters.loaded = False


def faulted(joint):
    joint.machine.fault = True


def moving(joint):
    joint.standing = False


def stopping(joint):
    joint.power.state = AxisState.BRAKING


@pytest.mark.parametrize("hinder", [unready, unloaded, faulted, moving, stopping])
def test_one_that_cannot_go_keeps_all(hinder):
    recovery, joints, events = make()
    hinder(joints[1])
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [0, 0]
    assert events == []


def test_who_does_not_wait_is_left_alone():
    recovery, joints, _ = make()
    joints[1].resume = False
    unready(joints[1])
    recovery.step(0)
    assert [joint.enabled for joint in joints] == [1, 0]


def test_a_drive_that_refuses_keeps_the_others_of_its_group_off():
    recovery, joints, events = make()

    def refuse():
        raise DriveError("no")

    joints[1].enable = refuse
    recovery.step(0)
    assert joints[0].stopped
    assert [event.kind for event in events] == ["recovered", "not_enabled", "not_enabled"]
    assert "joint_0 stay disabled with joint_1 (drive_1)" in events[-1].text


def test_a_drive_that_refuses_is_told():
    recovery, joints, events = make(1)

    def refuse():
        raise DriveError("no")

    joints[0].enable = refuse
    recovery.step(0)
    assert [event.kind for event in events] == ["recovered", "not_enabled"]
    assert not joints[0].resume
