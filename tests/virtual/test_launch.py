from __future__ import annotations

import pytest

from canopen_control.errors import ConfigError, EdsError
from canopen_control.virtual.launch import Options, run_drives


def test_what_cannot_be_started_is_said_before_anything_runs(tmp_path):
    lines = []
    with pytest.raises(EdsError):
        run_drives([3], tmp_path / "none.eds", "memory:launch", Options(), lines.append)
    with pytest.raises(ConfigError):
        run_drives([3], tmp_path / "none.eds", "local:a/b", Options(), lines.append)
    assert lines == []
