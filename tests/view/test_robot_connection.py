"""The connection to a robot, on mock hardware in this process."""

import asyncio
import threading
import time

import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.robot import CommandController, Release, Tell
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.view.robot_connection import RobotConnection, in_thread

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


def test_a_robot_says_what_it_is(connection):
    info = connection.robot_info()
    assert info.robot == "mock"
    assert "<robot" in info.urdf
    assert info.path.endswith("robby.urdf.xacro")
    assert info.joints == ("left_wheel_joint", "right_wheel_joint")
    assert FORWARD in [each.name for each in connection.controllers()]


def test_samples_come_at_the_rate_that_was_asked_for(connection):
    connection.subscribe(25.0)
    states = []
    assert eventually(
        lambda: (
            states.extend(each for each in connection.messages() if isinstance(each, StateSample)) or len(states) >= 3
        )
    )
    assert (states[2].cycle.count - states[1].cycle.count) % 2 == 0


def test_stop_latches_and_nobody_waits_for_it(robot, connection):
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
    connection.send(Tell(kind="view", text="here"))
    first = robot.status().cycle.count
    assert eventually(lambda: robot.status().cycle.count > first + 25)
    found = list(connection.messages())
    assert "here" in [each.text for each in found if isinstance(each, RobotEvent)]
    assert len([each for each in found if isinstance(each, StateSample)]) == 1


def test_it_returns_and_raises_what_the_function_does_while_the_loop_goes_on():
    ticked = threading.Event()

    async def play():
        async def tick():
            await asyncio.sleep(0)
            ticked.set()

        task = asyncio.ensure_future(tick())
        assert await in_thread(lambda: "done" if ticked.wait(10) else "the loop stood still") == "done"
        with pytest.raises(ZeroDivisionError):
            await in_thread(lambda: 1 / 0)
        await task

    asyncio.run(play())


def test_what_hangs_does_not_hold_up_the_end():
    release, hangs = threading.Event(), threading.Event()

    def hang():
        hangs.set()
        release.wait(30)

    async def play():
        task = asyncio.ensure_future(in_thread(hang))
        while not hangs.is_set():
            await asyncio.sleep(0)
        task.cancel()

    begin = time.monotonic()
    asyncio.run(play())
    release.set()
    assert time.monotonic() - begin < 5
