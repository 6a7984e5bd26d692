"""Checks of an EDS: each detects an error in one line of the file."""

import pytest

from canopen_control.conformance.run import run_checks
from canopen_control.conformance.sdo_checks import EDS_CHECKS
from canopen_control.data_files import data_path
from canopen_control.od.eds import parse_eds

TEXT = data_path("eds", "generic_cia402.eds").read_text()
MUTANTS = {  # line, what stands there instead, check
    "E01": ("[1000]\n", "[1000]\nnonsense\n"),
    "E02": ("[1001]\n", "[1F00]\n"),
    "E03": ("[1001]\n", "[1F00]\n"),
    "E04": ("[607Dsub2]\n", "[607Dsub3]\n"),
    "E05": (
        "[603F]\nParameterName=Error code\nObjectType=0x7\nDataType=0x0006",
        "[603F]\nParameterName=Error code\nObjectType=0x7\nDataType=0x0099",
    ),
    "E12": ("BaudRate_", "Rate_"),
    "E13": ("[6502]\n", "[6503]\n"),
}


def verdicts(node):
    return {result.id: result for result in run_checks(node, EDS_CHECKS).results if result.group == "306"}


def test_the_bundled_files_pass_and_none_is_skipped_without_a_reason(bench):
    assert {result.verdict for result in verdicts(bench()).values()} == {"passed"}
    node = bench()
    node.eds = None
    assert {result.observed for result in verdicts(node).values()} == {"no EDS; give one with --eds"}


@pytest.mark.parametrize("check", MUTANTS)
def test_a_wrong_line_is_found(bench, check):
    line, other = MUTANTS[check]
    assert line in TEXT
    node = bench()
    node.eds = parse_eds(TEXT.replace(line, other).encode(), 5)
    assert verdicts(node)[check].verdict == "failed"


def test_a_failure_names_the_line(bench):
    node = bench()
    node.eds = parse_eds(TEXT.replace("[1000]\n", "[1000]\nnonsense\n").encode(), 5)
    line = TEXT[: TEXT.index("[1000]\n")].count("\n") + 2
    assert verdicts(node)["E01"].observed.startswith(f"line {line}: ")
