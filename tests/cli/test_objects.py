import json

import pytest
from support.onbus import GENERIC, TMCM, OnBus

from canopen_control.cli.main import main

BUS = "memory:objects"


@pytest.fixture
def drive(private_folders):
    with OnBus(BUS, {5: TMCM}) as bus:
        yield bus.nodes[5]


def objects(*words):
    return main(["objects", "5", *words, "--can", BUS, "--eds", TMCM])


def test_a_drive_reports_what_it_holds_and_what_that_means(drive, capsys):
    assert objects("0x6041", "0x1018:01", "--live") == 0
    text = capsys.readouterr().out.splitlines()
    assert text[1].split()[:2] == ["0x1018:01", "Identity"]
    assert text[2].endswith("(SWITCH ON DISABLED)")


def test_what_is_not_as_by_default_is_marked_and_can_be_had_alone(drive, capsys):
    assert objects("heartbeat", "--changed") == 1
    assert "every object has its default value" in capsys.readouterr().err
    assert main(["sdo", "write", "5", "0x1017", "900", "--can", BUS, "--eds", TMCM]) == 0
    capsys.readouterr()
    assert objects("heartbeat", "--changed", "--json") == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["index"], row["value"], row["default"], row["changed"]) == ("0x1017", "900", "0", True)


def test_without_live_reading_an_eds_is_enough(private_folders, capsys):
    assert main(["objects", "5", "0x1400*", "--eds", GENERIC, "--tree"]) == 0
    text = capsys.readouterr().out.splitlines()
    assert text[0].startswith("0x1400 ")
    assert text[2].startswith("  :01 ")
    assert "0x00000205" in text[2]


def test_what_is_not_there_is_reported(drive, capsys):
    assert objects("nosuch", "--live") == 2
    assert "no object 'nosuch' in the EDS" in capsys.readouterr().err
    assert main(["objects", "6", "--live", "--can", BUS, "--eds", TMCM, "--timeout", "0.1"]) == 1
    assert "node 6: 0x1000:00: no answer" in capsys.readouterr().err
    assert main(["objects", "5", "--live", "--can", BUS]) == 2
    assert "has no EDS; give one with --eds FILE" in capsys.readouterr().err
