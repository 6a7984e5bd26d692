"""A starting robot waits for its processes: however long that takes, nothing is reported before.

With `--spawn` the drives begin as interpreters, which takes long enough for a test to stop them. Forks do not: by a
hook in a `sitecustomize` of the test each drive stops itself at its birth.
"""

import contextlib
import os
import signal
import time

import pytest
from support.channel import channel_of
from support.host import eventually
from support.localbus import hub_status

from canopen_control.errors import BusError

STOP_AT_BIRTH = """
import os, signal, sys

def stop():
    frame = sys._getframe()
    while frame is not None and "argv" not in frame.f_locals:
        frame = frame.f_back
    argv = [] if frame is None else [*frame.f_locals["argv"]]
    if "--node-id" in argv:
        node = argv[argv.index("--node-id") + 1]
        with open(os.path.join(os.path.dirname(__file__), node), "w") as file:
            file.write(f"{os.getpid()}\\n")
        os.kill(os.getpid(), signal.SIGSTOP)

os.register_at_fork(after_in_child=stop)
"""


class StoppedForks:
    """Folder of a `sitecustomize` that stops each forked drive at its birth."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "sitecustomize.py").write_text(STOP_AT_BIRTH)

    @property
    def path(self):
        """Value of PYTHONPATH with the hook."""
        return os.pathsep.join([str(self.folder), *filter(None, [os.environ.get("PYTHONPATH")])])

    def pid_of(self, node_id):
        """Wait for the drive of a node to be stopped; return its process id."""
        file = self.folder / str(node_id)
        assert eventually(lambda: file.exists() and file.read_text().endswith("\n")), f"node {node_id} was not forked"
        pid = int(file.read_text())
        assert eventually(lambda: _state_of(pid) == "T")
        return pid


def _state_of(pid):
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0]


@pytest.fixture
def stopped(tmp_path_factory):
    return StoppedForks(tmp_path_factory.mktemp("hook"))


@pytest.fixture(params=["forks", "interpreters"])
def stopped_drives(request, stage, stopped):
    """Return what starts a robot whose drives 2 and 3 are stopped while they start: it, and their process ids."""

    def start(name, *options):
        bus = channel_of(name)
        if request.param == "forks":
            robot = stage.start("run", "robby", "--as", name, "--can", bus, *options, PYTHONPATH=stopped.path)
            return robot, [stopped.pid_of(node_id) for node_id in (2, 3)]
        robot = stage.start("run", "robby", "--spawn", "--as", name, "--can", bus, *options)
        pids = [stage.pid_of(f"--node-id {node_id}") for node_id in (2, 3)]
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        return robot, pids

    return start


@pytest.mark.embedded
def test_drives_that_need_seconds_to_start_are_waited_for_and_nothing_is_reported_before(stage, stopped_drives):
    robot, drives = stopped_drives("slow", "--for", "1")
    time.sleep(4)  # a boot would have failed by now
    assert robot.out == ""
    for pid in drives:
        os.kill(pid, signal.SIGCONT)
    assert robot.wait() == 0
    reported = [
        line for line in robot.out.splitlines() if not line.startswith("a cycle was missed")
    ]  # on a busy machine
    assert reported[0].startswith("node "), robot.out
    assert "operational after" in reported[0]
    assert "error" not in robot.out
    assert not list(stage.place.glob("**/flight/*.zip"))


def is_on_bus(pid, name):
    with contextlib.suppress(BusError):  # no hub yet
        return pid in [member.pid for member in hub_status(name).members]
    return False


@pytest.mark.embedded
def test_ctrl_c_while_the_drives_start_ends_it(stopped_drives):
    robot, drives = stopped_drives("early")
    assert eventually(lambda: is_on_bus(robot.pid, "early"))
    robot.send(signal.SIGINT)
    robot.until("early was stopped before it started")
    for pid in drives:
        os.kill(pid, signal.SIGCONT)
    assert robot.wait() == 0


@pytest.mark.rest
@pytest.mark.embedded
def test_of_two_forks_one_killed_at_its_birth_is_named_and_the_other_one_becomes_operational(stage, stopped):
    robot = stage.start("run", "robby", "--as", "dead", "--can", channel_of("dead"), PYTHONPATH=stopped.path)
    right, left = (stopped.pid_of(node_id) for node_id in (2, 3))
    os.kill(right, signal.SIGKILL)
    os.kill(left, signal.SIGCONT)
    assert f"(pid {right}) was ended by signal 9; start it again: " in robot.until("process drive-right_drive")
    assert "left_drive" in robot.until("operational after")
