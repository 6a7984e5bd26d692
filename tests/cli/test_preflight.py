"""The verb preflight, and the effect of its pass on a real run."""

import contextlib
import dataclasses
import json

import pytest
from support.guest import plant_speed
from support.host import eventually
from support.lockstep import lockstep
from support.onbus import GENERIC, TMCM, OnBus
from support.robots import copy_robby

from canopen_control.bus.can_interfaces import CanInterface
from canopen_control.cli import preflight
from canopen_control.cli import preflight as steps
from canopen_control.cli.main import main
from canopen_control.cli.preflight import Jog, PreflightStep, jog_interfaces, link_steps, node_steps
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.fault_table import FaultSwitches

CAN0 = CanInterface("can0", "can", is_up=True, state="ERROR-ACTIVE", bitrate=1_000_000)


def results(found):
    return [(step.name, step.passed) for step in found]


@pytest.mark.parametrize(
    ("link", "expected", "words"),
    [
        (CAN0, [("link", True), ("bit rate", True)], "1000000 bit/s, and 1000000 in bus.yml"),
        (
            dataclasses.replace(CAN0, bitrate=500_000),
            [("link", True), ("bit rate", False)],
            "500000 bit/s, and 1000000 in bus.yml",
        ),
        (dataclasses.replace(CAN0, state="ERROR-PASSIVE"), [("link", False), ("bit rate", True)], "ERROR-PASSIVE"),
        (
            dataclasses.replace(CAN0, is_up=False),
            [("link", False)],
            "bring it up with: canopen-control bus up can0 --bitrate 1000000",
        ),
        (None, [("link", False)], "can0 does not exist"),
        (
            CanInterface("can0", "vcan", is_up=True),
            [("link", True), ("bit rate", None)],
            "is a vcan interface, which has no bit rate",
        ),
    ],
    ids=["good", "other rate", "passive", "down", "missing", "virtual"],
)
def test_the_link_is_held_against_the_bus_file(monkeypatch, link, expected, words):
    monkeypatch.setattr(steps, "find_can_interface", lambda _name: link)
    result = link_steps("can0", 1000)
    assert results(result) == expected
    assert any(words in step.text for step in result)


def test_a_channel_without_an_interface_is_only_reported():
    assert results(link_steps("local:anything", 1000)) == [("link", None)]


@contextlib.contextmanager
def drives_on(channel, devices):
    with lockstep(), OnBus(channel, devices) as drives:
        yield drives


def test_nodes_are_compared_to_bus_file_and_eds_and_strangers_are_named():
    setup = read_robot(find_robot("robby"), can=["memory:looked"])
    with drives_on("memory:looked", dict.fromkeys((3, 2, 9), TMCM)):
        result = list(node_steps(setup.bus, "memory:looked"))
    ours = [("node", True), ("EDS", True), ("errors", True), ("limits", None)]
    assert results(result) == [*ours, *ours, ("node", None)]
    assert result[0].text == "node 3 (left_drive): TMCM-1270, serial number 3"
    assert result[-1].text == "node 9 answers, but is not in bus.yml"


def test_a_node_that_is_missing_or_another_one_fails(tmp_path):
    config = copy_robby(tmp_path, bus={"revision_number: 0 ": "revision_number: 0x77 "})
    setup = read_robot(find_robot(str(config)), can=["memory:wrong"])
    with drives_on("memory:wrong", {3: TMCM}):
        result = list(node_steps(setup.bus, "memory:wrong"))
    assert [step.name for step in result if step.passed is False] == ["node", "node"]
    assert "revision 0x00000077 expected" in result[0].text
    assert result[-1].text.startswith("node 2 (right_drive) does not answer; check power")


def test_the_jog_measures_velocity_way_and_stop(private_folders):
    setup = read_robot(find_robot("robby"), can=["memory:jogged"])
    assert jog_interfaces(setup) == {"left_wheel_joint": "velocity", "right_wheel_joint": "velocity"}
    with drives_on("memory:jogged", dict.fromkeys((3, 2), TMCM)), Jog(setup, 0.5) as jog:
        result = [*map(jog.turn, jog.joints), jog.stop()]
    assert results(result) == [("jog", True), ("jog", True), ("STOP", True)], result
    assert jog.turned == ["left_wheel_joint", "right_wheel_joint"]


@pytest.mark.parametrize(
    ("edits", "words"),
    [
        (
            {"scale_vel_to_dev: -254.64790894703253": "scale_vel_to_dev: -2546.4790894703253"},
            "rad/s at a command of 0.5",
        ),
        ({"scale_pos_from_dev: -0.003926990816987242": "scale_pos_from_dev: -0.03926990816987242"}, "rad in"),
    ],
    ids=["velocity scale", "position scale"],
)
def test_a_wrong_scale_is_found_before_it_hurts(private_folders, tmp_path, edits, words):
    setup = read_robot(find_robot(str(copy_robby(tmp_path, bus=edits))), can=["memory:scales"])
    with drives_on("memory:scales", dict.fromkeys((3, 2), TMCM)), Jog(setup, 0.5) as jog:
        step = jog.turn("left_wheel_joint")
    assert (step.passed, jog.turned) == (False, [])
    assert words in step.text


def test_a_drive_whose_feedback_has_the_wrong_sign_is_found(private_folders):
    setup = read_robot(find_robot("robby"), can=["memory:signs"])
    with drives_on("memory:signs", dict.fromkeys((3, 2), TMCM)) as drives, Jog(setup, 0.5) as jog:
        drives.call(lambda: FaultSwitches(drives.nodes[3]).set("direction_inverted", True, drives.reactor.now()))
        step = jog.turn("left_wheel_joint")
    assert (step.passed, jog.turned) == (False, [])
    assert "node 3 (left_drive): it turns against its command; check polarity (0x607E)" in step.text
    assert "axis enable" not in step.text


def test_a_joint_that_has_a_position_only_is_led_by_it_and_back_for_stop(private_folders):
    setup = read_robot(find_robot("arm6"), can=["memory:jogged-arm"])
    assert set(jog_interfaces(setup).values()) == {"position"}
    with drives_on("memory:jogged-arm", dict.fromkeys(range(2, 8), GENERIC)) as drives, Jog(setup, 0.5) as jog:
        assert jog.range_refusal("joint_1") is None
        step = jog.turn("joint_1")
        assert step.passed, step
        way = drives.call(lambda: drives.nodes[2].get(0x6064)) / 1043037.8350470454
        assert 0.5 < way < 1.0, "forward"
        stop = jog.stop()
        assert stop.passed, stop
        assert drives.call(lambda: drives.nodes[2].get(0x6064)) / 1043037.8350470454 < way, "and back"
        others = [drives.call(lambda node=node: drives.nodes[node].get(0x6064)) for node in range(3, 8)]
    assert (others, jog.turned) == ([0] * 5, ["joint_1"])


def test_a_joint_without_room_before_its_limit_is_reported_and_not_turned(private_folders):
    setup = read_robot(find_robot("arm6"), can=["memory:narrow-arm"])
    with drives_on("memory:narrow-arm", dict.fromkeys(range(2, 8), GENERIC)), Jog(setup, 1.0) as jog:
        assert jog.range_refusal("joint_2") is None, "2 rad are enough for two seconds"
        jog.speed = 1.2
        assert jog.range_refusal("joint_2") == (
            "it is at 0.000, 2.000 before its limit, and a jog at 1.2 rad/s needs 2.400"
        )


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
def test_a_preflight_pass_is_recorded_and_permits_full_speed(stage, drives, tmp_path):
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
def test_without_a_pass_a_real_run_is_slow_and_reports_this(stage, drives):
    robot = real_run(stage)
    assert eventually(lambda: speeds() == pytest.approx([1.0, 1.0], rel=0.01))
    assert not eventually(lambda: max(speeds()) > 1.01, 0.5)
    robot.until("this robot has not passed a preflight on this machine; speeds are limited to 1 rad/s")
    assert robot.end() == 0, robot


@pytest.mark.process
@pytest.mark.rest
def test_full_speed_overrules(stage, drives):
    robot = real_run(stage, "--full-speed")
    assert eventually(lambda: speeds() == pytest.approx([10.0, 10.0], rel=0.01))
    assert "limited" not in robot.out
    assert robot.end() == 0, robot


def flown(*options, nodes=NODES):
    """Run preflight with drives in virtual time; return the exit code and the speeds of the drives."""
    with drives_on("memory:flown", dict.fromkeys(nodes, TMCM)) as drives:
        code = main(["preflight", "robby", "--can", "memory:flown", *options])
        return code, [node.drives[0].mover.plant.velocity for node in drives.nodes.values()]


def test_looking_alone_moves_nothing_and_is_not_a_pass(capsys):
    assert flown("--no-jog") == (0, [0.0, 0.0])
    assert "without the jog robby has not passed" in capsys.readouterr().out


def test_a_running_robot_keeps_its_nodes_to_itself(monkeypatch, capsys):
    monkeypatch.setattr(preflight, "robot_on", lambda channel: ("other", None) if channel == "memory:taken" else None)
    assert main(["preflight", "robby", "--can", "memory:taken", "--no-jog"]) == 2
    output = capsys.readouterr()
    assert output.out == ""  # nothing was read
    assert output.err == (
        "canopen-control: robot other runs on memory:taken and is the one client of its nodes; end it first: "
        "canopen-control shutdown --name other\n"
    )


def test_without_drives_it_fails_and_moves_nothing(capsys):
    assert flown("--yes", nodes=(3,)) == (1, [0.0])
    output = capsys.readouterr().out
    assert "FAIL  node      node 2 (right_drive) does not answer" in output
    assert "The next steps turn the motors" not in output
    assert "robby has not passed: 1 of 6 steps failed" in output


@pytest.fixture
def answered(monkeypatch):
    """Return what runs preflight with this function as the answers of the user."""

    def answered(answer):
        monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
        monkeypatch.setattr("sys.stdin.readline", answer, raising=False)
        return flown()

    return answered


def test_a_no_ends_it(answered, capsys):
    answers = iter(["y\n", "yes\n", "n\n"])
    assert answered(lambda: next(answers))[0] == 1
    output = capsys.readouterr().out
    assert "Did left_wheel_joint, and nothing else, turn forward? [y/N]" in output
    assert "turned the wrong way" in output
    assert "Turn right_wheel_joint" not in output


def test_control_c_at_a_question_ends_its_line_and_jogs_nothing(answered, capsys):
    def interrupted():
        raise KeyboardInterrupt

    assert answered(interrupted) == (130, [0.0, 0.0])
    assert capsys.readouterr().out.endswith("Continue? [y/N] \n")


def test_the_end_of_the_input_is_a_no_on_a_line_of_its_own(answered, capsys):
    assert answered(lambda: "")[0] == 1
    assert "Continue? [y/N] \nFAIL  jog       declined by the user\n" in capsys.readouterr().out


class FakeJog:
    """A jog of three joints: one turns, one has no room, one is not turned at all."""

    joints = ("wheel", "lift")

    def __init__(self, setup, speed):
        self.turned = []

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def range_refusal(self, joint):
        return "it is at its limit" if joint == "lift" else None

    def turn(self, joint):
        self.turned.append(joint)
        return PreflightStep("jog", True, f"{joint}: turned")

    def stop(self):
        return PreflightStep("STOP", True, "stopped")


def test_what_could_not_be_turned_is_reported_and_not_covered_by_the_pass(monkeypatch):
    monkeypatch.setattr(preflight, "Jog", FakeJog)
    interfaces = {"gripper": None, "wheel": "velocity", "lift": "position"}
    monkeypatch.setattr(preflight, "jog_interfaces", lambda _setup: interfaces)
    reported, requested = [], []
    flight = preflight.Preflight(None, reported.append, lambda question: requested.append(question) or True, 0.5)
    assert flight.move() is True
    assert flight.covered == ["wheel"]
    stays = "; it is not turned, and remains limited with --real"
    assert f"note  jog       gripper has neither a velocity nor a position command interface{stays}" in reported
    assert f"note  jog       lift: it is at its limit{stays}" in reported
    assert [question for question in requested if "lift" in question or "gripper" in question] == []
    interfaces.pop("wheel")
    flight = preflight.Preflight(None, reported.append, lambda _question: True, 0.5)
    monkeypatch.setattr(FakeJog, "joints", ("lift",))
    assert (flight.move(), flight.covered) == (False, [])
    assert reported[-1] == "FAIL  jog       no joint could be turned"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "standard input is not a terminal, so no question"),
        (["--mock"], "unrecognized arguments: --mock"),
        (["--no-drives"], "unrecognized arguments: --no-drives"),
        (["--real"], "unrecognized arguments: --real"),
        (["--yes", "--report", "/nowhere/a.json"], "--report /nowhere/a.json: no folder /nowhere"),
        (["--speed", "5", "--yes"], "'5' is not a speed above 0 and up to 1 rad/s"),
    ],
)
def test_an_error_of_the_user_is_one_sentence_and_exit_code_2(options, words, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    try:
        code = main(["preflight", "robby", *options])
    except SystemExit as stop:  # argparse
        code = stop.code
    assert code == 2
    assert words in capsys.readouterr().err
