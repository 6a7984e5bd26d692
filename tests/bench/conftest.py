"""The bench starts programs of its own package, which are in tools/ here."""

from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(autouse=True)
def programs_of_the_bench(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(TOOLS))
