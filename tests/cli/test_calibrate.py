import contextlib
import re
import shlex
from types import SimpleNamespace

import pytest
from support.floor import BASE, BenchClient, FloorBench, InventedBase

from canopen_control.cli import calibrate
from canopen_control.cli.main import main
from canopen_control.client import RobotClient
from canopen_control.data_files import data_path

QUICK = ["--side", "0.4", "--speed", "0.8", "--turn", "3"]
YAML = data_path("config", "robby") / "ros2_controllers.yaml"


@pytest.fixture
def floor(tmp_path, monkeypatch):
    """A robot on its floor behind the client that the verb connects to."""
    benches = []
    monkeypatch.chdir(tmp_path)

    def make(**wrong):
        bench = FloorBench(tmp_path, f"cal{len(benches)}", **wrong)
        benches.append(bench)
        bench.start()
        bench.hurry()
        client = BenchClient(bench)
        monkeypatch.setattr(RobotClient, "connect", lambda _name=None: contextlib.nullcontext(client))
        return client

    yield make
    for benche in benches:
        benche.close()


@pytest.fixture
def invented(tmp_path, monkeypatch):
    """A base by its formulas behind the verb."""
    monkeypatch.chdir(tmp_path)

    def make(**wrong):
        base = InventedBase(**wrong)
        client = SimpleNamespace(robot="robby")
        monkeypatch.setattr(RobotClient, "connect", lambda _name=None: contextlib.nullcontext(client))
        monkeypatch.setattr("canopen_control.calibration.base_link.BaseLink", lambda _robot, _wanted: base)
        return base

    return make


def test_a_simulated_base_is_calibrated_by_itself_and_its_yaml_is_copied(invented, tmp_path, capsys):
    base = invented(track=1.02, right=1.005)
    assert main(["calibrate", "robby", "--passes", "2"]) == 0
    output = capsys.readouterr().out
    assert f"{BASE} of robby: 6 squares of 1 m at 0.2 m/s and 0.6 rad/s, about 4 min of driving" in output
    assert "free space it needs: 1.30 m ahead" in output
    assert int(re.search(r"(\d+) times smaller", output)[1]) > 1000
    assert "wheel_separation_multiplier: not given -> 1.01" in output
    assert f"canopen-control run ROBOT --controllers {calibrate.OUTPUT}" in output
    copy = (tmp_path / calibrate.OUTPUT).read_text()
    assert [line for line in copy.splitlines() if "multiplier" not in line] == YAML.read_text().splitlines()
    assert f"wheel_separation_multiplier: {base.factors[0]:.9g}\n" in copy
    assert main(["calibrate", "robby"]) == 2
    assert "in the running robot; calibrate with the file" in capsys.readouterr().err
    assert base.driven == 6
    assert main(["calibrate", "--controllers", calibrate.OUTPUT, "-o", "two.yaml"]) == 0
    assert "nothing to correct: the largest error is 0.0 mm" in capsys.readouterr().out


def test_measured_ends_come_from_a_file_where_no_true_pose_is_known(invented, tmp_path, capsys):
    invented(simulated=False)
    ends = tmp_path / "ends.txt"
    ends.write_text("0.02 0.02\n0.02 -0.02\n0.002 0.001\n0.002 -0.001\n")
    assert main(["calibrate", "--runs", "1", "--ends", str(ends)]) == 0
    output = capsys.readouterr().out
    assert "runs with the new values until the robot ends, which are:\n    wheel_separation_multiplier: " in output
    assert main(["calibrate", "--ends", str(ends)]) == 2
    assert "has 4 end positions for 20 squares" in capsys.readouterr().err


def test_a_user_at_a_terminal_is_asked(invented, capsys, monkeypatch):
    invented(simulated=False)
    answers = iter(["", "0.02 0.02", "", "0.02 -0.02", "", "0 0", "", "0 0"])
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("builtins.input", lambda _prompt: next(answers))
    assert main(["calibrate", "--runs", "1"]) == 0
    assert "largest error 28.3 mm before, 0.0 mm now: no error is left" in capsys.readouterr().out


def test_stop_ends_it_with_a_sentence_and_the_old_values(floor, capsys):
    client = floor(track=1.02)
    client.on_state = lambda count: client.bench.robot.latch.hold("somebody", 0) if count == 100 else None
    assert main(["calibrate", *QUICK]) == 1
    assert "the calibration has ended: STOP, by somebody; the base stops, and its controller" in capsys.readouterr().err


def test_ctrl_c_ends_it_with_a_sentence(floor, capsys):
    client = floor(track=1.02)

    def interrupt(count):
        if count == 100:
            raise KeyboardInterrupt

    client.on_state = interrupt
    assert main(["calibrate", *QUICK]) == 1
    assert "the calibration was interrupted" in capsys.readouterr().err
    assert client.twists[-1] == (0.0, 0.0)


def test_a_real_base_is_not_driven_without_a_terminal(invented, capsys, monkeypatch):
    base = invented(simulated=False)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    assert main(["calibrate"]) == 2
    assert "its end positions cannot be typed: run it in a terminal, or give --ends FILE" in capsys.readouterr().err
    assert base.driven == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("calibrate -o mine.yaml", "--output is for a copy of a robot's YAML; name the robot's folder"),
        ("calibrate robby -o there.yaml", "there.yaml already exists; give another --output, or --overwrite"),
        ("calibrate nobody", "nobody"),
        ("calibrate --controller robby_forward_controller", "is not a diff drive controller of the robot"),
    ],
)
def test_errors_are_reported_before_anything_moves(floor, tmp_path, capsys, words, sentence):
    client = floor()
    (tmp_path / "there.yaml").write_text("mine: 1\n")
    assert main(shlex.split(words)) == 2
    assert sentence in capsys.readouterr().err
    assert client.twists == []
    assert (tmp_path / "there.yaml").read_text() == "mine: 1\n"


@pytest.mark.parametrize("option", ["--side 0.1", "--side nan", "--speed 0", "--turn -1", "--runs 0", "--passes 9"])
def test_numbers_that_cannot_be_are_refused(option, capsys):
    with pytest.raises(SystemExit) as error:
        main(["calibrate", *option.split()])
    assert error.value.code == 2
    assert "is no" in capsys.readouterr().err
