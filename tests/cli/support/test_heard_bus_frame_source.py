"""A flight recording where a recording of frames is wanted."""

import argparse
import json

import pytest
from support.flightstory import record, saved

from canopen_control.cli.main import main
from canopen_control.cli.support.heard_bus import FlightSource, network_for, open_frames
from canopen_control.errors import ConfigError


@pytest.fixture
def flight(tmp_path):
    return saved(record("source", seconds=1, power_off_after=0.5), tmp_path)


def asked(**options):
    return argparse.Namespace(**{"config": None, "name": None, "eds": [], "bus": None, **options})


def test_frames_and_names_come_from_the_flight_recording(flight):
    source = open_frames(str(flight))
    assert isinstance(source, FlightSource)
    assert (source.skipped, source.problem) == (0, "")
    assert len(list(source)) == len(list(source)) > 100  # it can be read twice
    assert network_for(asked(), source).nodes[3].name == "left_drive"


def test_the_arguments_win_over_what_the_recording_says(flight):
    network = network_for(asked(eds=["9=TMCM-1270.eds"]), open_frames(str(flight)))
    assert set(network.nodes) == {9}


def test_trace_replay_and_export_read_it(flight, tmp_path, capsys):
    assert main(["trace", "--file", str(flight), "--json", "--service", "pdo"]) == 0
    traced = capsys.readouterr().out
    assert "left_drive" in {json.loads(line)["node"] for line in traced.splitlines()}
    assert main(["replay", str(flight), "--json", "--service", "pdo"]) == 0
    assert capsys.readouterr().out == traced
    assert main(["export", "csv", str(flight), "-o", str(tmp_path / "x.csv")]) == 0
    assert "left_drive" in (tmp_path / "x.csv").read_text()


def test_of_several_buses_one_is_chosen(flight, monkeypatch):
    from canopen_control.trace import flight_file

    whole = flight_file.read_flight(flight)
    whole.meta.buses["arm"] = "can1"
    monkeypatch.setattr(flight_file, "read_flight", lambda _: whole)
    with pytest.raises(ConfigError, match="--bus: can, arm"):
        open_frames(str(flight))
    with pytest.raises(ConfigError, match="no bus 'leg'"):
        open_frames(str(flight), "leg")
    assert open_frames(str(flight), "can").problem == ""
    assert "no frame of bus arm" in open_frames(str(flight), "arm").problem
    whole.meta.buses.clear()
    with pytest.raises(ConfigError, match="had no bus"):
        open_frames(str(flight))
