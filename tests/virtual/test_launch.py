from __future__ import annotations

import json

import pytest

from canopen_control.bus import local
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, EdsError
from canopen_control.host.sockets import close_listener, listen, socket_path
from canopen_control.virtual import launch
from canopen_control.virtual.device import FORMAT
from canopen_control.virtual.launch import DriveOptions, reopen, run_drives
from canopen_control.virtual.process import DriveProcess


def test_what_cannot_be_started_is_reported_before_anything_runs(tmp_path):
    lines = []
    with pytest.raises(EdsError):
        run_drives([3], tmp_path / "none.eds", "memory:launch", DriveOptions(), lines.append)
    with pytest.raises(ConfigError):
        run_drives([3], tmp_path / "none.eds", "local:a/b", DriveOptions(), lines.append)
    assert lines == []


def test_a_node_id_that_lss_has_stored_is_checked_as_well(tmp_path, monkeypatch):
    checked = []

    class Check:
        def __init__(self, _reactor, _port, node_ids):
            checked.append([*node_ids])

        def finish(self):
            pass

    monkeypatch.setattr(launch, "NodeIdCheck", Check)
    monkeypatch.setattr(DriveProcess, "run", lambda _process: 0)
    record = {"device": [0x286, 0x4F6], "node_id": 9, "bitrate": None, "values": {}}
    (tmp_path / "store.json").write_text(json.dumps({"format": FORMAT, "nodes": {"3": record}}))
    options = DriveOptions(store=tmp_path / "store.json")
    assert run_drives([3, 4], data_path("eds", "TMCM-1270.eds"), "memory:launch", options, print) == 0
    assert checked == [[3, 4], [9]]


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
