import csv
import itertools
import json

import pytest
from support.jogbench import jog_bench
from support.onbus import GENERIC
from support.service_node import NodeStub
from support.terminal import in_background

from canopen_control.cli.main import main
from canopen_control.cli.scope import check_output, cursor_lines, numbered, read_overlay, shot_lines, write_shot
from canopen_control.cli.support.jog_robot import choose_jog, choose_tuned, own_robot
from canopen_control.cli.support.target import find_eds
from canopen_control.commissioning.jog_motion import JogKind
from canopen_control.commissioning.node_session import NodeSession
from canopen_control.commissioning.scope_capture import Shot
from canopen_control.commissioning.scope_signals import signal_of
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.od.eds import read_eds
from canopen_control.runtime.observer import RobotObserver
from canopen_control.scaffold.new_robot import Device

NODE = NodeSession(NodeStub({}), 5, read_eds(data_path("eds", "TMCM-1270.eds"), 5).od)
SIGNALS = [signal_of("5:0x6064", NODE), signal_of("5:0x606C", NODE)]
SHOT = Shot(tuple((100.0 + n / 10, (float(n), None)) for n in range(11)), triggered=100.5)


def test_the_text_output_has_figures_and_a_curve():
    lines = list(shot_lines(SHOT, SIGNALS))
    assert lines[0] == "11 samples from -0.500 s to 0.500 s of the trigger"
    assert lines[2].split()[5:8] == ["0", "10", "4.5"]
    assert lines[3].split()[5:8] == ["-", "-", "-"]


def test_the_shots_of_a_series_have_numbers():
    path = check_output("scope.csv")
    assert [str(numbered(path, 3, several=value)) for value in (False, True)] == ["scope.csv", "scope_3.csv"]


@pytest.mark.parametrize("text", ["scope", "scope.svg", "nowhere/scope.csv"])
def test_another_ending_or_place_is_refused_before_anything_is_looked_at(text):
    with pytest.raises(ConfigError, match=r"-o .*(write NAME\.csv|no folder)"):
        check_output(text)


def test_cursors_report_what_is_between_them():
    lines = list(cursor_lines(SHOT, SIGNALS, (-0.2, 0.3)))
    assert lines[0] == "cursors at -0.2 s and 0.3 s: dt 0.5 s (2 Hz)"
    assert lines[2].split()[2:5] == ["3", "8", "5"]
    assert lines[3].split()[-4:] == ["-"] * 4


def test_an_overlay_is_measured_below_the_same_signal_and_may_be_of_other_ones(tmp_path):
    write_shot(tmp_path / "old.csv", SHOT, SIGNALS[:1])
    overlay = read_overlay(str(tmp_path / "old.csv"))
    lines = list(shot_lines(SHOT, SIGNALS, overlay))
    assert len(lines) == 5
    assert lines[3].split()[:5] == ["old.csv", "0", "10", "4.5", lines[2].split()[8]]


@pytest.mark.parametrize("name", ["gone.csv", "pixels.csv", "empty.csv"])
def test_what_is_not_an_overlay_is_reported(tmp_path, name):
    (tmp_path / "pixels.csv").write_bytes(b"\x89PNG\xff")
    (tmp_path / "empty.csv").write_text("")
    with pytest.raises(ConfigError, match=name):
        read_overlay(str(tmp_path / name))


@pytest.mark.rest
@pytest.mark.parametrize(("name", "begins"), [("a.csv", b"time,t,5:0x6064"), ("a.png", b"\x89PNG\r\n")])
def test_the_ending_reports_what_is_written(tmp_path, name, begins):
    assert write_shot(tmp_path / name, SHOT, SIGNALS, cursors=(0.0, 0.1)) == tmp_path / name
    assert (tmp_path / name).read_bytes().startswith(begins)


def test_a_bag_is_a_folder(tmp_path):
    pytest.importorskip("rosbags.rosbag2")
    assert write_shot(tmp_path / "shot.mcap", SHOT, SIGNALS) == tmp_path / "shot"
    assert (tmp_path / "shot" / "metadata.yaml").exists()


@pytest.fixture
def bench(private_folders):
    with jog_bench(channel="memory:scope") as bench:
        yield bench


def scope(bench, *words):
    return main(["scope", *words, "--can", bench.bus.channel, "--eds", GENERIC])


def test_objects_of_a_bare_bus_are_polled(bench, tmp_path, capsys):
    path = tmp_path / "shot.csv"
    assert scope(bench, "5:0x6041", "5:Position actual value", "--for", "0.3", "-o", str(path)) == 0
    assert "5:0x6064" in capsys.readouterr().out
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 3
    assert {row["5:0x6041"] for row in rows} == {str(bench.get(0x6041))}


def test_a_fault_that_comes_is_caught_with_what_was_before(bench, capsys):
    axis = bench.drive.drives[0]

    def break_it():
        import time

        time.sleep(0.6)
        bench.bus.call(lambda: axis.fault(0x3220, bench.bus.reactor.now()))

    with in_background(break_it):
        assert scope(bench, "5:0x6064", "--trigger", "fault", "--for", "0.5", "--before", "0.3", "--wait", "10") == 0
    assert "of the trigger" in capsys.readouterr().out


def test_process_data_of_a_running_robot_come_with_every_cycle(bench, tmp_path, capsys):
    robot = choose_jog(
        Device(5, find_eds(GENERIC), read_eds(find_eds(GENERIC), 5).od), "velocity", allow_unsupervised=False
    )
    path = tmp_path / "robot.csv"
    with own_robot(robot, robot.joints[0].axis, bench.bus.channel, 2.0, RobotObserver()) as drive:
        words = [f"{drive.node}:0x606C", f"{drive.node}:0x6083", "--name", drive.robot, "--for", "0.5", "-o", str(path)]
        assert main(["scope", *words]) == 0
        capsys.readouterr()
        assert main(["scope", f"{drive.node}:0x606C", "--name", drive.robot, "--for", "0.1", "--json"]) == 0
    output = capsys.readouterr()
    assert json.loads(output.out)["signals"][0]["label"] == "Velocity actual value"
    assert "cycles of the robot" in output.err
    assert str(bench.get(0x6083)) in path.read_text().splitlines()[-1]  # no TPDO carries it


QUANTITIES = ("position", "velocity")
SIX = (0x6041, 0x6061, 0x6064, 0x606C, 0x6077, 0x603F)


@pytest.mark.rest
def test_eight_channels_of_every_millisecond_and_no_cycle_missed(bench, tmp_path, capsys):
    """What comes with SYNC at 1 kHz, and two values of the joint: a sample for each cycle, none of them missing."""
    device = Device(5, find_eds(GENERIC), read_eds(find_eds(GENERIC), 5).od)
    robot = choose_tuned(device, JogKind.VELOCITY, 1000, allow_unsupervised=False)
    path = tmp_path / "fast.csv"
    with own_robot(robot, robot.joints[0].axis, bench.bus.channel, 2.0, RobotObserver()) as drive:
        words = [
            *(f"{drive.node}:0x{index:04X}" for index in SIX),
            *(f"{drive.joint}:{quantity}" for quantity in QUANTITIES),
        ]
        assert main(["scope", *words, "--name", drive.robot, "--for", "1", "-o", str(path)]) == 0
    output = capsys.readouterr().out
    assert "cycles of the robot, 0 missed" in output
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    times = sorted({round(float(row["time"]) * 1000) for row in rows})
    assert len(times) >= 1000
    assert [after - before for before, after in itertools.pairwise(times)] == [1] * (len(times) - 1)
    assert all(row[f"{drive.joint}:position"] for row in rows[10:])


@pytest.mark.rest
def test_two_shots_are_laid_over_each_other_and_measured_between_cursors(bench, tmp_path, capsys):
    first = str(tmp_path / "first.csv")
    assert scope(bench, "5:0x6064", "5:0x6083", "--for", "0.3", "-o", first) == 0
    capsys.readouterr()
    words = ("--overlay", first, "--cursors", "0.05,0.25", "-o", str(tmp_path / "both.png"))
    assert scope(bench, "5:0x6083", "--for", "0.3", *words) == 0
    output = capsys.readouterr().out
    assert "first.csv" in output
    assert "cursors at 0.05 s and 0.25 s: dt 0.2 s (5 Hz)" in output
    value = str(bench.get(0x6083))
    assert output.splitlines()[-2].split()[-4:] == [value, value, "0", value], output
    assert (tmp_path / "both.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("words", "code", "why"),
    [
        (("5:0x6064", "--trigger", "1:rising:1e9", "--wait", "0.2"), 1, "no capture, as the trigger"),
        (("5:0x6064", "--trigger", "2:rising:0"), 2, "counted from 1 to 1"),
        (("5:0x6064", "--before", "1"), 2, "--before requires --trigger"),
        (("5",), 2, "'5' is not a signal"),
        (("5:0x5FFF",), 2, "has no 0x5FFF:00"),
        (("6:0x6064", "--timeout", "0.1"), 1, "no answer"),
        (tuple(["5:0x6064"] * 9), 2, "9 signals are too many"),
        (("5:0x6064", "-o", "x.svg"), 2, "write NAME.csv"),
        (("5:0x6064", "--cursors", "1"), 2, "write two times in s"),
        (("5:0x6064", "--overlay", "gone.csv"), 2, "gone.csv cannot be read"),
        (("5:0x6064", "wheel:velocity"), 2, "joints exist only in a running robot"),
    ],
)
def test_an_invalid_viewpoint_is_reported(bench, capsys, words, code, why):
    assert scope(bench, *words) == code
    assert why in capsys.readouterr().err
