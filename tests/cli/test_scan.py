"""The verb scan: on a bare bus, and on that of a running robot."""

import json
import shutil

import pytest
from support.liverobot import STRANGER, live_robot
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.bus.channel import ChannelKind
from canopen_control.bus.memory import MemoryBus
from canopen_control.cli import scan as verb
from canopen_control.cli.main import main
from canopen_control.data_files import data_path
from canopen_control.frame import CanFrame

FAST = ["--timeout", "0.05"]
TMCM_ROW = "0xFFFF0192  0x00000286  0x000004F6  0x0003001A"


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:scan", {2: TMCM, 3: GENERIC}) as drives:
        yield drives


def scan(*arguments, channel="memory:scan"):
    return main(["scan", "--can", channel, *FAST, *arguments])


def test_everybody_on_a_bare_bus_is_named_with_the_eds_that_fits(bus, capsys):
    assert scan() == 0
    head, two, three, *known = capsys.readouterr().out.splitlines()
    assert head.split()[:2] == ["node", "device"]
    assert "bus.yml" not in head
    assert two.split() == ["2", *TMCM_ROW.split(), "0x00000002", "TMCM-1270", "-", "TMCM-1270.eds"]
    assert three.endswith("Generic CiA 402 servo  -    generic_cia402.eds")
    assert known == ["node 2 is known as Trinamic TMCM-1270 (`canopen-control drive --like tmcm1270`)"]


def test_nothing_is_written_and_only_the_three_objects_are_read(private_folders):
    watcher = Watcher()
    with OnBus("memory:watch", {2: TMCM}, cores=(watcher,)):
        assert scan(channel="memory:watch") == 0
    requested = [frame for frame in watcher.seen if 0x600 < frame.can_id < 0x680]
    assert {frame.can_id - 0x600 for frame in requested} == set(range(1, 128))
    initiates = {frame.data[:4].hex() for frame in requested if frame.data[0] >> 5 == 2}
    assert initiates == {"40001000", "40181001", "40181002", "40181003", "40181004", "40081000"}
    assert {frame.data[0] >> 5 for frame in requested} <= {2, 3, 4}  # initiate upload, upload segment, abort
    assert not any(frame.can_id == 0 for frame in watcher.seen)


class Watcher:
    def __init__(self):
        self.seen = []

    def receive(self, frame, now):
        self.seen.append(frame)

    def frames(self):
        return []


def test_a_bus_yml_is_held_against_what_is_there(bus, capsys):
    assert scan("--config", "robby") == 1
    _, two, three, *_known = capsys.readouterr().out.splitlines()
    assert two.endswith("right_drive: as expected")
    assert three.endswith(
        "left_drive: device type 0xFFFF0192 expected, 0x00020192 reported, "
        "vendor 0x00000286 expected, 0x00000000 reported, product 0x000004F6 expected, 0x00000402 reported"
    )


def test_missing_and_additional_nodes_are_reported(private_folders, capsys):
    with OnBus("memory:scan", {2: TMCM, 9: TMCM}):
        assert scan("--config", str(data_path("config", "robby"))) == 1
    _, two, three, nine, *_known = capsys.readouterr().out.splitlines()
    assert two.endswith("right_drive: as expected")
    assert three.split() == ["3", *["-"] * 8, "left_drive:", "missing"]
    assert nine.endswith("not listed")


def test_the_same_as_json(bus, capsys):
    assert scan("--config", str(data_path("config", "robby") / "bus.yml"), "--json") == 1
    document = json.loads(capsys.readouterr().out)
    assert document["channel"] == "memory:scan"
    two, three = document["nodes"]
    assert (two["node_id"], two["vendor_id"], two["name"], two["problems"]) == (2, 0x286, "right_drive", [])
    assert (two["device_name"], two["eds"].rpartition("/")[2]) == ("TMCM-1270", TMCM)
    assert three["expected"]["product_code"] == 0x4F6
    assert len(three["problems"]) == 3


def test_a_node_that_answers_no_sdo_is_known_by_its_heartbeat(private_folders, capsys):
    beating = Beating()
    with OnBus("memory:scan", cores=(beating,)):
        assert scan("--config", "robby") == 1
    _, two, three, *_known = capsys.readouterr().out.splitlines()
    assert two.endswith("right_drive: missing")
    assert three.split() == ["3", *["-"] * 6, "STOPPED", "-", "left_drive:", "does", "not", "answer", "SDO", "requests"]


class Beating:
    """Says with every frame it hears that node 3 is stopped."""

    def receive(self, frame, now):
        pass

    def frames(self):
        return [CanFrame(0x703, b"\4")]


def test_eds_files_of_a_folder_match_too_and_what_is_none_is_named(bus, tmp_path, capsys):
    text = data_path("eds", TMCM).read_text(encoding="latin-1")
    newer = text.replace("0x0003001A", "0x0003001B").replace("196634", "196635")
    assert newer != text
    (tmp_path / "newer.eds").write_text(newer, encoding="latin-1")
    (tmp_path / "broken.EDS").write_text("no EDS")
    (tmp_path / "readme.txt").write_text("no EDS either")
    assert scan("--eds-dir", str(tmp_path)) == 0
    output = capsys.readouterr()
    assert output.out.splitlines()[1].endswith(TMCM)  # the revision chooses
    assert "broken.EDS" in output.err
    assert "readme" not in output.err


def test_another_revision_is_remarked(bus, monkeypatch, tmp_path, capsys):
    shutil.copy(data_path("eds", TMCM), tmp_path / "mine.eds")
    monkeypatch.setattr(verb, "data_names", lambda kind: [])
    bus.call(lambda: bus.nodes[2].store.set(0x1018, 3, 0x3001B))
    assert scan("--eds-dir", str(tmp_path)) == 0
    assert capsys.readouterr().out.splitlines()[1].endswith("mine.eds (for revision 0x0003001A)")


def test_a_node_whose_first_answer_comes_with_the_next_requests_is_read_again(private_folders, capsys):
    wire = MemoryBus.get("scan")
    with OnBus("memory:scan", {2: TMCM}, cores=(Releasing(wire, at=0x600 + 127),)):
        wire.hold(Once(0x582, index=0x1000))
        assert scan() == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:6] == ["2", *TMCM_ROW.split(), "0x00000002"]


def test_a_node_that_has_answered_may_take_longer_than_the_timeout(bus, capsys):
    wire = MemoryBus.get("scan")
    later = Once(0x583, index=0x1018, then=lambda: bus.reactor.call_threadsafe(release_later))

    def release_later():
        bus.reactor.call_later(150_000_000, wire.release)  # three times the timeout

    wire.hold(later)
    assert scan() == 0
    assert later.frame is not None
    assert capsys.readouterr().out.splitlines()[2].split()[2:4] == ["0x00000000", "0x00000402"]


def test_an_object_whose_answer_is_lost_is_read_again(bus, monkeypatch, capsys):
    monkeypatch.setattr(verb, "_PATIENCE_S", 0.2)
    wire = MemoryBus.get("scan")
    lost = Once(0x583, index=0x1018)
    wire.hold(lost)
    assert scan() == 0
    assert lost.frame is not None
    assert capsys.readouterr().out.splitlines()[2].split()[2:4] == ["0x00000000", "0x00000402"]


class Once:
    """Selects the first SDO frame with this COB-ID and index, and then calls `then`."""

    def __init__(self, can_id, index, then=lambda: None):
        self.can_id, self.index, self.then, self.frame = can_id, index.to_bytes(2, "little"), then, None

    def __call__(self, label, frame):
        if self.frame is not None or frame.can_id != self.can_id or frame.data[1:3] != self.index:
            return False
        self.frame = frame
        self.then()
        return True


class Releasing:
    """Releases what the wire holds when it hears a COB-ID."""

    def __init__(self, wire, at):
        self.wire, self.at = wire, at

    def receive(self, frame, now):
        if frame.can_id == self.at:
            self.wire.release()

    def frames(self):
        return []


@pytest.mark.rest
def test_the_bus_of_a_running_robot_its_own_nodes_through_it_and_a_stranger(private_folders, capsys):
    with live_robot("scanrobot") as drives:
        monkey = pytest.MonkeyPatch()
        monkey.setattr(ChannelKind, "shared", True)  # the robot is in this process
        for arguments in (["scan", *FAST], ["scan", "--can", "memory:scanrobot", *FAST]):
            assert main(arguments) == 0
            _, two, three, stranger, *_known = capsys.readouterr().out.splitlines()
            assert two.split()[0] == "2"
            assert "OPERATIONAL" in two
            assert two.endswith("right_drive: as expected")
            assert three.endswith("left_drive: as expected")
            assert stranger.split()[0] == str(STRANGER)
            assert stranger.endswith("not listed")
        monkey.undo()
        assert main(["scan", "--name", "scanrobot", *FAST]) == 0
        output = capsys.readouterr()
        assert len(output.out.splitlines()) == 4
        assert "memory:scanrobot can be opened only once" in output.err
        history = [
            (label, frame) for label, frame in MemoryBus.get("scanrobot").history if frame.can_id in (0x602, 0x603)
        ]
        assert {label for label, _ in history} == {"master"}  # one client for each server
        assert drives.errors == []


def test_a_robot_on_mock_hardware_has_no_bus(mock_robot, capsys):
    assert main(["scan"]) == 2
    assert "it runs on mock hardware" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (["--can", "memory:empty", *FAST], 1, "no node answers on memory:empty"),
        (["--can", "memory:empty", "--config", "nope"], 2, "nor a bundled robot ("),
        (["--can", "memory:empty", "--eds-dir", "/nope"], 2, "--eds-dir /nope: no such folder"),
        (["--can", "nonsense"], 2, "no such CAN interface"),
        (["--can", "memory:empty", "--timeout", "-1"], 2, "not a time in seconds above 0"),
        ([], 2, "no robot is running"),
    ],
)
def test_what_does_not_work_is_one_sentence(private_folders, arguments, code, text, capsys):
    try:
        result = main(["scan", *arguments])
    except SystemExit as stop:  # argparse
        result = stop.code
    error = capsys.readouterr().err
    assert (result, text in error) == (code, True), error
