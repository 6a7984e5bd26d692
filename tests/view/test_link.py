"""The connection to a robot, on mock hardware in this process."""

import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.robot import CommandController, Release, Tell
from canopen_control.rpc.messages.state import RobotEvent, StateSample
from canopen_control.view.link import Link

FORWARD = "robby_forward_controller"


@pytest.fixture
def robot(private_folders):
    with running() as robot:
        yield robot


@pytest.fixture
def link(robot):
    link = Link("mock")
    yield link
    link.close()


def test_a_robot_says_what_it_is(link):
    welcome = link.welcome()
    assert welcome.robot == "mock"
    assert "<robot" in welcome.urdf
    assert welcome.path.endswith("robby.urdf.xacro")
    assert welcome.joints == ("left_wheel_joint", "right_wheel_joint")
    assert FORWARD in [each.name for each in link.controllers()]


def test_samples_come_at_the_rate_that_was_asked_for(link):
    link.subscribe(25.0)
    states = []
    assert eventually(
        lambda: states.extend(each for each in link.messages() if isinstance(each, StateSample)) or len(states) >= 3
    )
    assert (states[2].cycle.count - states[1].cycle.count) % 2 == 0


def test_stop_latches_and_nobody_waits_for_it(robot, link):
    link.stop()
    assert eventually(lambda: robot.status().latched)
    assert robot.status().latched_by == "view"
    refused = link.ask(CommandController(controller=FORWARD, values=[1.0, 1.0]))
    assert "STOP is latched (by view)" in refused
    assert link.ask(Release()) is None
    assert not robot.status().latched


def test_a_command_is_sent_without_an_answer(robot, link):
    link.send(CommandController(controller=FORWARD, values=[1.0, 2.0], source="view", dead_man=True))
    assert eventually(lambda: robot.status().joints["right_wheel_joint"].command == 2.0)
    assert robot.status().commander == "view"
    link.close()  # as when this process dies
    assert eventually(lambda: robot.status().joints["right_wheel_joint"].command == 0.0)


def test_a_robot_that_has_gone_is_an_error_for_stop_and_a_sentence_for_questions(robot, link):
    robot.shutdown()
    with pytest.raises(RemoteError):
        list(link.messages())
    with pytest.raises(RemoteError):
        link.stop()
    assert "no robot 'mock' is running" in link.ask(Release())
    link.send(Release())
    with pytest.raises(ConfigError):
        Link("mock")


def test_events_come_and_of_many_samples_the_newest(robot, link):
    link.subscribe(50.0)
    link.send(Tell(kind="view", text="here"))
    first = robot.status().cycle.count
    assert eventually(lambda: robot.status().cycle.count > first + 25)
    found = list(link.messages())
    assert "here" in [each.text for each in found if isinstance(each, RobotEvent)]
    assert len([each for each in found if isinstance(each, StateSample)]) == 1
