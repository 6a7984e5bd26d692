from __future__ import annotations

import pytest

from canopen_control.bus import local
from canopen_control.errors import ConfigError, EdsError
from canopen_control.host.sockets import close_listener, listen, socket_path
from canopen_control.virtual.launch import DriveOptions, reopen, run_drives


def test_what_cannot_be_started_is_said_before_anything_runs(tmp_path):
    lines = []
    with pytest.raises(EdsError):
        run_drives([3], tmp_path / "none.eds", "memory:launch", DriveOptions(), lines.append)
    with pytest.raises(ConfigError):
        run_drives([3], tmp_path / "none.eds", "local:a/b", DriveOptions(), lines.append)
    assert lines == []


def test_a_bus_whose_hub_dies_at_this_moment_is_not_started_for_a_drive_that_looks_for_it(monkeypatch):
    started = []
    monkeypatch.setattr(local, "_start_hub", started.append)
    dying = listen(socket_path("bus", "dying"))  # connects, and never greets
    monkeypatch.setattr(local, "greet", lambda sock, *_: sock.close())  # as who is reset instead of greeted
    assert reopen("local:dying", "drive 3") is None
    close_listener(dying)
    assert reopen("local:dying", "drive 3") is None
    assert reopen("memory:gone", "drive 3") is None
    assert started == []
