"""The verb preflight, as its user sees it, and what a real run makes of its pass."""

import json

import pytest
from support.guest import plant_speed
from support.host import eventually

from canopen_control.cli import preflight
from canopen_control.cli.main import main
from canopen_control.cli.preflight import Step

NODES = (3, 2)


@pytest.fixture
def drives(stage):
    for node_id in NODES:
        stage.drive("flight", node_id)


def flight(stage, *options):
    return stage.call("preflight", "robby", "--can", "local:flight", *options)


def speeds():
    return [abs(plant_speed("local:flight", node_id)) * 0.003926990816987242 for node_id in NODES]


def real_run(stage, *options):
    robot = stage.start("run", "robby", "--can", "local:flight", "--real", *options)
    robot.until("robby runs")
    stage.start("command", "robby_forward_controller", 10, 10)
    return robot


@pytest.mark.process
@pytest.mark.rest
def test_a_pass_is_written_and_lets_a_real_run_be_fast(stage, drives, tmp_path):
    done = flight(stage, "--yes", "--report", tmp_path / "report.json")
    assert done.wait() == 0, done
    assert "FAIL" not in done.out
    report = json.loads((tmp_path / "report.json").read_text())
    assert (report["passed"], report["serial_numbers"]) == (True, {"left_drive": 3, "right_drive": 2})
    assert [step["name"] for step in report["steps"] if step["passed"]][-3:] == ["jog", "jog", "STOP"]
    assert report["joints"] == ["left_wheel_joint", "right_wheel_joint"]
    robot = real_run(stage)
    assert eventually(lambda: speeds() == pytest.approx([10.0, 10.0], rel=0.01))
    assert "limited" not in robot.out


@pytest.mark.process
@pytest.mark.rest
def test_without_a_pass_a_real_run_is_slow_and_says_so(stage, drives):
    robot = real_run(stage)
    assert eventually(lambda: speeds() == pytest.approx([1.0, 1.0], rel=0.01))
    assert not eventually(lambda: max(speeds()) > 1.01, 0.5)
    robot.until("this robot has not passed a pre-flight on this machine; speeds are limited to 1 rad/s")
    assert robot.end() == 0, robot


@pytest.mark.process
@pytest.mark.rest
def test_full_speed_overrules(stage, drives):
    robot = real_run(stage, "--full-speed")
    assert eventually(lambda: speeds() == pytest.approx([10.0, 10.0], rel=0.01))
    assert "limited" not in robot.out
    assert robot.end() == 0, robot


@pytest.mark.process
@pytest.mark.rest
def test_looking_alone_moves_nothing_and_is_no_pass(stage, drives):
    done = flight(stage, "--no-jog")
    assert done.wait() == 0, done
    assert "without the jog robby has not passed" in done.out
    assert speeds() == [0.0, 0.0]


@pytest.mark.process
@pytest.mark.rest
def test_without_drives_it_fails_and_moves_nothing(stage):
    stage.drive("flight", 3)
    done = flight(stage, "--yes")
    assert done.wait() == 1
    assert "FAIL  node      node 2 (right_drive) does not answer" in done.out
    assert "The next steps turn the motors" not in done.out
    assert "robby has not passed: 1 of 6 steps failed" in done.out


@pytest.mark.process
def test_a_no_ends_it(drives, monkeypatch, capsys):
    answers = iter(["y\n", "yes\n", "n\n"])
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: next(answers), raising=False)
    assert main(["preflight", "robby", "--can", "local:flight"]) == 1
    said = capsys.readouterr().out
    assert "Did left_wheel_joint, and nothing else, turn forward? [y/N]" in said
    assert "turned the wrong way" in said
    assert "Turn right_wheel_joint" not in said


@pytest.mark.process
@pytest.mark.rest
def test_control_c_at_a_question_ends_its_line_and_jogs_nothing(drives, monkeypatch, capsys):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", interrupted, raising=False)
    assert main(["preflight", "robby", "--can", "local:flight"]) == 130
    assert capsys.readouterr().out.endswith("Go on? [y/N] \n")
    assert speeds() == [0.0, 0.0]


@pytest.mark.process
@pytest.mark.rest
def test_the_end_of_the_input_is_a_no_on_a_line_of_its_own(drives, monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: "", raising=False)
    assert main(["preflight", "robby", "--can", "local:flight"]) == 1
    assert "Go on? [y/N] \nFAIL  jog       not wanted\n" in capsys.readouterr().out


class FakeJog:
    """A jog of three joints: one turns, one has no room, one is not turned at all."""

    joints = ("wheel", "lift")

    def __init__(self, setup, speed):
        self.turned = []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def no_room(self, joint):
        return "it is at its limit" if joint == "lift" else None

    def turn(self, joint):
        self.turned.append(joint)
        return Step("jog", True, f"{joint}: turned")

    def stop(self):
        return Step("STOP", True, "stopped")


def test_what_could_not_be_turned_is_said_and_not_covered_by_the_pass(monkeypatch):
    monkeypatch.setattr(preflight, "Jog", FakeJog)
    interfaces = {"gripper": None, "wheel": "velocity", "lift": "position"}
    monkeypatch.setattr(preflight, "jog_interfaces", lambda _setup: interfaces)
    told, asked = [], []
    flight = preflight.Preflight(None, told.append, lambda question: asked.append(question) or True, 0.5)
    assert flight.move() is True
    assert flight.covered == ["wheel"]
    stays = "; it is not turned, and stays slow with --real"
    assert f"note  jog       gripper has neither velocity nor position to command{stays}" in told
    assert f"note  jog       lift: it is at its limit{stays}" in told
    assert [question for question in asked if "lift" in question or "gripper" in question] == []
    interfaces.pop("wheel")
    flight = preflight.Preflight(None, told.append, lambda _question: True, 0.5)
    monkeypatch.setattr(FakeJog, "joints", ("lift",))
    assert (flight.move(), flight.covered) == (False, [])
    assert told[-1] == "FAIL  jog       no joint could be turned"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "nobody is there to ask"),
        (["--mock"], "unrecognized arguments: --mock"),
        (["--no-drives"], "unrecognized arguments: --no-drives"),
        (["--real"], "unrecognized arguments: --real"),
        (["--speed", "5", "--yes"], "'5' is no speed above 0 and up to 1 rad/s"),
    ],
)
def test_a_mistake_of_the_user_is_one_sentence_and_exit_code_2(options, words, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    try:
        code = main(["preflight", "robby", *options])
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    assert words in capsys.readouterr().err
