"""Comparison of this checkout with another commit, in a separate repository."""

import json
import subprocess

import pytest
from canopen_control_bench import against
from canopen_control_bench.against import main

RUNNER = "FAMILIES = {'cycle': '', 'old': ''}\nGROUPS = {'all': ()}\n"


def git(folder, *words):
    config = ("-c", "user.name=a", "-c", "user.email=a@b")
    return subprocess.run(["git", "-C", folder, *config, *words], check=True, capture_output=True, text=True).stdout


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Return a repository of two commits; `measured` has who was measured, in order."""
    root = tmp_path / "repository"
    (root / "tools" / "canopen_control_bench").mkdir(parents=True)
    (root / "tools" / "canopen_control_bench" / "__init__.py").write_text("")
    (root / "tools" / "canopen_control_bench" / "runner.py").write_text(RUNNER)
    (root / "canopen_control").mkdir()
    (root / "canopen_control" / "a.py").write_text("a = 1\n")
    git(root, "init", "-q")
    for text in ("a = 1\n", "a = 2\n"):
        (root / "canopen_control" / "a.py").write_text(text)
        git(root, "add", ".")
        git(root, "commit", "-q", "-m", text)
    monkeypatch.setattr(against, "_ROOT", root)
    return root


def figure(ours, name="time", peer="", direction="at most"):
    return {"name": name, "peer_name": peer, "unit": "us", "direction": direction, "ours": ours}


@pytest.fixture
def measured(monkeypatch):
    """Have the bench of each side tell that this checkout takes a tenth less; return who was measured."""
    order = []

    def measure(side, words, _report):
        order.append((side.name.startswith("this"), tuple(words)))
        slow = 100.0 + len(order)
        return {("cycle", "time", ""): figure(0.9 * slow if order[-1][0] else slow)}

    monkeypatch.setattr(against, "_measured", measure)
    return order


def test_both_are_measured_in_pairs_that_begin_with_one_and_the_other_in_turn(repository, measured, tmp_path, capsys):
    report = tmp_path / "ratios.json"
    assert main(["HEAD~1", "cycle", "--quick", "--json", str(report)]) == 0
    assert [here for here, _ in measured] == [True, False, False, True] * 3 + [True, False]
    assert {words for _, words in measured} == {("cycle", "--quick")}
    output = capsys.readouterr().out
    assert "7 alternating pairs, pure" in output
    assert output.splitlines()[-1].endswith("better")
    result = json.loads(report.read_text())
    assert result["figures"][0]["median"] == pytest.approx(0.9, abs=0.02)
    assert len(result["figures"][0]["ratios"]) == 7
    assert result["there"] == git(repository, "rev-parse", "HEAD~1").strip()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nothing", "cycle"], "no commit 'nothing' in"),
        (["--", "--all", "cycle"], "no commit '--all' in"),
        (["HEAD", "cicle"], "no family 'cicle'; available: cycle"),
        (["HEAD", "scale"], "has no family 'scale'; it has: all, cycle, old"),
        (["HEAD", "cycle", "--pairs", "3"], "at least 7 pairs are needed"),
        (["HEAD", "cycle", "--json", "/none/there.json"], "there is no folder /none"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence_and_exit_code_2(repository, measured, words, message, capsys):
    assert main(words) == 2
    text = capsys.readouterr().err
    assert text.startswith("tools/bench against: ")
    assert message in text
    assert text.count("\n") == 1
    assert measured == []


def test_a_side_is_measured_by_its_own_bench(tmp_path):
    package = tmp_path / "canopen_control"
    package.mkdir()
    (package / "__init__.py").write_text("")
    report = {"figures": {"cycle": [figure(2.0)]}, "failures": {}}
    main_text = "import json, sys; open(sys.argv[sys.argv.index('--json') + 1], 'w').write(json.dumps({}))"
    (package / "__main__.py").write_text(main_text.format(report))
    side = against.Side("there", str(tmp_path))
    result = against._measured(side, ["cycle"], tmp_path / "report.json")
    assert result == {("cycle", "time", ""): figure(2.0)}
    (package / "__main__.py").write_text(main_text.format({**report, "failures": {"cycle": "no bus"}}))
    with pytest.raises(against.Unmeasured, match="there: cycle: no bus"):
        against._measured(side, ["cycle"], tmp_path / "report.json")
    (package / "__main__.py").write_text("raise SystemExit('it broke')")
    with pytest.raises(against.Unmeasured, match="there: the bench ended with 1: it broke"):
        against._measured(side, ["cycle"], tmp_path / "report.json")


def test_a_figure_per_second_of_cpu_is_compared_by_its_ratio():
    sides = [{**figure(4.0, "robby", "CPU", "at least"), "unit": "s", "ratio": ratio} for ratio in (300.0, 200.0)]
    pairs = [({("simulate", "robby", "CPU"): sides[0]}, {("simulate", "robby", "CPU"): sides[1]})] * 7
    (result,), alone = against.ratios(pairs)
    assert (result.ours, result.theirs, result.median, result.verdict) == (300.0, 200.0, 1.5, "better")
    assert result.unit == "s/s CPU"
    assert alone == []
