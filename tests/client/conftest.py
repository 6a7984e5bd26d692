from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from support.host import use_private_folders

from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


@pytest.fixture
def reactor() -> Iterator[Reactor]:
    """A reactor on a manual clock; a callback that raises fails the test."""
    with Reactor(ManualClock()) as loop:
        raised: list[BaseException] = []
        loop.on_error = raised.append
        yield loop
        assert raised == []


@pytest.fixture
def run_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return use_private_folders(monkeypatch, tmp_path)
