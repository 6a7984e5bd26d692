"""`tools/campaign --properties`: random examples from a seed that is printed, and what is found is found again."""

import pytest
from campaigner.__main__ import main
from support import properties

PROPERTY = """
from hypothesis import given, strategies as st

@given(st.integers(0, 1000))
def test_it(number):
    assert number < 900
"""


@pytest.fixture
def prop(tmp_path):
    path = tmp_path / "test_number.py"
    path.write_text(PROPERTY)
    return str(path)


def test_a_property_that_fails_is_found_and_its_seed_is_printed(prop, capfd):
    assert main(["--properties", "--seed", "7", "--times", "10", prop]) == 1
    printed = capfd.readouterr().out
    assert "seed 7; again: tools/campaign --properties --seed 7" in printed
    assert "number=900" in printed


def test_a_test_of_many_values_runs_with_all_of_them(tmp_path, monkeypatch, capfd):
    path = tmp_path / "test_many.py"
    path.write_text("import pytest\n\n@pytest.mark.sweep\ndef test_it():\n    pass\n\ndef test_other():\n    pass\n")
    assert main(["--properties", "--seed", "1", str(path)]) == 0
    assert "1 passed" in capfd.readouterr().out
    monkeypatch.setattr(properties, "FACTOR", "10.0")
    assert properties.some_of(range(100)) == list(range(100))
    monkeypatch.setattr(properties, "FACTOR", None)
    assert properties.some_of(range(100)) == [0, 33, 66]
