"""The verb diff: output and exit codes."""

import json

import pytest
from support.onbus import TMCM, OnBus

from canopen_control.cli.main import main


@pytest.fixture
def bus(private_folders):
    with OnBus("memory:diff", {3: TMCM, 4: TMCM}) as devices:
        devices.options = ["--can", "memory:diff"]
        yield devices


@pytest.fixture
def backup(bus, tmp_path, capsys):
    path = tmp_path / "left.dcf"
    assert main(["backup", "3", "-o", str(path), *bus.options, "--eds", TMCM]) == 0
    capsys.readouterr()
    return str(path)


@pytest.mark.rest
def test_a_file_and_the_node_it_is_of_are_equal_and_need_no_eds(bus, backup, capsys):
    assert main(["diff", backup, "3", *bus.options]) == 0
    assert capsys.readouterr().out.endswith("and node 3: 132 parameters, equal\n")
    assert main(["diff", backup, backup]) == 0


def test_a_difference_ends_with_1_and_names_both_values(bus, backup, capsys):
    bus.call(lambda: bus.nodes[4].store.set(0x6081, 0, 77))
    assert main(["diff", "4", backup, *bus.options]) == 1
    output = capsys.readouterr()
    _head, line = output.out.splitlines()
    assert line.split() == ["0x6081:00", "Profile", "velocity", "77", "0"]
    assert output.err == ""  # another serial number is not news


@pytest.mark.rest
def test_two_nodes_are_compared_by_their_eds(bus, backup, capsys):
    assert main(["diff", "3", "4", *bus.options, "--eds", TMCM]) == 0
    bus.call(lambda: bus.nodes[4].store.set(0x6083, 0, 9))
    assert main(["diff", "3", "4", *bus.options, "--eds", TMCM, "--json"]) == 1
    reported = json.loads(capsys.readouterr().out.partition("\n")[2])
    assert reported["differences"] == [
        {"index": 0x6083, "subindex": 0, "name": "Profile acceleration", "a": "0", "b": "9"}
    ]
    assert reported["compared"] == 132


def test_what_the_node_refuses_is_a_difference_with_its_reason(bus, backup, capsys):
    bus.call(lambda: bus.nodes[3].store.od.entries.pop((0x6081, 0)))
    assert main(["diff", backup, "3", *bus.options]) == 1
    assert "abort 0x06090011" in capsys.readouterr().out
