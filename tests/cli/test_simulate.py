import itertools
import json

import pytest
from support.robots import copy_robby

from canopen_control.cli.main import main
from canopen_control.simulation.served_simulation import ServedSimulation
from canopen_control.simulation.simulation_run import SimulationRun


def simulate(capsys, *words):
    code = main(["simulate", *words])
    output = capsys.readouterr()
    return code, output.out, output.err


def test_json_ends_with_one_object(capsys):
    code, out, _ = simulate(capsys, "robby", "--for", "2s", "--seed", "3", "--json")
    result = json.loads(out)
    assert code == 0
    assert (result["seed"], result["robot_s"], result["breaches"]) == (3, 2.0, [])
    assert len(result["sha256"]) == 64
    assert result["frames"] > 100


def test_events_are_reported_with_their_time_and_then_what_came_of_it(capsys):
    code, out, _ = simulate(capsys, "robby", "--for", "1s")
    lines = out.splitlines()
    assert code == 0
    assert any("robby runs" in line for line in lines)
    assert lines[-1].startswith("seed 0: 1 s of the robot in ")


def test_a_scenario_is_played(capsys, tmp_path):
    path = tmp_path / "lost.yml"
    path.write_text("for: 3s\nseed: 5\nsteps:\n  - {at: 1s, node: 3, fault: silent}\n")
    code, out, _ = simulate(capsys, "robby", "--scenario", str(path))
    assert code == 0
    assert "node 3" in out
    assert out.splitlines()[-1].startswith("seed 5: 3 s")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nobody"], "nobody"),
        (["robby", "--for", "0"], "'0' is not a time in seconds above 0"),
        (["robby", "--for", "soon"], "'soon' is not a time in seconds above 0"),
        (["robby", "--seed", "red"], "'red' is not a seed"),
        (["robby", "--speed", "0"], "'0' is not a speed"),
        (["robby", "--faults", "silnt"], "did you mean 'silent'?"),
        (["robby", "--faults", ""], "--faults '': a name is empty"),
        (["robby", "--faults", "silent,"], "--faults 'silent,': a name is empty"),
        (["robby", "--can", "vcan0"], "omit the option"),
        (["robby", "--record", "/proc/x/y.zip"], "/proc/x does not exist or is not writable"),
        (["robby", "--ros-args", "-p"], "--ros-args requires the ROS bridge; add --ros"),
        (["--world", "hall.yml", "--serve"], "--serve needs a ROBOT"),
        (["robby", "--world", "hall.yml"], "--world requires physics; add --physics"),
        (["robby", "--physics", "--world", "none.sdf"], "none.sdf: cannot be read: No such file or directory"),
        (["robby", "--scenario", "/nowhere.yml"], "/nowhere.yml"),
        (["robby", "--scenario", "x.yml", "--faults", "all"], "give only one of them"),
        (["robby", "--seeds", "0"], "'0' is not a number of seeds"),
        (["robby", "--seeds", "2", "--jobs", "0"], "'0' is not a number of processes"),
        (["robby", "--jobs", "2"], "--jobs requires a campaign"),
        (["robby", "--out", "x"], "--out requires a campaign"),
        (["robby", "--seeds", "2", "--scenario", "x.yml"], "--scenario is for a single simulation"),
        (["robby", "--seeds", "2", "--speed", "1"], "--speed is for a single simulation"),
        (["robby", "--seeds", "2", "--serve"], "--serve is for a single simulation"),
        (["robby", "--seeds", "2", "--out", "/proc/x"], "/proc/x cannot be written"),
        (["robby", "--seeds", "2", "--out", __file__], "test_simulate.py cannot be written: File exists"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(capsys, words, text):
    try:
        code, _, err = simulate(capsys, *words)
    except SystemExit as end:
        code, err = end.code, capsys.readouterr().err
    assert code == 2
    assert text in err
    assert "Traceback" not in err


@pytest.mark.process
def test_a_campaign_runs_many_seeds(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, _ = simulate(capsys, "robby", "--seeds", "2", "--for", "1s", "--json")
    result = json.loads(out)
    assert code == 0
    assert (result["seeds"], result["robot_s"], result["breaches"]) == (2, 2.0, [])
    assert list(tmp_path.iterdir()) == []


@pytest.mark.rest
def test_what_is_served_draws_nothing_and_keeps_the_pace_of_real_time(capsys, monkeypatch):
    waits = []
    monkeypatch.setattr(ServedSimulation, "wait", lambda _self, seconds: waits.append(seconds))
    monkeypatch.setattr(SimulationRun, "real_s", 0.0)  # a computer that needs no time
    code, out, _ = simulate(capsys, "robby", "--serve", "--for", "1s", "--as", "served")
    assert code == 0
    assert "served runs" in out
    assert "no command for" not in out
    assert waits == pytest.approx([0.005 * number for number in range(1, 201)])
    waits.clear()
    simulate(capsys, "robby", "--serve", "--for", "1s", "--speed", "max", "--seed", "3")
    assert set(waits) == {0.0}


def test_ctrl_c_ends_a_simulation_and_keeps_what_there_is(capsys, monkeypatch, tmp_path):
    rounds = itertools.count()

    def interrupted(_self, _seconds):
        if next(rounds) > 20:
            raise KeyboardInterrupt

    monkeypatch.setattr(ServedSimulation, "wait", interrupted)
    path = tmp_path / "kept.zip"
    code, out, _ = simulate(capsys, "robby", "--serve", "--for", "1h", "--json", "--record", str(path))
    assert code == 0
    assert json.loads(out)["robot_s"] == pytest.approx(0.11)
    assert path.stat().st_size > 1000


def test_a_robot_that_never_runs_is_exit_1_and_a_sentence(capsys, tmp_path):
    path = tmp_path / "silent.yml"
    path.write_text("for: 1s\nsteps:\n  - {at: 0s, node: 3, fault: silent}\n")
    code, _, err = simulate(capsys, "robby", "--scenario", str(path))
    assert code == 1
    assert "robby did not reach the state RUNNING within 1 s" in err


def test_seeds_of_a_robot_that_never_runs_are_one_sentence(capsys, tmp_path):
    refused = "node_id: 3\n    sdo: [{index: 0x605A, sub_index: 0, value: 99}]"  # no option of the quick stop
    folder = copy_robby(tmp_path, bus={"node_id: 3": refused})
    code, out, err = simulate(capsys, str(folder), "--seeds", "3", "--for", "2s")
    assert (code, out) == (1, "")
    assert err.count("robby did not reach the state RUNNING within 5.1 s: node 3 (left_drive): boot error J") == 1
    assert "0x605A:00" in err


def test_all_drives_behave_as_those_of_a_manufacturer(capsys):
    assert main(["simulate", "robby", "--for", "1", "--like", "copley", "--quirk", "own_bits_change", "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)["sha256"]
    assert main(["simulate", "robby", "--for", "1", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sha256"] != plain


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--like", "coply"], "no personality 'coply' (did you mean 'copley'?)"),
        (["--like", "delta"], "Delta ASDA-A2 has 0x1006, which the EDS of node 3 (TMCM-1270) lacks"),
        (["--quirk", "sdo_lat"], "no quirk 'sdo_lat' (did you mean 'sdo_late'?)"),
        (["--like", "copley", "--seeds", "2"], "--like is for a single simulation"),
    ],
)
def test_what_drives_cannot_behave_like_is_one_sentence(capsys, words, sentence):
    assert main(["simulate", "robby", "--for", "1", *words]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert len(error.splitlines()) == 1


_STILL = {
    "linear.x.max_velocity: 1.0 ": "linear.x.max_velocity: 0.0 ",
    "linear.x.min_velocity: -1.0": "linear.x.min_velocity: 0.0",
    "angular.z.max_velocity: 1.0": "angular.z.max_velocity: 0.0",
    "angular.z.min_velocity: -1.0": "angular.z.min_velocity: 0.0",
}


def test_a_base_whose_limits_permit_no_motion_is_exit_1_and_a_sentence(capsys, tmp_path):
    words = [str(copy_robby(tmp_path, controllers=_STILL)), "--controller", "robby_base_controller"]
    assert main(["simulate", *words, "--for", "5", "--json"]) == 1
    assert capsys.readouterr().err.splitlines()[-1] == (
        "canopen-control: robby_base_controller moved nothing: linear.x.max_velocity and angular.z.max_velocity of "
        "robby_base_controller are 0, so the base does not move"
    )
