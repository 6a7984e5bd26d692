"""Fixtures for the benchmark, which starts programs of its package in tools/."""

from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.fixture(autouse=True)
def programs_of_the_bench(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(TOOLS))
