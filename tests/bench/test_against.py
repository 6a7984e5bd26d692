"""This checkout against another commit: a repository of its own, whose bench is measured at once."""

import json
import math
import subprocess

import pytest
from canopen_control_bench import against
from canopen_control_bench.against import Ratio, main, ratios, table

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
    said = capsys.readouterr().out
    assert "7 alternating pairs, pure" in said
    assert said.splitlines()[-1].endswith("better")
    found = json.loads(report.read_text())
    assert found["figures"][0]["median"] == pytest.approx(0.9, abs=0.02)
    assert len(found["figures"][0]["ratios"]) == 7
    assert found["there"] == git(repository, "rev-parse", "HEAD~1").strip()


def test_the_other_commit_is_unpacked_elsewhere_and_gone_afterwards(repository, monkeypatch):
    seen = []

    def measure(side, _words, _report):
        folder = against.Path(side.path.split(":")[0])
        seen.append((folder, (folder / "canopen_control" / "a.py").read_text()))
        return {}

    monkeypatch.setattr(against, "_measured", measure)
    assert main(["HEAD~1", "cycle"]) == 0
    assert {text for _, text in seen} == {"a = 1\n", "a = 2\n"}
    assert {folder.exists() for folder, text in seen if text == "a = 1\n"} == {False}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing", "cycle"], "no commit 'nothing' in"),
        (["--", "--all", "cycle"], "no commit '--all' in"),
        (["HEAD", "cicle"], "no family 'cicle'; there are: cycle"),
        (["HEAD", "scale"], "has no family 'scale'; it has: all, cycle, old"),
        (["HEAD", "cycle", "--pairs", "3"], "fewer than 7 pairs"),
        (["HEAD", "cycle", "--json", "/none/there.json"], "there is no folder /none"),
    ],
)
def test_what_cannot_be_measured_is_one_sentence_and_exit_code_2(repository, measured, words, said, capsys):
    assert main(words) == 2
    text = capsys.readouterr().err
    assert text.startswith("tools/bench against: ")
    assert said in text
    assert text.count("\n") == 1
    assert measured == []


def test_changes_that_are_in_no_commit_are_refused(repository, measured, capsys):
    (repository / "canopen_control" / "a.py").write_text("a = 3\n")
    assert main(["HEAD", "cycle"]) == 2
    assert "canopen_control/a.py of this checkout changed since its commit" in capsys.readouterr().err
    assert measured == []


def test_a_folder_that_is_no_repository_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(against, "_ROOT", tmp_path)
    assert main(["HEAD", "cycle"]) == 2
    assert "not a git repository" in capsys.readouterr().err


def test_a_commit_without_a_bench_is_refused(repository, capsys):
    git(repository, "rm", "-r", "-q", "tools")
    git(repository, "commit", "-q", "-m", "none")
    assert main(["HEAD", "cycle"]) == 2
    assert "has no bench of its own" in capsys.readouterr().err


def test_a_family_that_fails_ends_it_with_who_and_why(repository, monkeypatch, capsys):
    def measure(side, _words, _report):
        raise against.Unmeasured(f"{side.name}: cycle: no processor")

    monkeypatch.setattr(against, "_measured", measure)
    assert main(["HEAD", "cycle"]) == 1
    assert "this checkout" in capsys.readouterr().err


def test_a_side_is_measured_by_its_own_bench(tmp_path):
    package = tmp_path / "canopen_control"
    package.mkdir()
    (package / "__init__.py").write_text("")
    report = {"figures": {"cycle": [figure(2.0)]}, "failures": {}}
    main_text = "import json, sys; open(sys.argv[sys.argv.index('--json') + 1], 'w').write(json.dumps({}))"
    (package / "__main__.py").write_text(main_text.format(report))
    side = against.Side("there", str(tmp_path))
    found = against._measured(side, ["cycle"], tmp_path / "report.json")
    assert found == {("cycle", "time", ""): figure(2.0)}
    (package / "__main__.py").write_text(main_text.format({**report, "failures": {"cycle": "no bus"}}))
    with pytest.raises(against.Unmeasured, match="there: cycle: no bus"):
        against._measured(side, ["cycle"], tmp_path / "report.json")
    (package / "__main__.py").write_text("raise SystemExit('it broke')")
    with pytest.raises(against.Unmeasured, match="there: the bench ended with 1: it broke"):
        against._measured(side, ["cycle"], tmp_path / "report.json")


def pairs_of(*values, **how):
    return [({("f", "time", ""): figure(a, **how)}, {("f", "time", ""): figure(b, **how)}) for a, b in values]


def test_a_difference_is_marked_where_the_quartiles_lie_on_one_side():
    slower = ratios(pairs_of(*[(1.2 + each / 100, 1.0) for each in range(7)]))[0][0]
    assert (slower.median, slower.verdict) == (pytest.approx(1.23), "worse")
    same = ratios(pairs_of(*[(0.97 + each / 100, 1.0) for each in range(7)]))[0][0]
    assert same.verdict == ""
    more = ratios(pairs_of(*[(2.0, 1.0)] * 7, direction="at least"))[0][0]
    assert more.verdict == "better"


def test_figures_of_one_side_are_named_and_counts_of_nothing_have_no_ratio():
    pairs = [({("f", "a", ""): figure(0.0), ("f", "b", ""): figure(1.0)}, {("f", "a", ""): figure(0.0)})] * 7
    found, alone = ratios(pairs)
    assert [each.median for each in found] == [1.0]
    assert alone == ["f: b: seen by this checkout alone"]
    found, _ = ratios(pairs_of(*[(1.0, 0.0)] * 7))
    assert math.isnan(found[0].median)
    assert table(found).splitlines()[1].split()[-3:] == ["-", "-", "-"]
    assert isinstance(found[0], Ratio)
