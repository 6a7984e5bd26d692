import contextlib
import os
import signal
import subprocess
import sys

import pytest
from support.host import eventually

from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError, RobotConfigError
from canopen_control.host.sockets import list_sockets
from canopen_control.physics.physics_file import PhysicsError
from canopen_control.rpc.messages.drive import AddPayload, GetWorld, GetWorldShapes
from canopen_control.runtime import shared_world
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.runtime.shared_world import SharedRobot, SharedRun, read_shared

HALL = """robots:
  - {name: hall_a, robot: robby, at: [0, 0]}
  - {name: hall_b, robot: robby, at: [1, 0], heading: 180}
"""


def written(tmp_path, text=HALL):
    path = tmp_path / "hall.yml"
    path.write_text(text)
    return path


def test_each_robot_has_buses_of_its_own_name_and_is_run_without_drives(tmp_path):
    first, second = read_shared(written(tmp_path))
    assert first.setup.channels == {"can": "local:hall_a"}
    assert second.arguments == ("run", "robby", "--as", "hall_b", "--no-drives", "--can=can=local:hall_b")


def test_arguments_and_controllers_of_a_robot_go_to_its_runtime(tmp_path):
    text = "robots: [{name: a, robot: diffbot_sim, controllers: [diff_drive_base_controller]}]"
    (robot,) = read_shared(written(tmp_path, text))
    assert robot.arguments[-1] == "--controller=diff_drive_base_controller"
    assert robot.setup.to_activate[-1] == "diff_drive_base_controller"


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("robot: robby, at: [1", "robot: robbi, at: [1", RobotConfigError, r"hall\.yml:3:5: hall_b: no robot 'robbi'"),
        ("hall_b", "hall_a", PhysicsError, r"hall\.yml:3:5: .*named hall_a exists already"),
        ("at: [1, 0]", "at: [1]", PhysicsError, r"hall\.yml:3:38: .*at"),
        (HALL, "boxes: []", RobotConfigError, "it names no robots"),
    ],
)
def test_errors_are_reported_with_their_place(tmp_path, old, new, error, message):
    with pytest.raises(error, match=message):
        read_shared(written(tmp_path, HALL.replace(old, new, 1)))


class EndingChild:
    """A child process that is ready at once, and ends with `returncode` when the run is interrupted."""

    def __init__(self, returncode):
        self.returncode, self.heard_at, self._is_robot = returncode, 1, returncode is not None

    def watch(self, reactor, _on_exit):
        if self._is_robot:
            reactor.call_soon(lambda: signal.raise_signal(signal.SIGINT))

    def watch_ready(self, reactor, on_ready):
        reactor.call_soon(on_ready)

    def last_lines(self, _count):
        return []

    def wait(self, _grace):
        return 0

    def unwatch(self, *_): ...

    unwatch_ready = terminate = unwatch


@pytest.mark.parametrize(("code", "failed"), [(0, False), (130, False), (1, True)])
def test_a_robot_that_fails_while_the_run_ends_fails_the_run(tmp_path, monkeypatch, code, failed):
    setup = read_robot(find_robot("robby"), name="one", can=["local:one"])
    monkeypatch.setattr(shared_world, "write_buses", lambda folder, *_: folder / "buses.yml")
    monkeypatch.setattr(shared_world, "_write_plant_file", lambda _setup: tmp_path)
    monkeypatch.setattr(shared_world, "spawn", lambda *_, name, **__: EndingChild(code if name == "one" else None))
    run = SharedRun([SharedRobot(setup, ("run", "robby"))], tmp_path, print)
    with pytest.raises(CanopenError, match="one ended with exit code 1") if failed else contextlib.nullcontext():
        run.run()


def world(name, request):
    with DriveClient.connect(f"local:{name}", 3) as client:
        return client.ask(request)


@pytest.mark.process
def test_two_robots_share_a_world_one_dies_alone_and_nothing_is_left(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    argv = [sys.executable, "-m", "canopen_control", "run", "--world", str(written(tmp_path)), "--no-flight-recorder"]
    run = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    try:
        lines = []
        for line in run.stdout:
            lines.append(line)
            if sum(" runs: " in item for item in lines) == 2:
                break
        assert world("hall_b", GetWorld()).base.x == pytest.approx(1.0, abs=0.01)
        assert {item.robot for item in world("hall_a", GetWorldShapes())} == {"hall_b"}
        world("hall_a", AddPayload(mass=1.0))
        pids = [int(line.split()[0]) for line in _processes() if "--as hall_b" in line]
        os.kill(pids[0], signal.SIGKILL)
        line = next(line for line in run.stdout if "hall_b ended" in line)
        assert "its drives stop, hall_a continues; start it again with: canopen-control run robby --as hall_b" in line
        assert "robot-hall_a" in [f"robot-{socket}" for socket in list_sockets("robot")]
        run.send_signal(signal.SIGINT)
        assert run.wait(60) == 1  # a robot failed
        assert eventually(lambda: not [item for item in _processes() if "hall_" in item and "pytest" not in item])
        assert not [socket for socket in list_sockets("drive") if socket.startswith("hall_")]
    finally:
        run.kill()
        run.wait()
        run.stdout.close()


def _processes():
    return subprocess.run(
        ["ps", "-ww", "-eo", "pid,args"], capture_output=True, text=True, check=True
    ).stdout.splitlines()
