import contextlib
import signal
import subprocess
import sys
import threading

import pytest
from support.host import TIMEOUT_S, eventually, runs
from support.parameter_node import session_with

from canopen_control.cli.support.parsers import parser_of
from canopen_control.commissioning.jobs import JOBS
from canopen_control.commissioning.object_rows import LiveObject
from canopen_control.data_files import data_path
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.monitor import drive_objects
from canopen_control.monitor.drive_objects import OBJECT_COLUMNS, DriveObjects, WorkRun, work_words
from canopen_control.monitor.monitor_content import Cell, Tone
from canopen_control.od.eds import read_eds
from canopen_control.rpc.messages.robot import NodePlace

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


@pytest.mark.parametrize("name", JOBS)
def test_a_line_becomes_the_arguments_of_its_verb(name):
    text, words = LINES[name]
    created = work_words(name, text, "left", "robby")
    assert created == [*words.split(), "--name=robby"]
    args = parser_of(created[0]).parse_args(created[1:])
    assert args.name == "robby"


def test_an_empty_line_and_no_drive_are_reported():
    with pytest.raises(ConfigError, match=r"backup: enter FILE\.dcf"):
        work_words("backup", " , ", "left", "robby")
    with pytest.raises(ConfigError, match="backup: no drive is selected"):
        work_words("backup", "a.dcf", "", "robby")


@pytest.mark.process
def test_a_verb_runs_alongside_and_its_lines_come():
    run = WorkRun(["eds", "show", "TMCM-1270.eds", "0x6081"])
    lines = []
    assert eventually(lambda: lines.extend(run.fresh()) or run.code is not None)
    assert eventually(lambda: lines.extend(run.fresh()) or any("Profile velocity" in line for line in lines))
    assert run.code == 0
    run.end()  # it has ended already
    run.close()


@pytest.mark.process
def test_a_verb_that_is_asked_to_end_ends_as_with_ctrl_c(monkeypatch):
    monkeypatch.setattr(drive_objects, "_GRACE_S", TIMEOUT_S)
    run = WorkRun(["simulate", "robby", "--for", "1h", "--speed", "1", "--faults", "none"])
    assert eventually(lambda: any("runs:" in item for item in run.fresh()))
    run.close()
    assert run.code == 0, "with the result so far"


@pytest.mark.process
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="prctl is Linux's")
def test_a_verb_ends_when_its_parent_is_killed():
    program = (
        "import time; from canopen_control.monitor.drive_objects import WorkRun\n"
        "run = WorkRun(['simulate', 'robby', '--for', '1h', '--speed', '1', '--faults', 'none'])\n"
        "while not any('runs:' in each for each in run.fresh()): time.sleep(0.01)\n"
        "print(run._process.pid, flush=True); time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as beginner:
        child = int(beginner.stdout.readline())
        assert runs(child)
        beginner.send_signal(signal.SIGKILL)
    assert eventually(lambda: not runs(child))


@pytest.mark.process
def test_a_process_that_cannot_be_is_reported(monkeypatch):
    monkeypatch.setattr(drive_objects.sys, "executable", "/nowhere/python")
    with pytest.raises(CanopenError, match="backup cannot be started: No such file"):
        WorkRun(["backup", "left"])


EDS = data_path("eds", "TMCM-1270.eds")
OD = read_eds(EDS, 3).od
LEFT = NodePlace(name="left_drive", node_id=3, eds=str(EDS))
RIGHT = NodePlace(name="right_drive", node_id=2, eds=str(EDS))


class Watched:
    def __init__(self):
        self.watched = []

    def watch(self, _screen, node, entries):
        self.watched.append((node.place.name, [entry.index for entry in entries]))


@pytest.fixture
def objects(monkeypatch):
    monkeypatch.setattr(drive_objects, "LiveReader", Watched)
    return DriveObjects("monitor")


def looked_at(objects, place=LEFT):
    objects.choose("robby", place)
    assert eventually(lambda: bool(objects.rows()))
    return objects


def test_the_whole_dictionary_is_there_in_the_words_of_the_verb(objects):
    rows = looked_at(objects).rows()
    assert len(rows) == len(OD.entries)
    assert all(len(cells) == len(OBJECT_COLUMNS) for cells in rows.values())
    assert [str(row) for row in rows["0x6081:00"]] == [
        *("0x6081:00", "Profile velocity", "-", "", "", "-", "UNSIGNED32", "rww")
    ]
    assert objects.title == "left_drive, node 3"


def test_what_is_in_sight_is_read_and_shown(objects):
    looked_at(objects).watch(["0x6081:00", "0x6041:00", "nothing"])
    assert objects._reader.watched[-1] == ("left_drive", [0x6081, 0x6041])
    objects._node.keep(LiveObject(OD[0x6041, 0], 0x0637))
    objects._node.keep(LiveObject(OD[0x1017, 0], 100))
    objects._node.keep(LiveObject(OD[0x6081, 0], None, "abort 0x06020000"))
    rows = objects.rows()
    assert rows["0x6041:00"][2:5] == (Cell("0x0637"), Cell(""), Cell("OPERATION ENABLED, target reached"))
    assert rows["0x1017:00"][2] == Cell("100", Tone.WARN)  # not the default
    assert rows["0x6081:00"][2] == Cell("refused", Tone.BAD)
    objects.leave()
    assert objects._reader.watched[-1] == ("left_drive", [])


def test_a_search_means_what_it_means_to_the_verb(objects):
    looked_at(objects).search("0x6081,velocity")
    result = objects.rows()
    assert {"0x6081:00", "0x606C:00"} <= set(result)
    assert "0x1017:00" not in result
    assert "search: 0x6081,velocity" in objects.title
    with pytest.raises(ConfigError, match="no object 'flux' in the EDS"):
        objects.search("flux")
    objects.search("")
    assert len(objects.rows()) == len(OD.entries)


def test_another_drive_has_rows_of_its_own(objects):
    looked_at(objects)._node.keep(LiveObject(OD[0x1017, 0], 100))
    objects.rows()
    looked_at(objects, RIGHT)
    assert objects._reader.watched[-1] == ("left_drive", [])
    assert objects.rows()["0x1017:00"][2] == Cell("-")
    looked_at(objects, LEFT)
    assert eventually(lambda: objects.rows()["0x1017:00"][2] == Cell("100", Tone.WARN))


def test_what_keeps_it_from_being_read_is_reported(objects, tmp_path):
    objects.choose("robby", None)
    assert objects.title == "no drive is selected"
    assert objects.rows() == {}
    objects.choose("robby", NodePlace(name="bare", node_id=4))
    assert eventually(lambda: "the node has no EDS in bus.yml" in objects.title)
    objects.choose("robby", NodePlace(name="gone", node_id=5, eds=str(tmp_path / "gone.eds")))
    assert eventually(lambda: "cannot be read" in objects.title)
    looked_at(objects)._node.lost = "node 3 does not answer"
    assert "node 3 does not answer" in objects.title


@pytest.fixture
def edited(objects, monkeypatch):
    """The left drive, whose objects are those of a stub."""
    created = session_with(OD)
    created.write_value(OD[0x6081, 0], 1000)

    @contextlib.contextmanager
    def session(_node):
        yield created

    monkeypatch.setattr(drive_objects.NodeObjects, "session", session)
    return looked_at(objects)


def test_an_object_is_written_within_its_limits_and_the_write_is_undone(edited):
    assert edited.write("0x6081=2500") == "0x6081:00 Profile velocity: 1000 -> 2500"
    assert edited.write(" 6081:00 = 0x10 ").endswith("2500 -> 16")
    assert edited.undo().endswith("16 -> 2500")
    assert edited.undo().endswith("2500 -> 1000")
    with pytest.raises(ConfigError, match="no edit to undo"):
        edited.undo()


def test_a_second_undo_waits_for_the_first(edited, monkeypatch):
    edited.write("0x6081=2500")
    edited.write("0x6081=16")
    real, first, go_on, inside = drive_objects.NodeObjects.session, threading.Event(), threading.Event(), []

    @contextlib.contextmanager
    def slow(node):
        inside.append(node)
        first.set()
        assert go_on.wait(60)
        with real(node) as session:
            yield session

    monkeypatch.setattr(drive_objects.NodeObjects, "session", slow)
    words = []
    undos = [threading.Thread(target=lambda: words.append(edited.undo())) for _ in range(2)]
    for item in undos:
        item.start()
    assert first.wait(60)
    assert len(inside) == 1
    go_on.set()
    for item in undos:
        item.join(60)
    assert [word.rpartition(": ")[2] for word in words] == ["16 -> 2500", "2500 -> 1000"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0x6081", r"set 0x6081: write an object and its value, as in 0x6081=1000"),
        ("=5", "write an object and its value"),
        ("0x6081=", "write an object and its value"),
        ("velocity=5", r"velocity matches \d+ objects; give one, as 0x"),
        ("0x6041=5", "read-only; nothing was written"),
        ("0x60FF=5", "moves the axis"),
        ("0x6081=fast", "'fast' is not a valid UNSIGNED32: .*; nothing was written"),
        ("0x9999=1", "no object '0x9999' in the EDS"),
    ],
)
def test_what_cannot_be_written_is_reported(edited, text, message):
    with pytest.raises(ConfigError, match=message):
        edited.write(text)


def test_without_a_drive_nothing_is_written(objects):
    objects.choose("robby", None)
    for work in (lambda: objects.write("0x6081=1"), objects.undo):
        with pytest.raises(ConfigError, match="no drive is selected"):
            work()
