import csv

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.cli.main import main
from canopen_control.od.eds import read_eds
from canopen_control.virtual.object_store import refuse

BUS = "memory:dump"


@pytest.fixture
def drive(private_folders):
    with OnBus(BUS, {5: TMCM}) as bus:
        yield bus.nodes[5]


def dump(*words):
    return main(["dump", "5", *words, "--can", BUS, "--eds", TMCM])


def test_a_dump_is_a_table_of_all_that_can_be_read(drive, capsys):
    assert dump() == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(drive.od)
    assert lines[0].startswith("address")


def test_a_dump_as_dcf_is_read_back_with_what_the_drive_held(drive, tmp_path, capsys):
    assert main(["sdo", "write", "5", "0x6083", "4711", "--can", BUS, "--eds", TMCM]) == 0
    path = tmp_path / "node.dcf"
    assert dump("--format", "dcf", "-o", str(path)) == 0
    assert f"of {len(drive.od)} objects to {path}" in capsys.readouterr().out
    file = read_eds(path)
    assert (file.od.node_id, file.od[0x6083, 0].parameter_value) == (5, 4711)
    assert file.od[0x6041, 0].parameter_value is None


def test_a_dump_as_csv_has_a_line_for_each_object(drive, tmp_path):
    path = tmp_path / "node.csv"
    assert dump("0x1018", "--format", "csv", "-o", str(path)) == 0
    with path.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["index"], row["subindex"]) for row in rows] == [("0x1018", str(sub)) for sub in range(5)]
    assert rows[1]["value"] == "0x00000286"


def test_a_file_that_cannot_be_written_is_reported(drive, tmp_path, capsys):
    assert dump("0x1018", "-o", str(tmp_path / "no" / "file")) == 2
    assert "cannot be written" in capsys.readouterr().err


def test_a_dump_of_nothing_that_can_be_read_is_not_a_success(drive, capsys):
    drive.store.on_read(0x1001, 0, lambda: refuse(0x08000000))
    assert dump("0x1001") == 1
    assert "node 5: none of these objects can be read" in capsys.readouterr().err
