"""Fixtures of the bus tests."""

from __future__ import annotations

import pytest
from support.localbus import runtime_folders


@pytest.fixture
def runtime(monkeypatch):
    """A runtime folder of this test alone; the hubs in it end with the test."""
    with runtime_folders(monkeypatch.setenv) as folder:
        yield folder
