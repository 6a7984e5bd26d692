import pytest

from canopen_control.rpc.messages.robot import CommandController, TwistController
from canopen_control.rpc.messages.trajectory import SendTrajectory, TrajectoryHeartbeat
from canopen_control.view.robot_connection import LET_GO_NS, DeadMan, joint_motion, trajectory_motion, twist_motion

MS = 1_000_000
FORWARD = twist_motion("base", 0.2, 0.0)
REST = TwistController(controller="base", linear=0.0, angular=0.0, source="view", dead_man=True)
MOVE = TwistController(controller="base", linear=0.2, angular=0.0, source="view", dead_man=True)


@pytest.fixture
def sent():
    return []


@pytest.fixture
def man(sent):
    return DeadMan(sent.append)


def test_a_held_button_sends_again_and_again(man, sent):
    assert man.hold("page 1", FORWARD, 0)
    assert man.hold("page 1", FORWARD, 50 * MS)
    assert sent == [MOVE, MOVE]
    assert man.deadline == 50 * MS + LET_GO_NS


def test_silence_ends_the_motion_once(man, sent):
    man.hold("page 1", FORWARD, 0)
    man.tick(LET_GO_NS - 1)
    assert sent == [MOVE]
    man.tick(LET_GO_NS)
    man.tick(2 * LET_GO_NS)
    assert sent == [MOVE, REST]
    assert (man.driver, man.deadline) == (None, None)


def test_a_closed_page_ends_its_own_motion_at_once_and_no_other(man, sent):
    man.hold("page 1", FORWARD, 0)
    man.leave("page 2")
    assert sent == [MOVE]
    man.leave("page 1")
    assert sent == [MOVE, REST]


def test_one_page_drives_at_a_time(man, sent):
    man.hold("page 1", FORWARD, 0)
    assert not man.hold("page 2", FORWARD, 10 * MS)
    assert sent == [MOVE]
    assert man.hold("page 2", FORWARD, 10 * MS + LET_GO_NS)  # the first has let go by then
    assert sent == [MOVE, REST, MOVE]
    assert man.driver == "page 2"


def test_another_controller_does_not_leave_the_first_one_moving(man, sent):
    man.hold("page 1", FORWARD, 0)
    man.hold("page 1", joint_motion("arm", [1.0, 2.0], [0.0, 0.0]), 10 * MS)
    arm = CommandController(controller="arm", values=[1.0, 2.0], source="view", dead_man=True)
    assert sent == [MOVE, REST, arm]


def test_letting_go_of_nothing_sends_nothing(man, sent):
    man.let_go()
    man.leave("page 1")
    man.tick(10**12)
    assert sent == []


def test_what_stop_has_ended_is_not_ended_again(man, sent):
    man.hold("page 1", FORWARD, 0)
    man.forget()
    man.tick(10**12)
    assert (sent, man.driver) == ([MOVE], None)


def test_an_arm_is_sent_its_way_once_and_cancelled_when_it_is_let_go(man, sent):
    there, further = (trajectory_motion("arm", ["a"], [to], 2.0) for to in (1.0, 1.5))
    for number, motion in enumerate((there, there, further)):
        man.hold("page 1", motion, number * 50 * MS)
    man.tick(100 * MS + LET_GO_NS)
    assert sent == [there.moving, TrajectoryHeartbeat(), further.moving, further.resting]
    assert isinstance(sent[0], SendTrajectory)
    assert sent[0].dead_man
    assert sent[0].heartbeat * 1e9 > LET_GO_NS  # the page's silence ends it in order; that of this process, the robot
    man.hold("page 1", further, 10**12)
    assert sent[-1] == further.moving  # after it was let go of, it is sent anew
