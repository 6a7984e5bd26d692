"""The verb quirk, on a virtual drive that runs in a thread."""

from __future__ import annotations

import json

import pytest
from support.virtualbench import served, servo

from canopen_control.cli.main import main
from canopen_control.virtual.quirks import QUIRKS

CAN = "memory:cli-quirk"


@pytest.fixture
def node():
    device = servo(5)
    with served(CAN, device):
        yield device


def test_list_explains_every_quirk_with_clause_and_source(capsys):
    assert main(["quirk", "list"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for quirk in QUIRKS.values():
        assert f"{quirk.name} The drive {quirk.does}." in text
    assert text.count("Source:") == text.count("Departs from") == len(QUIRKS)
    assert "Strength: 0.001 to 60 s (default: 0.5)." in text


def test_list_as_json_has_one_entry_for_each(capsys):
    assert main(["quirk", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [item["name"] for item in listed] == list(QUIRKS)
    assert listed[0].keys() == {"name", "acts", "does", "clause", "source", "unit", "default", "low", "high"}


def test_a_quirk_is_switched_on_and_off_without_a_master(node, capsys):
    assert main(["quirk", "5", "--can", CAN]) == 0
    assert main(["quirk", "5", "brake_delay=0.7", "on", "--can", CAN]) == 0
    assert main(["quirk", "5", "remote_never", "on", "--can", CAN]) == 0
    assert main(["quirk", "5", "--can", CAN]) == 0
    assert main(["drive", "--node-id", "5", "--can", CAN, "--status"]) == 0
    assert main(["quirk", "5", "brake_delay", "off", "--can", CAN, "--json"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:4] == [
        "node 5: no active quirk",
        "node 5: brake_delay=0.7",
        "node 5: brake_delay=0.7, remote_never",
        "node 5: brake_delay=0.7, remote_never",
    ]
    assert lines[4].endswith("; quirks: brake_delay=0.7, remote_never")
    assert lines[-1] == '{"node_id": 5, "active": ["remote_never"]}'
    assert not node.drives[0].statusword() & 1 << 9


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["5", "brake_dely"], "no quirk 'brake_dely'"),
        (["5", "brake_delay=99"], "the strength must be a number, 0.001 to 60 s"),
        (["5", "brake_delay@1", "on"], "node 5 has no axis 1; it has: 0"),
        (["5", "brake_delay"], f"add on or off: canopen-control quirk 5 brake_delay on --can {CAN}; to list"),
        (["list", "brake_delay"], "quirk list takes no arguments"),
    ],
)
def test_what_is_wrong_is_one_sentence(node, capsys, words, sentence):
    assert main(["quirk", *words, "--can", CAN]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert len(error.splitlines()) == 1


def test_a_drive_is_not_started_with_what_is_not_a_quirk(capsys):
    start = ["drive", "--node-id", "3", "--eds", "generic_cia402.eds", "--can", "memory:no-quirk", "--quirk"]
    assert main([*start, "brake_dely"]) == 2
    assert "did you mean 'brake_delay'" in capsys.readouterr().err
    assert main([*start, "brake_delay@4"]) == 2
    assert "node 3 has no axis 4" in capsys.readouterr().err
