import signal

import pytest

from canopen_control.errors import CanopenError
from canopen_control.host.reactor import Reactor
from canopen_control.master.events import Level
from canopen_control.runtime.files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.supervisor import Supervisor, hosts_virtual_drives

SECOND = 1_000_000_000


@pytest.fixture
def supervisor():
    reactor, events = Reactor(), []
    supervisor = Supervisor("test", reactor, events.append)
    supervisor.reactor, supervisor.events = reactor, events
    yield supervisor
    supervisor.end()
    reactor.close()


def gone(pid):
    import os

    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_a_child_that_dies_is_told_with_its_last_words(supervisor):
    supervisor.start_client("talker", ["this_module_does_not_exist"])
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    text = supervisor.events[0].text
    assert "process talker" in text
    assert "exit code 1" in text
    assert "this_module_does_not_exist" in text
    assert supervisor.pids == {}


def test_a_child_that_is_killed_is_told_with_the_signal(supervisor):
    import os

    supervisor.start_client("sleeper", ["asyncio"])
    os.kill(supervisor.pids["sleeper"], signal.SIGKILL)
    assert supervisor.reactor.run_until(lambda: bool(supervisor.events), 20 * SECOND)
    assert "signal 9" in supervisor.events[0].text


def test_ending_leaves_no_child_and_tells_nothing(supervisor):
    supervisor.start_client("one", ["http.server", "--help"])
    supervisor.start_client("two", ["asyncio"])
    pids = list(supervisor.pids.values())
    supervisor.end()
    assert all(gone(pid) for pid in pids)
    assert supervisor.events == []
    supervisor.end()


@pytest.mark.parametrize(
    ("channel", "hosts"),
    [
        ("local:x", True),
        ("memory:x", True),
        ("virtual:x", True),
        ("vcan0", True),
        ("can0", False),
        ("pcan:PCAN_USBBUS1", False),
    ],
)
def test_virtual_drives_are_started_only_where_no_real_one_can_be(channel, hosts):
    assert hosts_virtual_drives(read_robot(find_robot("robby"), can=[channel])) is hosts


def test_a_recorder_that_cannot_be_started_is_a_warning_and_no_more(supervisor, monkeypatch):
    def refuse(*_args, **_options):
        raise CanopenError("cannot start flight: no")

    monkeypatch.setattr("canopen_control.runtime.supervisor.spawn", refuse)
    supervisor.start_recorder({"can": "local:x"})
    assert [(event.kind, event.level) for event in supervisor.events] == [("no_recorder", Level.WARNING)]


def test_where_the_recorder_wrote_after_the_robots_end_is_told(supervisor, monkeypatch):
    script = "import signal; print('a line', flush=True); print('flight recording: x.zip', flush=True); signal.pause()"
    monkeypatch.setattr("canopen_control.runtime.supervisor._RECORDER", script)
    supervisor.start_recorder({})
    child = supervisor._recorder
    assert supervisor.reactor.run_until(lambda: len(child.last_lines()) == 2, 20 * SECOND)
    assert "flight" in supervisor.pids
    supervisor.end()
    assert [(event.kind, event.text) for event in supervisor.events] == [("flight", "flight recording: x.zip")]
    supervisor.end()
    assert len(supervisor.events) == 1
