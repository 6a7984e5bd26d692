import argparse
import json

import pytest
from support.flightstory import record, saved
from support.mockrobot import running

from canopen_control.cli.main import main
from canopen_control.cli.support.bus_description import (
    FlightSource,
    add_network_arguments,
    config_layout,
    described,
    network_for,
    open_frames,
    watched_bus,
)
from canopen_control.data_files import data_path
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


def test_the_arguments_win_over_what_the_recording_reports(flight):
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
    with pytest.raises(ConfigError, match="has no bus"):
        open_frames(str(flight))


def arguments(*inputs):
    parser = argparse.ArgumentParser()
    add_network_arguments(parser)
    return parser.parse_args(inputs)


def test_a_robots_files_give_the_names_on_any_channel():
    received = watched_bus(arguments("robby"), "local:nobody-runs-here")
    assert (received.channel, received.owner) == ("local:nobody-runs-here", "")
    assert received.network.nodes[3].name == "left_drive"
    assert received.network.channel == "local:nobody-runs-here"


def test_without_names_it_reports_this_and_continues(capsys):
    assert described(arguments()).nodes == {}
    assert "object names are unknown: give ROBOT, --name or --eds" in capsys.readouterr().err
    received = watched_bus(arguments(), "local:nobody-runs-here")
    assert received.network.nodes == {}
    assert capsys.readouterr().err == ""  # not before the bus is open
    received.report_notes()
    assert "object names are unknown: give ROBOT, --name or --eds" in capsys.readouterr().err


def test_a_robot_on_mock_hardware_has_no_bus():
    with running("layout-mock"), pytest.raises(ConfigError, match="has no bus, as on mock hardware"):
        watched_bus(arguments("--name", "layout-mock"), None)


def test_one_of_several_buses_is_chosen_by_name(tmp_path):
    source = data_path("config", "robby") / "bus.yml"
    for name in ("bus.yml", "bus_arm.yml"):
        (tmp_path / name).write_bytes(source.read_bytes())
    assert config_layout(str(tmp_path), "arm").master_node_id == 1
    with pytest.raises(ConfigError, match="several buses; choose with --bus: can, arm"):
        config_layout(str(tmp_path))
    with pytest.raises(ConfigError, match="no bus 'leg'; choose with --bus: can, arm"):
        config_layout(str(tmp_path), "leg")


def test_a_bus_in_place_of_a_robot_is_reported_with_where_it_goes(tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="local:bare is a bus, not a robot: write --can local:bare"):
        watched_bus(arguments("local:bare"), None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "can0").mkdir()
    for robot in ("robby", "can0"):
        with pytest.raises(ConfigError, match="no robot is running"):
            watched_bus(arguments(robot), None)
