import argparse
import json
from dataclasses import replace

import pytest
from support.parameter_node import session_with

from canopen_control.cli.support.open_session import reached, restore_into
from canopen_control.cli.support.parsers import parser_of
from canopen_control.commissioning.parameter_set import read_parameters
from canopen_control.commissioning.restore import Reached
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


@pytest.fixture(autouse=True)
def _folders(private_folders):
    """Keep the journals out of the user's folder."""


def arguments(*words):
    return parser_of("restore").parse_args(["5", "left.dcf", *words])


def backup(**changes):
    found = read_parameters(session_with(TMCM), twice=False)[0]
    values = {(int(name[1:5], 16), 0): value for name, value in changes.items()}
    return replace(found, values={**found.values, **values}, where="left.dcf")


def test_the_report_is_printed(capsys):
    assert restore_into(session_with(TMCM), backup(s6081=9), arguments("--protect", "0x6083")) == 0
    out = capsys.readouterr().out
    assert "kept as it is: 0x6083:00" in out
    assert out.endswith("1 written; not stored: a power cycle undoes it (--store)\n")


def test_what_was_refused_goes_to_standard_error_and_is_the_exit_code(capsys):
    session = session_with(TMCM)
    session.transfers.device.store.ceilings.inject({0x6083: 1})
    assert restore_into(session, backup(s6083=9), arguments()) == 1
    told = capsys.readouterr()
    assert "canopen-control: refused: 0x6083:00" in told.err
    assert told.out.endswith("1 parameters refused; the drive is as it was\n")


def test_the_same_as_json(capsys):
    assert restore_into(session_with(TMCM), backup(s6081=9), arguments("--json", "--store")) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["written"], found["stored"], found["source"]) == (1, True, "left.dcf")
    counts = ["written", "verified", "protected", "foreign", "refused"]
    assert list(found) == ["source", "node_id", *counts, "undone", "stored"]


def test_how_a_node_is_reached_is_told_by_its_arguments():
    assert reached(argparse.Namespace(can="can0", name=None)) == Reached("can0")
    assert reached(argparse.Namespace(name="robby", include_protected=True)) == Reached("", "robby", True)
