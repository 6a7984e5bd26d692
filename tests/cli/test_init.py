"""The verb init: created files, output, and refusals of impossible requests."""

import contextlib
import errno
import os
import re
from pathlib import Path
from typing import ClassVar

import pytest
from support.drive_shapes import shape, write_shape
from support.eds import DEVIATIONS
from support.onbus import OnBus

from canopen_control.cli import init, scan
from canopen_control.cli.main import main
from canopen_control.cli.scan import FoundNode, ScanResult
from canopen_control.commissioning.identity import DeviceIdentity
from canopen_control.data_files import data_path
from canopen_control.errors import SdoAbort
from canopen_control.master import direct

TMCM = ["--eds", "TMCM-1270.eds"]
MALFORMED = DEVIATIONS.parent / "malformed"


@pytest.fixture(autouse=True)
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(capsys, *words):
    """Return the sentence of a refusal, after which nothing is there."""
    before = sorted(Path().iterdir())
    assert main(["init", *words]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert sorted(Path().iterdir()) == before
    return output.err.removeprefix("canopen-control: ").strip()


def test_a_robot_is_made_and_the_next_commands_are_named(capsys):
    assert main(["init", "turntable", *TMCM, "--node-id", "5", "--joint", "table_joint"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "created turntable/: TMCM-1270.eds, bus.yml, ros2_controllers.yaml, turntable.urdf",
        "  node 5 table_drive: moves table_joint, velocity in PV",
        "counts per revolution are guessed for table_drive (guesses in bus.yml); measure them",
        "turn it on virtual devices: canopen-control demo turntable",
        "on real drives, after checking bus.yml: canopen-control preflight turntable --can can0",
    ]
    assert main(["check", "turntable", "--strict"]) == 0


def test_the_next_commands_are_valid_for_a_folder_with_a_space(capsys):
    assert main(["init", "my robots/head", *TMCM, "--node-id", "5"]) == 0
    *_, demo, preflight = capsys.readouterr().out.splitlines()
    assert demo.endswith(": canopen-control demo 'my robots/head'")
    assert preflight.endswith(": canopen-control preflight 'my robots/head' --can can0")


def test_joints_are_named_in_one_list(capsys):
    assert main(["init", "head", *TMCM, "--node-id", "5,6", "--joint", "pan,tilt"]) == 0
    assert [line.split()[4] for line in capsys.readouterr().out.splitlines()[1:3]] == ["pan,", "tilt,"]


def test_each_eds_has_the_node_ids_at_its_place():
    ids = ["--eds", "generic_cia402.eds", "--node-id", "2,3", *TMCM, "--node-id", "0x10"]
    assert main(["init", "mixed", *ids]) == 0
    text = Path("mixed/bus.yml").read_text()
    assert text.count("dcf: generic_cia402.eds") == 2
    assert text.count("dcf: TMCM-1270.eds") == 1
    assert "node_id: 16 " in text


def test_an_io_module_alone_is_a_bus_without_joints(here, capsys):
    module = write_shape(here, shape(drop=(0x6040, 0x6041), pdos=[(False, 0, 0x180, [0x60FD0020])]), "module.eds")
    assert main(["init", "lamps", "--eds", str(module), "--node-id", "7"]) == 0
    assert sorted(path.name for path in Path("lamps").iterdir()) == ["bus.yml", "module.eds"]
    output = capsys.readouterr().out
    assert "no device has a known drive or signal profile, so the robot has a bus but no controllers" in output
    assert output.endswith("boot it on virtual devices: canopen-control run lamps\n")
    assert main(["check", "lamps"]) == 0


BAD = {
    "an id that is none": ([*TMCM, "--node-id", "0"], "--node-id 0: '0' is not a node-ID; they are 1 to 127"),
    "an id above 127": ([*TMCM, "--node-id", "2,128"], "'128' is not a node-ID"),
    "no number": ([*TMCM, "--node-id", "two"], "'two' is not a node-ID"),
    "an id twice": ([*TMCM, "--node-id", "3,3"], "node-ID 3 is given twice"),
    "more joints than drives": ([*TMCM, "--node-id", "3", "--joint", "a", "--joint", "b"], "2 joints for 1 drive;"),
    "a base with one drive": ([*TMCM, "--node-id", "3", "--base", "diff"], "--base diff needs two drives"),
    "no node-ID": ([*TMCM], "--node-id N is missing"),
    "no EDS": (["--node-id", "3"], "--eds FILE is missing; give both, or --can CHANNEL"),
    "a file that is not there": (["--eds", "gone.eds", "--node-id", "3"], "no EDS file gone.eds"),
    "two files and one list of ids": ([*TMCM, "--eds", "generic_cia402.eds", "--node-id", "3"], "2 --eds and 1 --node"),
    "ids and a bus": (["--can", "local:x", "--node-id", "3"], "--can finds the node-IDs itself"),
    "a channel that is none": (["--can", "nonsense:x"], "nonsense"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_cannot_be_is_one_sentence_and_no_folder(what, capsys):
    words, text = BAD[what]
    reported = refused(capsys, "fresh", *words)
    assert text in reported
    assert "\n" not in reported


@pytest.mark.parametrize("path", sorted(MALFORMED.glob("4[1-4]*.eds")), ids=lambda path: path.stem)
def test_a_file_that_is_not_an_eds_reports_this(path, capsys):
    assert str(path) in refused(capsys, "fresh", "--eds", str(path), "--node-id", "3")


def test_a_folder_that_is_there_is_kept(capsys):
    Path("fresh").mkdir()
    Path("fresh/bus.yml").write_text("mine")
    assert "--force" in refused(capsys, "fresh", *TMCM, "--node-id", "3")
    assert main(["init", "fresh", *TMCM, "--node-id", "3", "--force"]) == 0
    assert Path("fresh/bus.yml").read_text() != "mine"


@pytest.fixture
def full_disk(monkeypatch):
    """Let the disk be full when the EDS is copied, which is written last."""
    write = Path.write_bytes

    def fill(path, data):
        write(path, data[:100])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    monkeypatch.setattr(Path, "write_bytes", fill)


@pytest.mark.usefixtures("full_disk")
@pytest.mark.parametrize("name", ["fresh", "cells/north/fresh"])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(here, capsys, name):
    assert main(["init", name, *TMCM, "--node-id", "3"]) == 1
    error = capsys.readouterr().err
    assert error.startswith(
        f"canopen-control: {name}: No space left on device; nothing was written; free some space on "
    )
    assert error.count("\n") == 1
    assert list(here.rglob("*")) == []


def test_a_full_disk_leaves_a_folder_as_it_was(here, capsys, request):
    assert main(["init", "fresh", *TMCM, "--node-id", "3"]) == 0
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    request.getfixturevalue("full_disk")
    assert main(["init", "fresh", *TMCM, "--node-id", "4", "--force"]) == 1
    assert {path: path.read_bytes() for path in here.rglob("*") if path.is_file()} == before


# --- from a bus ---


def found(monkeypatch, *nodes):
    """Let a scan find these nodes."""
    survey = ScanResult("local:x", {node.node_id: node for node in nodes})
    monkeypatch.setattr(scan, "survey_channel", lambda _channel, _timeout: survey)
    monkeypatch.setattr(init, "ask_drives", lambda *_what: None)


def who(product, vendor=0x286, **more):
    return DeviceIdentity(device_type=0x192, vendor_id=vendor, product_code=product, **more)


def without_product(path, vendor):
    text = data_path("eds", "TMCM-1270.eds").read_text()
    text = re.sub(r"ProductNumber=.*", "ProductNumber=", text)
    begin, middle, rest = text.partition("[1018sub2]")
    rest = re.sub(r"DefaultValue=.*\n", "", rest, count=1)
    begin = re.sub(r"VendorNumber=.*", f"VendorNumber=0x{vendor:X}", begin)
    begin, sub1, identity = begin.partition("[1018sub1]")
    path.write_text(begin + sub1 + re.sub(r"DefaultValue=.*", f"DefaultValue=0x{vendor:X}", identity) + middle + rest)
    return str(path)


@pytest.mark.parametrize(("vendor", "device"), [(0x286, 0x286), (0, 0x286), (0, 0)])
def test_an_eds_without_a_product_code_is_taken_where_it_is_given(tmp_path, monkeypatch, capsys, vendor, device):
    found(monkeypatch, FoundNode(5, who(0x99, vendor=device)))
    inputs = without_product(tmp_path / "maker.eds", vendor)
    assert main(["init", "found", "--can", "local:x", "--eds", inputs]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.endswith("of local:x, after checking bus.yml: canopen-control preflight found --can local:x")
    assert Path("found/maker.eds").exists()
    assert "product code" in Path("found/bus.yml").read_text()


def test_an_eds_that_was_given_and_is_for_another_device_is_named(tmp_path, monkeypatch, capsys):
    found(monkeypatch, FoundNode(5, who(0x99, vendor=0x1)))
    inputs = without_product(tmp_path / "maker.eds", 0x286)
    assert main(["init", "found", "--can", "local:x", "--eds", inputs]) == 2
    assert f"not the device of {inputs}; add its EDS with --eds" in capsys.readouterr().err


def test_a_robot_may_be_made_at_a_path(capsys):
    assert main(["init", "robots/fresh", *TMCM, "--node-id", "3"]) == 0
    assert "demo robots/fresh" in capsys.readouterr().out
    assert main(["check", "robots/fresh"]) == 0


def test_a_problem_is_marked_and_reported_in_one_sentence(capsys):
    eds = str(Path(__file__).parents[1] / "data" / "eds_edits" / "nohb.eds")
    assert main(["init", "fresh", "--eds", eds, "--node-id", "2,3"]) == 0
    out = capsys.readouterr().out
    assert out.count("PROBLEM, marked in bus.yml too:") == 1
    assert "nothing would stop this drive" in out
    assert "# PROBLEM" in Path("fresh/bus.yml").read_text()
    assert main(["check", "fresh"]) == 2


def test_a_device_on_the_bus_gets_the_matching_eds(monkeypatch, capsys):
    found(
        monkeypatch,
        FoundNode(2, who(0x4F6, revision_number=1, serial_number=77, device_name="TMCM-1270")),
        FoundNode(9, who(0x123)),
        FoundNode(10),
    )
    assert main(["init", "found", "--can", "local:x"]) == 0
    output = capsys.readouterr()
    assert "node 9, vendor 0x00000286, product 0x00000123: no matching EDS; add it with --eds" in output.err
    assert "node 10 does not answer SDO requests" in output.err
    text = Path("found/bus.yml").read_text()
    assert "node_id: 2 " in text
    assert "# TMCM-1270, serial number 77, its EDS is for revision 0x" in text
    assert main(["check", "found", "--strict"]) == 0


def test_a_file_that_is_given_is_matched_too(here, monkeypatch):
    own = write_shape(here, shape(), "own.eds")  # vendor 0x99, product 0x1234
    found(monkeypatch, FoundNode(4, who(0x1234, vendor=0x99)))
    assert main(["init", "found", "--can", "local:x", "--eds", str(own)]) == 0
    assert Path("found/own.eds").read_bytes() == own.read_bytes()


class Answering:
    """In place of a bus on which the drives answer with these bytes, and refuse everything else."""

    answers: ClassVar = {}

    @classmethod
    def open(cls, *_where, **_how):
        return contextlib.nullcontext(cls())

    def read_many(self, wanted):
        return {address: self.answers.get(address, SdoAbort(*address, 0x06020000)) for address in wanted}


def test_what_a_drive_reports_of_itself_goes_before_its_eds(here, monkeypatch):
    ask = init.ask_drives
    own = write_shape(here, shape(), "own.eds")
    found(monkeypatch, FoundNode(4, who(0x1234, vendor=0x99)))
    monkeypatch.setattr(init, "ask_drives", ask)
    monkeypatch.setattr(direct, "DirectBus", Answering)
    message = {(4, 0x608F, 1): 2500, (4, 0x6502, 0): 0x81}
    monkeypatch.setattr(Answering, "answers", {key: value.to_bytes(4, "little") for key, value in message.items()})
    assert main(["init", "found", "--can", "local:x", "--eds", str(own)]) == 0
    text = Path("found/bus.yml").read_text()
    assert "counts_per_revolution: 2500 " in text
    assert "position_mode: 8 " in text  # of positions alone, though the EDS has velocities too


def test_an_empty_bus_creates_no_files(monkeypatch, capsys):
    found(monkeypatch)
    assert main(["init", "found", "--can", "local:x"]) == 1
    assert "no node answers on local:x" in capsys.readouterr().err
    assert not Path("found").exists()


def test_a_bus_with_unknown_nodes_creates_no_files(monkeypatch, capsys):
    found(monkeypatch, FoundNode(9, who(0x123)))
    assert main(["init", "found", "--can", "local:x"]) == 2
    assert (
        "no EDS matches any device on local:x; pass the manufacturers' files with --eds FILE" in capsys.readouterr().err
    )


@pytest.mark.rest
@pytest.mark.process
def test_two_commands_from_an_eds_to_a_motor_that_turns(stage):
    eds = data_path("eds", "generic_cia402.eds")
    created = stage.call("init", "fresh", "--eds", eds, "--node-id", "4")
    assert created.wait() == 0, created
    played = stage.call("demo", "fresh", "--for", "4.5")
    assert played.wait() == 0, played
    assert "10.000 rad/s" in played.out
    row = [line.split() for line in played.out.splitlines() if line.startswith("joint_1_drive")]
    assert any(float(words[-2]) > 1.0 for words in row), played


def test_a_robot_is_made_of_the_drives_on_a_bus(capsys):
    with OnBus("memory:initbus", {6: TMCM[1]}):
        assert main(["init", "found", "--can", "memory:initbus"]) == 0
    output = capsys.readouterr().out
    assert "node 6 joint_1_drive: moves joint_1, velocity in PV" in output
    assert "counts per revolution are guessed" in output
    assert main(["check", "found", "--strict"]) == 0


def test_a_mode_that_is_in_the_file_is_not_proposed_again(tmp_path):
    words = ["--eds", "generic_cia402.eds", "--node-id", "2", "--like", "vfd"]
    assert main(["init", str(tmp_path / "fan"), *words]) == 0
    assert (tmp_path / "fan" / "bus.yml").read_text().count("velocity_mode: 2") == 1


def test_drives_of_a_manufacturer_that_is_named_have_the_keys_that_they_need(tmp_path, capsys):
    words = ["--eds", "generic_cia402.eds", "--node-id", "2"]
    assert main(["init", str(tmp_path / "ours"), *words, "--like", "elmo"]) == 0
    assert "\n  enable_settle_ms: 600\n" in (tmp_path / "ours" / "bus.yml").read_text()
    assert main(["init", str(tmp_path / "plain"), *words]) == 0
    assert "enable_settle_ms" not in (tmp_path / "plain" / "bus.yml").read_text()
    capsys.readouterr()
    assert main(["init", str(tmp_path / "none"), *words, "--like", "emo"]) == 2
    assert "no personality 'emo' (did you mean 'elmo'?)" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_a_manufacturer_of_drives_is_for_drives_alone(tmp_path, capsys):
    words = ["--like", "elmo", "--eds", "generic_cia401.eds", "--node-id", "5"]
    assert main(["init", str(tmp_path / "lamps"), *words]) == 2
    assert "--like elmo is for drives, and none of the devices is one; omit it" in capsys.readouterr().err
    assert not (tmp_path / "lamps").exists()
    assert main(["init", str(tmp_path / "mixed"), *words, "--eds", "generic_cia402.eds", "--node-id", "2"]) == 0


def test_the_present_folder_is_named_by_its_path_if_it_is_empty(here, monkeypatch, capsys):
    folder = here / "cart"
    folder.mkdir()
    monkeypatch.chdir(folder)
    assert main(["init", ".", "--eds", "generic_cia402.eds", "--node-id", "2,3", "--base", "diff"]) == 0
    assert f"canopen-control demo {folder}" in capsys.readouterr().out
    assert '<robot name="cart">' in (folder / "cart.urdf").read_text()
    assert main(["init", ".", "--eds", "generic_cia402.eds"]) == 2
    assert "exists already" in capsys.readouterr().err
