import os
import signal
import subprocess
import sys

import pytest
from support.host import eventually

from canopen_control.cli.verbs import parser_of
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.monitor import drive_objects
from canopen_control.monitor.drive_objects import WORKS, WorkRun, work_words

LINES = {
    "jog": ("20rpm,3s", "jog left --velocity=20rpm --for=3"),
    "scope": ("0x6064,left_wheel_joint:velocity,--for=5", "scope left:0x6064 left_wheel_joint:velocity --for=5"),
    "tune": ("step=30rpm,--yes", "tune left --step=30rpm --yes"),
    "backup": ("a.dcf", "backup left -o a.dcf"),
    "diff": ("right", "diff right left"),
    "restore": ("a.dcf,--store", "restore a.dcf left --store"),
    "clone": ("right,--keep", "clone right left --keep"),
    "firmware": ("new.bin", "firmware left new.bin"),
    "dump": ("csv", "dump left --format csv"),
    "nmt": ("preop", "nmt preop left"),
}


def test_every_work_has_its_line_here():
    assert LINES.keys() == WORKS.keys()


@pytest.mark.parametrize("name", WORKS)
def test_a_line_becomes_the_words_of_its_verb_which_knows_them(name):
    text, words = LINES[name]
    made = work_words(name, text, "left", "robby")
    assert made == [*words.split(), "--name=robby"]
    args = parser_of(made[0]).parse_args(made[1:])
    assert args.name == "robby"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("90deg", "jog left --position=90deg"),
        ("-90deg,--max-current=300", "jog left --position=-90deg --max-current=300"),
        ("1rad/s,2", "jog left --velocity=1rad/s --for=2"),
        ("20rpm,--for=1", "jog left --velocity=20rpm --for=1"),
    ],
)
def test_a_jog_is_a_speed_for_a_time_or_a_way(text, words):
    assert work_words("jog", text, "left", "robby") == [*words.split(), "--name=robby"]


def test_an_empty_line_and_no_drive_are_told():
    with pytest.raises(ConfigError, match=r"backup: fill in FILE\.dcf"):
        work_words("backup", " , ", "left", "robby")
    with pytest.raises(ConfigError, match="backup: no drive is selected"):
        work_words("backup", "a.dcf", "", "robby")


@pytest.mark.process
def test_a_verb_runs_beside_and_its_lines_come():
    run = WorkRun(["eds", "show", "TMCM-1270.eds", "0x6081"])
    lines = []
    assert eventually(lambda: lines.extend(run.fresh()) or run.code is not None, 60)
    assert eventually(lambda: lines.extend(run.fresh()) or any("Profile velocity" in each for each in lines))
    assert run.code == 0
    run.end()  # it has ended already
    run.close()


@pytest.mark.process
def test_a_verb_that_is_asked_to_end_ends_as_with_ctrl_c():
    run = WorkRun(["simulate", "robby", "--for", "1h", "--speed", "1", "--faults", "none"])
    assert eventually(lambda: any("runs:" in each for each in run.fresh()), 60)
    run.close()
    assert run.code is not None


@pytest.mark.process
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="prctl is Linux's")
def test_a_verb_ends_when_who_began_it_is_killed():
    program = (
        "import time; from canopen_control.monitor.drive_objects import WorkRun\n"
        "run = WorkRun(['simulate', 'robby', '--for', '1h', '--speed', '1', '--faults', 'none'])\n"
        "while not any('runs:' in each for each in run.fresh()): time.sleep(0.01)\n"
        "print(run._process.pid, flush=True); time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as beginner:
        child = int(beginner.stdout.readline())
        assert os.path.exists(f"/proc/{child}")
        beginner.send_signal(signal.SIGKILL)
    assert eventually(lambda: not os.path.exists(f"/proc/{child}") or _state(child) == "Z", 30)


def _state(pid):
    with open(f"/proc/{pid}/stat") as file:
        return file.read().rpartition(")")[2].split()[0]


@pytest.mark.process
def test_a_process_that_cannot_be_is_told(monkeypatch):
    monkeypatch.setattr(drive_objects.sys, "executable", "/nowhere/python")
    with pytest.raises(CanopenError, match="backup cannot be started: No such file"):
        WorkRun(["backup", "left"])
