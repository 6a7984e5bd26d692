"""`tools/campaign --properties`: random examples from a printed seed, and failures that are reproduced."""

import subprocess

import pytest
from campaigner.__main__ import main
from support import properties

TESTS = """
import pytest
from hypothesis import given, strategies as st

@given(st.integers(0, 1000))
def test_it(number):
    assert number < 900

@pytest.mark.sweep
def test_many():
    pass

def test_other():
    pass
"""


def test_a_property_that_fails_is_found_beside_tests_of_many_values_and_its_seed_is_printed(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # half of the time of three short runs
    monkeypatch.setenv("PYTEST_PLUGINS", "xdist.plugin,pytest_timeout,_hypothesis_pytestplugin")
    path = tmp_path / "test_number.py"
    path.write_text(TESTS)
    assert main(["--properties", "--seed", "7", "--times", "10", str(path)]) == 1
    printed = capfd.readouterr().out
    assert "seed 7; again: tools/campaign --properties --seed 7" in printed
    assert "number=900" in printed
    assert "1 failed, 1 passed" in printed, "the third is not a property"


@pytest.mark.parametrize(("code", "result"), [(0, 0), (1, 1), (2, 1), (5, 1)])
def test_the_exit_code_reports_whether_all_properties_passed(monkeypatch, capsys, code, result):
    monkeypatch.setattr(subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, code))
    assert main(["--properties", "--seed", "1"]) == result
    assert ("no property was found" in capsys.readouterr().err) is (code == 5)


def test_a_test_of_many_values_runs_with_some_of_them_or_all(monkeypatch):
    monkeypatch.setattr(properties, "FACTOR", "10.0")
    assert properties.some_of(range(100)) == list(range(100))
    monkeypatch.setattr(properties, "FACTOR", None)
    assert properties.some_of(range(100)) == [0, 33, 66]
