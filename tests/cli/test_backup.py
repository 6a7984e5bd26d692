"""The verb backup: output, files and exit codes."""

import json
import os

import pytest
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cli.main import main
from canopen_control.commissioning.parameter_set import read_backup
from canopen_control.master.config import read_bus


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:backup", {3: TMCM, 5: GENERIC}) as devices:
        devices.options = ["--can", "memory:backup"]
        yield devices


def test_a_backup_holds_what_the_node_holds(bus, tmp_path, capsys):
    bus.call(lambda: bus.nodes[3].store.set(0x6081, 0, 1600))
    path = tmp_path / "left.dcf"
    assert main(["backup", "3", "-o", str(path), *bus.options, "--eds", TMCM]) == 0
    backup = read_backup(path)
    assert (backup.values[0x6081, 0], backup.identity.serial_number, backup.identity.software) == (1600, 3, "3.26")
    assert capsys.readouterr().out == f"node 3: {len(backup.values)} parameters to {path}\n"


def test_json_names_what_was_left_out(bus, tmp_path, capsys):
    path = tmp_path / "wrong.dcf"
    assert main(["backup", "5", "-o", str(path), *bus.options, "--eds", TMCM, "--json"]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert (reported["node_id"], reported["parameters"]) == (5, len(read_backup(path).values))
    assert any("0x2003:00" in line and "abort 0x06020000" in line for line in reported["left_out"])


def test_without_an_eds_or_a_folder_nothing_is_read(bus, tmp_path, capsys):
    assert main(["backup", "3", "-o", str(tmp_path / "x.dcf"), *bus.options]) == 2
    assert "--eds FILE" in capsys.readouterr().err
    assert main(["backup", "3", "-o", str(tmp_path / "no" / "x.dcf"), *bus.options, "--eds", TMCM]) == 2
    assert "no such folder" in capsys.readouterr().err
    assert list(tmp_path.glob("*.dcf")) == []
    assert main(["backup", "3", "-o", "-", *bus.options, "--eds", TMCM]) == 2
    assert "a backup is written to a file" in capsys.readouterr().err


def test_a_full_disk_leaves_the_file_that_was_there(bus, capsys):
    if not os.path.exists("/dev/full"):
        pytest.skip("no /dev/full here")
    assert main(["backup", "3", "-o", "/dev/full", *bus.options, "--eds", TMCM]) == 1
    assert "/dev/full" in capsys.readouterr().err


@pytest.mark.rest
def test_a_robot_is_made_of_a_backup_and_boots_its_values(bus, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    bus.call(lambda: bus.nodes[3].store.set(0x6081, 0, 1600))
    assert main(["backup", "3", "-o", "left.dcf", *bus.options, "--eds", TMCM]) == 0
    assert main(["init", "cell", "--eds", "left.dcf", "--node-id", "4", "--allow-unsupervised"]) == 0
    config = read_bus(tmp_path / "cell" / "bus.yml")
    writes = next(iter(config.plans.values())).writes
    assert ((0x6081, 0), (1600).to_bytes(4, "little")) in [(write.address, write.data) for write in writes]
