"""Mistakes of a user: one clear sentence, the right exit code, no traceback, and nothing left running."""

import re

import pytest
from support.processes import GONE_S
from support.robots import copy_robby

PLACE = r"bus\.yml:\d+:\d+: "


def check(program, code, *sentences):
    """One complaint, on standard error alone, that says all of `sentences` (regular expressions)."""
    assert program.wait() == code, program
    assert "Traceback" not in program.err + program.out
    complaints = [line for line in program.err.splitlines() if line.startswith("canopen-control")]
    assert len(complaints) == 1, program.err
    for sentence in sentences:
        assert re.search(sentence, program.err), program.err


USAGE = {
    "no verb of this name": (["runn", "robby"], r"no verb 'runn'; did you mean run\?"),
    "an unknown option": (["run", "robby", "--fast"], "unrecognized arguments: --fast"),
    "an unknown robot": (["run", "robbie"], "no robot 'robbie'.*robby"),
    "no robot at all": (["run"], "no robot given.*robby"),
    "a missing file": (["run", "robby", "--bus", "nothere.yml"], "--bus: no file nothere.yml"),
    "an unknown controller": (
        ["run", "robby", "--controller", "forwrd"],
        "ros2_controllers.yaml: no controller 'forwrd'",
    ),
    "a channel of no kind": (["run", "robby", "--can", "robby"], "channel 'robby'.*local:robby"),
    "a bus the robot has not": (["run", "robby", "--can", "left=can0"], "no bus 'left'"),
    "a bad bus name": (["run", "robby", "--can", "local:a b"], "local:a b"),
    "a bad name": (["run", "robby", "--as", "../x"], r"'\.\./x' is not a valid name"),
    "no time": (["run", "robby", "--for", "soon"], "'soon' is not a time"),
    "an endless time": (["run", "robby", "--for", "inf"], "'inf' is not a time"),
    "contradicting options": (["run", "robby", "--real", "--mock"], "--real"),
    "nobody to ask": (["status"], "no robot is running; start one"),
    "nobody of this name": (["stop", "--name", "rob"], "no robot 'rob' is running"),
    "an unknown action": (["axis", "boost", "all"], "invalid choice: 'boost'"),
    "no number": (["command", "robby_forward_controller", "ten"], "ten"),
    "no finite number": (["command", "robby_forward_controller", "nan"], "nan"),
    "no time to command": (["command", "robby_forward_controller", "1", "--for", "-1"], "'-1' is not a time"),
    "no EDS": (["drive", "--node-id", "3", "--eds", "no.eds", "--can", "local:x"], "no.eds: cannot be read"),
    "no node-ID": (["drive", "--node-id", "0", "--eds", "TMCM-1270.eds", "--can", "local:x"], "1 to 127"),
    "no such fault": (
        ["drive", "--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:x", "--fault", "heartbeat_los"],
        "did you mean 'heartbeat_lost'",
    ),
}


@pytest.mark.parametrize("what", USAGE)
def test_usage(stage, what):
    arguments, sentence = USAGE[what]
    check(stage.call(*arguments), 2, sentence)


FILES = {
    "a missing EDS": ("bus", 'dcf: "TMCM-1270.eds"', 'dcf: "TMCM-1.eds"', PLACE + ".*file 'TMCM-1.eds' not found"),
    "a node-ID twice": ("bus", "node_id: 2\n", "node_id: 3\n", PLACE + ".*node-ID 3 is already used by left_drive"),
    "the master's node-ID": (
        "bus",
        "node_id: 2\n",
        "node_id: 1\n",
        PLACE + ".*node-ID 1 is already used by the master",
    ),
    "no YAML": ("bus", "nodes:", "nodes: [", PLACE),
    "a tab": ("bus", "  baudrate", "\tbaudrate", PLACE),
    "an unknown key": ("bus", "sync_period:", "sync_perido:", PLACE + ".*did you mean 'sync_period'"),
    "an object the EDS lacks": ("bus", "index: 0x606C", "index: 0x5555", PLACE + ".*0x5555:00 is not in TMCM-1270.eds"),
    "nobody to watch the master": ("bus", "consumer: true", "consumer: false", PLACE + ".*when the master is lost"),
    "no target in any PDO": ("bus", "index: 0x60FF", "index: 0x6081", r"xacro:\d+: joint .*map 0x60FF"),
    "an unknown drive": ("description", "_drive</param>", "_driv</param>", r"xacro:\d+: joint .*mean 'left_drive'"),
    "no XML": ("description", "</robot>", "</robo>", r"robby\.urdf\.xacro: .*line"),
    "an unknown plugin": (
        "description",
        "canopen_ros2_control/",
        "nothing/",
        r"xacro:\d+: no hardware plugin 'nothing/",
    ),
    "an unknown type": ("controllers", "/ForwardC", "/FowardC", r"ros2_controllers\.yaml: .*did you mean"),
    "an unknown joint": ("controllers", "- left_", "- lft_", r"ros2_controllers\.yaml: .*'lft_wheel_joint/velocity'"),
    "no number": ("controllers", "timeout: 2.0", "timeout: soon", r"ros2_controllers\.yaml:\d+:\d+: .*'soon'"),
}


@pytest.mark.rest
@pytest.mark.parametrize("what", FILES)
def test_files(stage, tmp_path, what):
    which, old, new, sentence = FILES[what]
    program = stage.call("run", copy_robby(tmp_path, **{which: {old: new}}))
    check(program, 2, sentence)
    assert program.out == ""


def test_a_file_that_is_missing_in_the_folder(stage, tmp_path):
    config = copy_robby(tmp_path)
    (config / "ros2_controllers.yaml").unlink()
    check(stage.call("run", config), 2, r"robby has no ros2_controllers\.yaml")


def test_a_bus_that_is_not_answered(stage, tmp_path):
    config = copy_robby(tmp_path, bus={"  sync_period: 20000": "  boot_time: 1500\n  sync_period: 20000"})
    program = stage.call("run", config, "--no-drives", "--can", "local:desert")
    check(
        program, 1, "no node answers on local:desert: no frame was received from left_drive, right_drive within 1.5 s"
    )
    stage.nobody_is_left(GONE_S)


@pytest.mark.rest
def test_a_drive_that_is_missing(stage, tmp_path):
    config = copy_robby(tmp_path, bus={"  sync_period: 20000": "  boot_time: 2500\n  sync_period: 20000"})
    stage.drive("lonely", 3)
    program = stage.call("run", config, "--no-drives", "--can", "local:lonely")
    check(program, 1, r"node 2 \(right_drive\): boot error B: .*no answer within .* s")
    assert "left_drive" not in program.err
    assert stage.programs[0].running


@pytest.mark.rest
def test_a_drive_that_is_another_device(stage, tmp_path):
    config = copy_robby(tmp_path, bus={"  sync_period: 20000": "  boot_time: 1500\n  sync_period: 20000"})
    stage.drive("alien", 3)
    stage.drive("alien", 2, "--fault", "wrong_identity")
    program = stage.call("run", config, "--no-drives", "--can", "local:alien")
    check(program, 1, r"node 2 \(right_drive\): boot error M: .*product code 0x1018:02 is 0x.*, expected 0x000004F6")


@pytest.mark.rest
def test_a_second_robot_on_the_same_channel_and_one_of_the_same_name(stage):
    first = stage.robby("busy")
    check(
        stage.call("run", "robby", "--as", "other", "--can", "local:busy"),
        2,
        f"local:busy is busy: process {first.pid}",
    )
    check(
        stage.call("run", "robby", "--as", "busy", "--can", "local:free"), 2, rf"named busy .*\(process {first.pid}\)"
    )
    assert first.running
    stage.robby("second")
    check(stage.call("status"), 2, "several robots are running: busy, second; choose one with --name")
    assert stage.call("status", "--name", "second").out.startswith("running")
    assert stage.call("shutdown", "--name", "second").wait() == 0
    assert stage.call("status").out.startswith("running")


def test_a_node_id_that_is_taken(stage):
    stage.drive("taken", 3)
    program = stage.call("drive", "--node-id", "3", "--eds", "TMCM-1270.eds", "--can", "local:taken")
    check(program, 1, "node-ID 3 already answers on local:taken; choose another --node-id")
    assert stage.programs[0].running


@pytest.mark.rest
def test_a_channel_without_an_adapter(stage):
    check(stage.call("run", "robby", "--can", "can77", "--real"), 2, "can77")
    check(stage.call("run", "robby", "--can", "nonsense:1", "--real"), 2, "no CAN interface 'nonsense:1'")


@pytest.mark.rest
def test_requests_that_a_robot_refuses(stage):
    stage.robby("refuses")
    for arguments, code, sentence in (
        (["command", "robby_forward_controller", 1], 2, "expects 2 values.*got 1; nothing was applied"),
        (["command", "robby_base_controller", 1, 1], 1, "robby_base_controller is unloaded.*switch --activate"),
        (["command", "robby_bas_controller", 1, 1], 2, "no controller 'robby_bas_controller' is loaded"),
        (["twist", "robby_forward_controller", 1, 1], 1, "robby_forward_controller accepts no twist"),
        (
            ["axis", "enable", "middle_drive"],
            2,
            r"no node 'middle_drive'; available: left_drive \(3\), right_drive \(2\)",
        ),
        (["axis", "enable", "9"], 2, r"no node '9'; available: left_drive \(3\), right_drive \(2\)"),
    ):
        check(stage.call(*arguments), code, sentence)
    assert stage.call("status").out.startswith("running")


def test_a_log_folder_that_cannot_be_written(stage):
    program = stage.call("run", "robby", "--can", "local:nolog", XDG_STATE_HOME="/proc/nothing")
    check(program, 2, "cannot write the log .*XDG_STATE_HOME")


def test_errors_are_reported_before_anything_begins(stage):
    check(stage.call("run", "robby", "--controller", "forwrd"), 2, "no controller 'forwrd'")
    assert sorted(stage.folder.rglob("*")) == [], "neither a socket nor a log"
