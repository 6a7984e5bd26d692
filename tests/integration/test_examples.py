"""Every example in the help of the verbs, and every command of README and docs, runs unchanged.

Those that need a robot share one; after each it is made again what it was, so that their order does not matter. The
examples of one verb are run in the order of its help. What cannot run here is understood at least, with its reason in
support/examples.py.
"""

import contextlib
import re
import signal
import sys
import time

import pytest
from support.examples import (
    NOT_RUN,
    OTHER_PROGRAMS,
    PROGRAM,
    help_examples,
    page_commands,
    page_examples,
    page_file,
    reason_not_to_run,
)
from support.host import eventually
from support.processes import Stage
from support.ros import domain
from support.terminal import Tmux

from canopen_control import Robot
from canopen_control.bus.local import ask_hub
from canopen_control.cli.main import main
from canopen_control.cli.verbs import VERBS
from canopen_control.client import find_robots
from canopen_control.client.drive_client import DriveClient
from canopen_control.errors import CanopenError, ControlError
from canopen_control.rpc.messages.drive import GetDriveState, SwitchFault
from canopen_control.rpc.messages.hub import ClearFaults, GetHubStatus

FORWARD, BASE = "robby_forward_controller", "robby_base_controller"
#: Verbs that bring what they need, and so run where nothing else does.
ALONE = ("run", "demo", "drive", "device")
#: But not with this: it asks what runs, and ends.
ASKING = "--status"
#: What does not end by itself, by its first words -> what it says when it works ("": it says nothing then).
ENDLESS = {
    ("run",): r" runs: ",
    ("demo",): r"^running, cycle",
    ("drive",): r"ready on",
    ("device",): r"ready on",
    ("status", "--watch"): r"^running, cycle",
    ("trace", "--events"): r"",
    ("trace", "--node"): r"sdo",
    ("trace",): r"sync",
    ("view",): r"http://127\.0\.0\.1:\d+",
    ("record",): r"",
    ("gateway", "--unix"): r"CiA 309-3 at",
    ("ros", "topic", "echo"): r"left_wheel_joint",
    ("ros", "topic", "pub"): r"publishing",
}
#: What looks at a terminal, and what stands there then.
ON_A_TERMINAL = {"monitor": "left_drive", "teleop": "hold a key to move"}
LONG_S = 10.0  # examples that take longer by their own --for are interrupted
TIMEOUT_S = 40.0


def endless(words):
    """Return what an example says that has to be interrupted, None for one that ends by itself."""
    if ASKING in words:
        return None
    lasting = [float(words[at + 1]) for at, word in enumerate(words) if word == "--for"]
    if "--file" in words or any(seconds <= LONG_S for seconds in lasting):
        return None
    return next((text for first, text in ENDLESS.items() if tuple(words[: len(first)]) == first), None)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """The folders of the shared robot, where the examples run: with the files that they name."""
    with pytest.MonkeyPatch.context() as patch, domain() as number:
        folder, place = tmp_path_factory.mktemp("run"), tmp_path_factory.mktemp("examples")
        folder.chmod(0o700)
        patch.setenv("XDG_RUNTIME_DIR", str(folder))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_LOG_DIR", str(folder / "log"))
        stage = Stage(folder, place)
        make_cell(stage)
        make_files(start_robby(stage))
        yield stage
        stage.end()


def start_robby(stage):
    stage.start("run", "robby").until("robby runs")
    return stage


def make_cell(stage):
    """Make the folder that the page on a bus without controllers shows."""
    cell = stage.place / "cell"
    cell.mkdir()
    (cell / "bus.yml").write_text(page_file("bus_alone.md", "cell/bus.yml"), encoding="utf-8")


def make_own_robot(stage):
    """Make the robot that the pages make of an EDS."""
    assert stage.call(*next(words for words in PAGES if words[0] == "init")).wait() == 0


def make_hall(stage):
    """Make a world of Gazebo with a wall."""
    wall = "<model name='wall'><static>true</static><pose>3 0 0.5 0 0 0</pose><link name='l'><collision name='c'>"
    wall += "<geometry><box><size>0.1 4 1</size></box></geometry></collision></link></model>"
    (stage.place / "hall.sdf").write_text(f"<sdf version='1.9'><world name='hall'>{wall}</world></sdf>")


#: What examples start or read -> how each comes to be.
FOLDERS = {"cell": make_cell, "my_robot": make_own_robot, "hall.sdf": make_hall}


def make_files(stage):
    """Make what the examples read: run.log, and a flight record of a fault."""
    stage.call("fault", "left_drive", "drive_fault", "on")
    assert stage.call("record", "--can", "run.log", "--for", "1").wait() == 0
    stage.call("fault", "left_drive", "drive_fault", "off")
    flights = stage.folder / "state/canopen_control/robby/flight"
    assert eventually(lambda: list(flights.glob("*.zip")), TIMEOUT_S)
    restore(stage)


def restore(stage):
    """Make the shared robot what it was at its start: nothing broken, nothing latched, its wheels at rest."""
    if "robby" not in find_robots():
        assert eventually(lambda: not any(program.running for program in stage.programs), TIMEOUT_S)
        start_robby(stage)
        return
    ask_hub("robby", ClearFaults())
    for node_id in (2, 3):
        mend_drive(node_id)
    with Robot.attach("robby") as robot:
        robot.release()
        for node in ("left_drive", "right_drive"):
            main(["nmt", "start", node])  # in this process: what is tested is before and after
        assert eventually(lambda: all(node.ready for node in robot.nodes().values()), TIMEOUT_S), robot.nodes()
        if BASE in robot.controllers():
            robot.switch(activate=[FORWARD], deactivate=[BASE])
            main(["controller", "unload", BASE])
        with contextlib.suppress(ControlError):  # no drive has a fault
            robot.axis("fault-reset")
        robot.axis("enable")


def mend_drive(node_id):
    with DriveClient.connect("local:robby", node_id, TIMEOUT_S) as drive:
        for name in drive.ask(GetDriveState()).faults:
            drive.ask(SwitchFault(name=name, on=False))


def let_a_drive_fail():
    """Let a drive fail for a moment, so that it has a fault to reset."""
    with DriveClient.connect("local:robby", 3, TIMEOUT_S) as drive, Robot.attach("robby") as robot:
        drive.ask(SwitchFault(name="drive_fault", on=True))
        assert eventually(lambda: robot.state() == "fault", TIMEOUT_S)
        drive.ask(SwitchFault(name="drive_fault", on=False))


@pytest.fixture
def robby(home, monkeypatch):
    """The stage of the shared robot."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(home.folder))  # not that of this test alone
    monkeypatch.setenv("XDG_STATE_HOME", str(home.folder / "state"))
    yield home
    restore(home)


def expect_run(stage, words):
    """Run one example, as its user would."""
    if reason_not_to_run(words) is not None:
        expect_parsed(words)
    elif words[0] in ON_A_TERMINAL and "--topic" not in words:
        look(stage, words)
    elif (text := endless(words)) is not None:
        made, kept = stage.place / "run.log", stage.place / "made.log"
        if words[0] == "record":
            made.rename(kept)  # an existing file is refused
        interrupt(stage, words, text)
        if words[0] == "record":
            kept.replace(made)  # an interrupted recorder may have received nothing
    else:
        program = stage.call(*words, seconds=TIMEOUT_S)
        assert program.wait() == 0, program.err
        assert [line for line in program.err.splitlines() if NOTES.get(words[0], line + ".") not in line] == [], program


#: what a verb says beside its work
NOTES = {
    "dump": "reading node 3 (left_drive)",  # a busy machine takes long
    "replay": "no program has local:bench open, so it is created",
}


def expect_parsed(words):
    """Let the command line parse an example, and do no more."""
    words = list(words)
    words.insert(words.index("--ros-args") if "--ros-args" in words else len(words), "--help")  # ROS takes what follows
    with pytest.raises(SystemExit) as caught:
        main(words)
    assert caught.value.code == 0


def interrupt(stage, words, said):
    """Run what does not end until it works, then press Ctrl-C."""
    program = stage.start(*words)
    end = time.monotonic() + TIMEOUT_S
    while said and not re.search(said, program.out, re.MULTILINE | re.IGNORECASE):
        assert program.running, program
        assert time.monotonic() < end, f"{program} has not said {said!r}"
        provoke()
        time.sleep(0.1)
    if not said:
        assert eventually(lambda: listens(stage, program), TIMEOUT_S), program
    assert program.end(signal.SIGINT) in (0, 130), program
    assert "Traceback" not in program.err, program


def listens(stage, program):
    """Whether a recorder or a listener is at work: on the bus, or with the folder of its bag made."""
    members = ask_hub("robby", GetHubStatus()).members
    return program.pid in [member.pid for member in members] or (stage.place / "run").exists()


def provoke():
    """Let the robot that runs, if one does, say something on its bus, for who listens there."""
    with contextlib.suppress(CanopenError), Robot.attach("robby") as robot:
        robot.sdo_read("left_drive", 0x1001)


def look(stage, words):
    """Run on a terminal what shows itself there."""
    terminal = Tmux(stage.place)
    try:
        terminal.run(" ".join([sys.executable, "-m", "canopen_control", *words]))
        terminal.until(ON_A_TERMINAL[words[0]], TIMEOUT_S)
        terminal.keys("C-c" if words[0] == "teleop" else "q")
        assert eventually(lambda: terminal.screen.rstrip().endswith("$"), TIMEOUT_S), terminal.screen
    finally:
        terminal.close()


@pytest.fixture
def bridge(robby):
    """The bridge of the shared robot, for the examples of ROS."""
    program = robby.start("ros", "bridge", "--name", "robby")
    yield program
    program.end(signal.SIGINT)


def marks_of(words):
    """Return what an example needs of a machine."""
    if reason_not_to_run(words) is not None:
        return []
    needs = {"ros": words[0] == "ros" or "--ros" in words or "--topic" in words, "tmux": words[0] in ON_A_TERMINAL}
    return [getattr(pytest.mark, name) for name, expected in needs.items() if expected]


HELP = help_examples()
PAGES = page_examples()
SHARED = [verb for verb in HELP if verb not in (*ALONE, "ros")]


@pytest.mark.parametrize(
    "verb", [pytest.param(verb, marks=[mark for words in HELP[verb] for mark in marks_of(words)]) for verb in SHARED]
)
def test_the_examples_of_a_verb_run(robby, verb):
    for words in HELP[verb]:
        if verb == "teleop" and "--topic" in words:
            expect_parsed(words)  # publishes for a robot of ROS elsewhere: tests/integration/test_ros_tutorial.py
        else:
            expect_run(robby, words)


@pytest.mark.ros
def test_the_examples_of_ros_run(robby, bridge):
    for words in [*HELP["ros"], *(words for words in PAGES if words[0] == "ros")]:
        expect_run(robby, words)


ALL_OF_HELP = [words for examples in HELP.values() for words in examples]
STARTING = [words for words in ALL_OF_HELP if words[0] in ALONE and ASKING not in words]
STARTING += [words for words in PAGES if words[0] in ALONE and ASKING not in words and words not in STARTING]
OTHERS = [words for words in PAGES if words[0] not in (*ALONE, "ros") and words not in ALL_OF_HELP]
OTHERS += [words for words in ALL_OF_HELP if words[0] in ALONE and ASKING in words]
OF_CELL = [words for words in OTHERS if "lift" in words and reason_not_to_run(words) is None]
OF_ROBBY = [words for words in OTHERS if words not in OF_CELL and words[0] != "init"]


def as_parameters(examples):
    return [pytest.param(words, marks=marks_of(words), id=" ".join(words)) for words in examples]


@pytest.mark.parametrize("words", as_parameters(STARTING))
def test_what_starts_something_runs_where_nothing_else_does(stage, words, monkeypatch):
    with domain() as number:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
        for name in FOLDERS.keys() & set(words):
            FOLDERS[name](stage)
        expect_run(stage, words)


def test_the_commands_of_a_bus_without_controllers_move_its_drive(stage):
    make_cell(stage)
    stage.start("run", "cell").until("cell runs")
    *before, moving = OF_CELL
    assert moving[:2] == ["command", "lift"]  # until Ctrl-C: the last, whatever the pages add
    for words in before:
        expect_run(stage, words)
    program = stage.start(*moving)
    with Robot.attach("cell") as robot:
        assert eventually(lambda: abs(robot.joints()["lift"].position - float(moving[-1])) < 0.01, TIMEOUT_S)
    assert program.end(signal.SIGINT) in (0, 130), program


@pytest.mark.parametrize("words", as_parameters(OF_ROBBY))
def test_the_other_commands_of_the_pages_run(robby, words):
    if "fault-reset" in words:
        let_a_drive_fail()
    if words[0] == "fault" and words[-1] == "off":
        expect_run(robby, [*words[:-1], "on"])
    expect_run(robby, words)


def test_every_verb_has_an_example_of_its_own():
    assert list(HELP) == list(VERBS)
    assert [verb for verb, examples in HELP.items() if verb not in {words[0] for words in examples}] == []


def test_every_command_of_the_pages_is_run_or_has_a_reason():
    others = {line.split()[0] for line in page_commands()} - {PROGRAM}
    assert others == set(OTHER_PROGRAMS)


def test_every_reason_not_to_run_is_needed():
    lines = [" ".join(words) for words in [*ALL_OF_HELP, *PAGES]]
    assert [pattern for pattern in NOT_RUN if not any(re.search(pattern, line) for line in lines)] == []
