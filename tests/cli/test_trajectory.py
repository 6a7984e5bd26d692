import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.host import eventually
from support.lockstep import lockstep

from canopen_control import Robot
from canopen_control.cli.main import main
from canopen_control.cli.trajectory import sample_or_file
from canopen_control.client.trajectory_file import read_trajectory
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.urdf.description import read_description


@pytest.fixture
def arm(private_folders, tmp_path, request):
    with contextlib.ExitStack() as stack:
        if request.node.get_closest_marker("process") is None:
            stack.enter_context(lockstep())
        robot = stack.enter_context(Robot.from_config(copy_arm(tmp_path), mock=True, name="arm"))
        yield robot


@pytest.fixture
def wave(tmp_path):
    def write(seconds=1.5, count=30, joints=JOINTS):
        points = [
            {"positions": point.positions, "velocities": point.velocities, "time_from_start": point.time / 1e9}
            for point in planned([0.0] * 6, ENDS, seconds, count).points
        ]
        path = tmp_path / "wave.json"
        path.write_text(json.dumps({"joint_names": joints, "points": points}))
        return str(path)

    return write


def positions(arm):
    joints = arm.status().joints
    return [joints[joint].position for joint in JOINTS]


@pytest.mark.rest
def test_a_file_is_played_to_its_end(arm, wave, capsys):
    assert main(["trajectory", "play", wave(count=200)]) == 0
    assert capsys.readouterr().out == "the goal was reached\n"
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)


def test_waypoints_are_gone_to_one_after_the_other(arm, capsys):
    assert main(["trajectory", "play", "--waypoints", "0.2 -0.1 0.2 0.3 -0.1 0.4; 0 0 0 0 0 0.1", "--step", "0.3"]) == 0
    assert positions(arm) == pytest.approx([0.0] * 5 + [0.1], abs=1e-3)


@pytest.mark.rest
def test_what_the_joints_do_is_recorded_and_played_again(arm, wave, tmp_path, capsys):
    created, codes = str(tmp_path / "made.yaml"), []

    def move():
        codes.append(main(["trajectory", "play", wave(seconds=2.0)]))
        time.sleep(0.5)  # ten samples more, the last of a joint that stands
        os.kill(os.getpid(), signal.SIGINT)  # as Ctrl-C ends it: however long playing took on a busy machine

    mover = threading.Thread(target=move)
    mover.start()
    codes.append(main(["trajectory", "record", "-o", created, "--for", "60"]))
    mover.join(60)
    assert codes == [0, 0]
    joints, points = read_trajectory(created)
    assert joints == JOINTS
    assert points[-1].positions == pytest.approx(ENDS, abs=5e-3)
    assert points[-1].velocities == [0.0] * 6
    assert main(["trajectory", "play", "--waypoints", "0 0 0 0 0 0", "--step", "1.5"]) == 0
    assert main(["trajectory", "play", created, "--approach", "0.2"]) == 0
    assert positions(arm) == pytest.approx(ENDS, abs=5e-3)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["play"], "give what to play: a file, or --waypoints"),
        (["play", "x.yaml", "--waypoints", "0"], "give what to play"),
        (["play", "--waypoints", "0 0"], "'0 0', is not one position for each of the 6 joints"),
        (["play", "--waypoints", "0", "--controller", "leg"], "no controller 'leg' is loaded"),
        (
            ["record", "-o", "x.yaml", "--joints", "wrist"],
            "--joints wrist: name one or more joints of the robot: joint_1, ",
        ),
        (["record", "-o", "gone/x.yaml"], "gone/x.yaml: "),
        (["record", "-o", "x.yaml", "--controller", "leg"], "no joint trajectory controller 'leg' is loaded"),
    ],
)
def test_what_cannot_be_played_or_recorded_is_a_sentence(arm, words, text, capsys):
    assert main(["trajectory", *words]) == 2
    assert text in capsys.readouterr().err


@pytest.mark.rest
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["record", "-o", "x.yaml", "--for", "0.1"], "no joint moved, so nothing was recorded"),
        (["cancel"], "is not executing a trajectory; nothing was cancelled"),
        (["cancel", "--controller", "joint_state_broadcaster"], "is not a joint trajectory controller"),
    ],
)
def test_where_nothing_is_to_be_done_it_reports_this(arm, words, text, capsys):
    assert main(["trajectory", *words]) == 1
    assert text in capsys.readouterr().err


def test_another_shell_ends_it_and_the_first_one_reports_this(arm, wave, capsys):
    codes = []
    playing = threading.Thread(target=lambda: codes.append(main(["trajectory", "play", wave(seconds=20.0)])))
    playing.start()
    time.sleep(1.0)
    assert main(["trajectory", "cancel"]) == 0
    playing.join(60)
    assert codes == [1]
    assert "cancelled" in capsys.readouterr().err
    where = positions(arm)
    time.sleep(0.2)
    assert positions(arm) == pytest.approx(where, abs=1e-3)


def test_what_is_refused_is_the_robots_sentence(arm, wave, capsys):
    assert main(["trajectory", "play", wave(joints=[*JOINTS[:5], "elbow"])]) == 1
    assert "'elbow', which is not a joint of this controller" in capsys.readouterr().err


@pytest.mark.process
def test_one_that_is_stopped_by_a_signal_loses_its_trajectory_and_the_joints_brake(arm, wave):
    """A process that hangs keeps its connection; its heartbeat is missing."""
    words = [sys.executable, "-m", "canopen_control", "trajectory", "play", wave(seconds=12.0)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as player:
        try:
            assert eventually(lambda: abs(positions(arm)[0]) > 0.01)
            before = arm.status().cycle.count
            # 2.4 s, longer than promised: work is in progress
            assert eventually(lambda: arm.status().cycle.count >= before + 120)
            assert not any(event.kind == "commander_gone" for event in arm.status().events)
            os.kill(player.pid, signal.SIGSTOP)
            assert eventually(lambda: any(event.kind == "commander_gone" for event in arm.status().events))
        finally:
            os.kill(player.pid, signal.SIGCONT)
        reported = player.communicate(timeout=60)[1]
    assert player.returncode == 1
    assert "trajectory has sent no heartbeat for 2 s and is gone" in reported
    assert eventually(lambda: all(abs(joint.velocity) < 1e-6 for joint in arm.status().joints.values()))
    assert abs(positions(arm)[0]) < abs(ENDS[0]) - 0.01


def test_a_bundled_sample_is_found_by_its_name_and_fits_its_robot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    joints, points = read_trajectory(sample_or_file("wave.yaml"))
    described = read_description(data_path("config", "arm6") / "arm6.urdf").joints
    assert joints == [f"joint_{number}" for number in range(1, 7)]
    assert points[-1].positions == [0.0] * 6
    before = TrajectoryPoint(positions=[0.0] * 6)
    for point in points:
        seconds = point.time_from_start - before.time_from_start
        for name, a, b in zip(joints, before.positions, point.positions, strict=True):
            limits = described[name].limits
            assert limits.lower < b < limits.upper
            assert 1.5 * abs(b - a) / seconds <= limits.velocity  # the fastest of a cubic that rests at both ends
        before = point
    (tmp_path / "wave.yaml").write_text("joint_names: [a]\npoints: [{positions: [1.0], time_from_start: 1.0}]\n")
    assert read_trajectory(sample_or_file("wave.yaml"))[0] == ["a"]
    with pytest.raises(ConfigError, match=r"^none\.yaml"):
        read_trajectory(sample_or_file("none.yaml"))
