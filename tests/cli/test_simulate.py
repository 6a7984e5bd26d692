import json

import pytest

from canopen_control.cli.main import main


def simulate(capsys, *words):
    code = main(["simulate", *words])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_json_ends_with_one_object(capsys):
    code, out, _ = simulate(capsys, "robby", "--for", "2s", "--seed", "3", "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["seed"], found["robot_s"], found["breaches"]) == (3, 2.0, [])
    assert len(found["sha256"]) == 64
    assert found["frames"] > 100


def test_events_are_told_with_their_time_and_then_what_came_of_it(capsys):
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
    ("words", "said"),
    [
        (["nobody"], "nobody"),
        (["robby", "--for", "0"], "'0' is no time above 0"),
        (["robby", "--for", "soon"], "'soon' is no time above 0"),
        (["robby", "--seed", "red"], "'red' is no seed"),
        (["robby", "--speed", "0"], "'0' is no speed"),
        (["robby", "--faults", "silnt"], "did you mean 'silent'?"),
        (["robby", "--can", "vcan0"], "leave the option away"),
        (["robby", "--scenario", "/nowhere.yml"], "/nowhere.yml"),
        (["robby", "--scenario", "x.yml", "--faults", "all"], "give one of both"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(capsys, words, said):
    try:
        code, _, err = simulate(capsys, *words)
    except SystemExit as end:
        code, err = end.code, capsys.readouterr().err
    assert code == 2
    assert said in err
    assert "Traceback" not in err
