import argparse
import json
from dataclasses import replace

import pytest
from support.parameter_node import restored, session_with

from canopen_control.cli.support.job_verb import VerbRun, add_job_options, job_options
from canopen_control.cli.support.parsers import parser_of
from canopen_control.commissioning.jobs import CLONE, FIRMWARE, RESTORE, ProgramOptions, RestoreOptions
from canopen_control.commissioning.parameter_set import read_parameters
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds

TMCM = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od


def arguments(*words):
    return parser_of("restore").parse_args(["5", "left.dcf", *words])


def backup(**changes):
    result = read_parameters(session_with(TMCM), twice=False)[0]
    values = {(int(name[1:5], 16), 0): value for name, value in changes.items()}
    return replace(result, values={**result.values, **values}, where="left.dcf")


def test_the_report_is_printed(capsys):
    assert restored(session_with(TMCM), backup(s6081=9), arguments("--protect", "0x6083")) == 0
    out = capsys.readouterr().out
    assert "not written: 0x6083:00" in out
    assert out.endswith("1 written; not stored: a power cycle undoes it (--store)\n")


def test_what_was_refused_goes_to_standard_error_and_is_the_exit_code(capsys):
    session = session_with(TMCM)
    session.transfers.device.store.ceilings.inject({0x6083: 1})
    assert restored(session, backup(s6083=9), arguments()) == 1
    output = capsys.readouterr()
    assert "canopen-control: refused: 0x6083:00" in output.err
    assert output.out.endswith("1 parameters refused; the drive is unchanged\n")


def test_the_same_as_json(capsys):
    assert restored(session_with(TMCM), backup(s6081=9), arguments("--json", "--store")) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["written"], result["stored"], result["source"]) == (1, True, "left.dcf")
    counts = ["written", "verified", "protected", "foreign", "refused"]
    assert list(result) == ["source", "node_id", *counts, "undone", "stored"]


def parsed(job, *words):
    parser = argparse.ArgumentParser(exit_on_error=False)
    add_job_options(parser, job)
    return job_options(parser.parse_args(words), job)


def test_the_declared_options_are_those_of_the_verb():
    assert parsed(RESTORE) == RestoreOptions(protect=[])
    assert parsed(RESTORE, "--any-node", "--protect", "0x2*", "--protect", "x") == RestoreOptions(
        protect=["0x2*", "x"], any_node=True
    )
    assert parsed(FIRMWARE, "--program", "2", "--expect", "0x1A") == ProgramOptions(2, 0x1A)
    with pytest.raises(argparse.ArgumentError, match="'255' is not a number of a program: 1 to 254"):
        parsed(FIRMWARE, "--program", "255")
    with pytest.raises(SystemExit):
        parsed(CLONE, "--any-node")


def test_a_note_and_the_progress_are_for_standard_error(capsys):
    run = VerbRun(RESTORE, "restore")
    run.part("writing node 5", "groups")
    run.at(1, 2)
    run.note("look at this")
    run.close()
    output = capsys.readouterr()
    assert (output.out, output.err) == ("", "canopen-control: look at this\n")
    assert (run.done, run.total, run.doing) == (1, 2, "writing node 5")
