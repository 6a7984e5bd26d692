import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.errors import RemoteError
from canopen_control.monitor import sources as module
from canopen_control.monitor.sources import RobotLink
from canopen_control.rpc.messages.robot import LoadController, Stop


@pytest.fixture
def link(private_folders, monkeypatch):
    monkeypatch.setattr(module, "AGAIN_S", 0.05)
    link = RobotLink()
    link.start()
    yield link
    link.close()


@pytest.mark.rest
def test_it_finds_the_robot_loses_it_and_finds_it_again(link):
    assert eventually(lambda: link.why.startswith("no robot is running"))
    assert link.state is None
    for _ in range(2):
        with running(real_time=True):
            assert eventually(lambda: link.connected)
            assert link.name == "mock"
            assert link.state.state == "running"
            assert link.why == ""
        assert eventually(lambda: link.state is None)
        assert "mock" in link.why


def test_each_event_is_told_once_also_those_from_before(link):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        texts = [event.text for event in link.events()]
        assert sum("mock runs" in text for text in texts) == 1
        assert not [event for event in link.events() if "mock runs" in event.text]
        link.ask(Stop(latch=True, source="test"), 10.0)
        found = []
        assert eventually(lambda: found.extend(link.events()) or any(each.kind == "stop_latched" for each in found))
        assert sum(each.kind == "stop_latched" for each in found) == 1


def test_a_connection_that_broke_is_made_again_and_what_was_told_is_not_told_again(link):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        first = link._robot
        told = link.events()
        assert told
        first.close()
        assert eventually(lambda: link.connected and link._robot is not first)
        assert not [event for event in link.events() if event in told]


def test_commands_reach_the_robot_or_say_why_not(link):
    assert eventually(lambda: link.why.startswith("no robot is running"))
    with pytest.raises(RemoteError, match="stop does not reach the robot: no robot is running"):
        link.ask(Stop(), 1.0)
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        with pytest.raises(RemoteError, match="nobody"):
            link.ask(LoadController(controller="nobody"), 1.0)


def test_a_robot_that_hangs_is_not_shown_as_connected(link, monkeypatch):
    with running(real_time=True):
        assert eventually(lambda: link.connected)
        link._heard -= 1.1  # as if the last sample had come so long ago
        assert not link.connected
