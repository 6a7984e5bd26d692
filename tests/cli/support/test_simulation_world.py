import json

import pytest

from canopen_control.cli.main import main

pytest.importorskip("mujoco")


@pytest.fixture
def hall(tmp_path):
    path = tmp_path / "hall.yml"
    path.write_text("robots: [{name: one, robot: robby}, {name: two, robot: robby, at: [1, 0]}]\n")
    return str(path)


def test_robots_of_a_world_are_reported_one_by_one(hall, capsys):
    assert main(["simulate", "--world", hall, "--for", "1"]) == 0
    output = capsys.readouterr().out
    assert "two: node 3 (left_drive): " in output
    assert "one: seed 0, " in output
    assert "two: seed 1, " in output
    assert "1 s of 2 robots in " in output


def test_as_json_it_is_one_object(hall, capsys):
    assert main(["simulate", "--world", hall, "--for", "1", "--seed", "7", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["seed"], result["robot_s"], result["breaches"]) == (7, 1.0, [])
    assert [item["seed"] for item in result["robots"].values()] == [7, 8]


@pytest.mark.parametrize(
    "words", [["--seeds", "2"], ["--record", "x.zip"], ["--jobs", "2"], ["--controller", "x"], ["--aim", "3"]]
)
def test_what_is_of_one_robot_is_refused(hall, words, capsys):
    assert main(["simulate", "--world", hall, *words]) == 2
    assert f"{words[0]} needs a ROBOT; " in capsys.readouterr().err


def test_a_world_without_robots_needs_one(tmp_path, capsys):
    path = tmp_path / "empty.yml"
    path.write_text("walls: [{from: [0, 1], to: [4, 1]}]\n")
    assert main(["simulate", "--world", str(path)]) == 2
    assert "it names no robots" in capsys.readouterr().err
    assert main(["simulate", "robby", "--world", str(path)]) == 2
    assert "add --physics" in capsys.readouterr().err
    assert main(["simulate", "robby", "--physics", "--world", str(path), "--for", "1"]) == 0
