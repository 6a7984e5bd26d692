"""The connection to a robot, on mock hardware in this process."""

import asyncio
import threading

import pytest
from support.host import eventually
from support.mockrobot import running
from support.pages import info, state

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.robot import CommandController, PublishEvent, Release, TwistController
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.rpc.messages.trajectory import SendTrajectory, TrajectoryHeartbeat
from canopen_control.view.robot_connection import (
    HOLD_TIMEOUT_NS,
    DeadMan,
    RobotConnection,
    in_thread,
    joint_motion,
    pose_of,
    trajectory_motion,
    twist_motion,
)


def test_the_pose_is_that_of_the_first_base_controller():
    result = state(samples={"base": {"kind": "odometry", "time": 1.0, "x": 1.0, "y": 2.0, "heading": 0.5}})
    assert pose_of(result) == (1.0, 2.0, 0.5)
    assert pose_of(state()) is None


def test_a_page_begins_with_what_the_status_reports():
    result = info()
    assert (result.robot, result.joints, result.buses) == ("pair", ("left", "lift"), ("can",))
    assert result.nodes[0].channel == "local:x"
    assert (result.state.state, result.state.load) == ("running", {"can": 0.02})


MS = 1_000_000
FORWARD_OF_DEAD_MAN = twist_motion("base", 0.2, 0.0)
REST = TwistController(controller="base", linear=0.0, angular=0.0, source="view", dead_man=True)
MOVE = TwistController(controller="base", linear=0.2, angular=0.0, source="view", dead_man=True)


@pytest.fixture
def sent():
    return []


@pytest.fixture
def man(sent):
    return DeadMan(sent.append)


def test_a_held_button_sends_again_and_again(man, sent):
    assert man.hold("page 1", FORWARD_OF_DEAD_MAN, 0)
    assert man.hold("page 1", FORWARD_OF_DEAD_MAN, 50 * MS)
    assert sent == [MOVE, MOVE]
    assert man.deadline == 50 * MS + HOLD_TIMEOUT_NS


def test_silence_ends_the_motion_once(man, sent):
    man.hold("page 1", FORWARD_OF_DEAD_MAN, 0)
    man.tick(HOLD_TIMEOUT_NS - 1)
    assert sent == [MOVE]
    man.tick(HOLD_TIMEOUT_NS)
    man.tick(2 * HOLD_TIMEOUT_NS)
    assert sent == [MOVE, REST]
    assert (man.driver, man.deadline) == (None, None)


def test_a_closed_page_ends_its_own_motion_at_once_and_no_other(man, sent):
    man.hold("page 1", FORWARD_OF_DEAD_MAN, 0)
    man.leave("page 2")
    assert sent == [MOVE]
    man.leave("page 1")
    assert sent == [MOVE, REST]


def test_one_page_drives_at_a_time(man, sent):
    man.hold("page 1", FORWARD_OF_DEAD_MAN, 0)
    assert not man.hold("page 2", FORWARD_OF_DEAD_MAN, 10 * MS)
    assert sent == [MOVE]
    assert man.hold("page 2", FORWARD_OF_DEAD_MAN, 10 * MS + HOLD_TIMEOUT_NS)  # the first has let go by then
    assert sent == [MOVE, REST, MOVE]
    assert man.driver == "page 2"


def test_another_controller_does_not_leave_the_first_one_moving(man, sent):
    man.hold("page 1", FORWARD_OF_DEAD_MAN, 0)
    man.hold("page 1", joint_motion("arm", [1.0, 2.0], [0.0, 0.0]), 10 * MS)
    arm = CommandController(controller="arm", values=[1.0, 2.0], source="view", dead_man=True)
    assert sent == [MOVE, REST, arm]


def test_an_arm_is_sent_its_way_once_and_cancelled_when_it_is_released(man, sent):
    there, further = (trajectory_motion("arm", ["a"], [to], 2.0) for to in (1.0, 1.5))
    for number, motion in enumerate((there, there, further)):
        man.hold("page 1", motion, number * 50 * MS)
    man.tick(100 * MS + HOLD_TIMEOUT_NS)
    assert sent == [there.moving, TrajectoryHeartbeat(), further.moving, further.resting]
    assert isinstance(sent[0], SendTrajectory)
    assert sent[0].dead_man
    assert (
        sent[0].heartbeat * 1e9 > HOLD_TIMEOUT_NS
    )  # the page's silence ends it in order; that of this process, the robot
    man.hold("page 1", further, 10**12)
    assert sent[-1] == further.moving  # after its release it is sent again


FORWARD = "robby_forward_controller"


@pytest.fixture
def robot(private_folders):
    with running(real_time=True) as robot:
        yield robot


@pytest.fixture
def connection(robot):
    connection = RobotConnection("mock")
    yield connection
    connection.close()


def test_samples_come_at_the_rate_that_was_asked_for(connection):
    connection.subscribe(25.0)
    states = []
    assert eventually(
        lambda: (
            states.extend(message for message in connection.messages() if isinstance(message, StateSample))
            or len(states) >= 3
        )
    )
    assert (states[2].cycle.count - states[1].cycle.count) % 2 == 0


def test_stop_latches_without_waiting(robot, connection):
    connection.stop()
    assert eventually(lambda: robot.status().latched)
    assert robot.status().latched_by == "view"
    refused = connection.ask(CommandController(controller=FORWARD, values=[1.0, 1.0]))
    assert "STOP is latched (by view)" in refused
    assert connection.ask(Release()) is None
    assert not robot.status().latched


def test_a_command_is_sent_without_an_answer(robot, connection):
    connection.send(CommandController(controller=FORWARD, values=[1.0, 2.0], source="view", dead_man=True))
    assert eventually(lambda: robot.status().joints["right_wheel_joint"].command == 2.0)
    assert robot.status().commander == "view"
    connection.close()  # as when this process dies
    assert eventually(lambda: robot.status().joints["right_wheel_joint"].command == 0.0)


def test_a_robot_that_has_gone_is_an_error_for_stop_and_a_sentence_for_questions(robot, connection):
    robot.shutdown()
    with pytest.raises(RemoteError):
        list(connection.messages())
    with pytest.raises(RemoteError):
        connection.stop()
    assert "no robot 'mock' is running" in connection.ask(Release())
    connection.send(Release())
    with pytest.raises(ConfigError):
        RobotConnection("mock")


def test_events_come_and_of_many_samples_the_newest(robot, connection):
    connection.subscribe(50.0)
    connection.send(PublishEvent(kind="view", text="here"))
    first = robot.status().cycle.count
    assert eventually(lambda: robot.status().cycle.count > first + 25)
    result = list(connection.messages())
    assert "here" in [item.text for item in result if isinstance(item, RobotEvent)]
    assert len([item for item in result if isinstance(item, StateSample)]) == 1


async def test_it_returns_and_raises_what_the_function_does_while_the_loop_continues():
    ticked = threading.Event()

    async def tick():
        await asyncio.sleep(0)
        ticked.set()

    task = asyncio.ensure_future(tick())
    assert await in_thread(lambda: "done" if ticked.wait(60) else "the loop stood still") == "done"
    with pytest.raises(ZeroDivisionError):
        await in_thread(lambda: 1 / 0)
    await task


def test_what_hangs_does_not_hold_up_the_end():
    release, hangs, ended = threading.Event(), threading.Event(), threading.Event()

    def hang():
        hangs.set()
        release.wait(60)
        ended.set()

    async def play():
        task = asyncio.ensure_future(in_thread(hang))
        while not hangs.is_set():
            await asyncio.sleep(0)
        task.cancel()

    asyncio.run(play())
    assert not ended.is_set()
    release.set()
    assert ended.wait(60)


@pytest.mark.parametrize("before", [True, False], ids=["before_it_came", "when_it_has_come"])
def test_what_a_cancelled_caller_no_longer_takes_is_discarded(before):
    """The end of the page while it connected left an open socket behind."""
    release, came, discarded = threading.Event(), threading.Event(), []

    def connect():
        came.set()
        release.wait(60)
        return "connection"

    async def play():
        task = asyncio.ensure_future(in_thread(connect, discard=discarded.append))
        await asyncio.sleep(0)
        if not before:
            release.set()
            assert eventually(lambda: not pages())  # the loop stands still: it has come, and nobody has taken it
        task.cancel()

    asyncio.run(play())
    assert came.wait(60)
    release.set()
    assert eventually(lambda: discarded == ["connection"])


def pages():
    return [thread for thread in threading.enumerate() if thread.name == "page"]
