"""tools/run_tests.py: tests of each run, parallel lanes, second runs, and no process left behind."""

import ctypes
import itertools
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import run_tests
from _pytest.mark.expression import Expression
from run_tests import Part, Run
from support.host import eventually

ROOT = Path(__file__).parents[2]
SH = "/bin/sh"


def part(name, script, **more):
    return Part(name, (SH, "-c", script), **more)


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    yield Run()
    # Else this process would adopt what the programs of later tests leave to init.
    ctypes.CDLL(None).prctl(run_tests._PR_SET_CHILD_SUBREAPER, 0, 0, 0, 0)


@pytest.fixture
def in_checkout(monkeypatch):
    monkeypatch.chdir(ROOT)


# ---------------------------------------------------------------------------------- which tests belong to which run

KINDS = ("process", "rest", "alone", "timed", "browser", "sources")


def selected(parts, marks):
    """Return the names of the uncompiled parts that select a test with these marks."""
    return [
        item.name
        for item in parts
        if "pytest" in item.command
        and "PYTHONPATH" not in item.environment
        and Expression.compile(item.command[item.command.index("-m", 4) + 1]).evaluate(lambda name, **_: name in marks)
    ]


def possible(marks):
    return "rest" in marks or not {"alone", "timed"} & marks  # tests/conftest.py adds the mark `rest`


def test_every_test_belongs_to_one_part_of_one_run(in_checkout, monkeypatch):
    monkeypatch.delenv("CANOPEN_CONTROL_LOOP_S", raising=False)
    default = [item for lane in run_tests.default_lanes() for item in lane]
    rest = [item for lanes in run_tests.rest_steps() for lane in lanes for item in lane]
    for marks in (set(combination) for n in range(len(KINDS) + 1) for combination in itertools.combinations(KINDS, n)):
        if possible(marks):
            by_default, by_rest = set(selected(default, marks)), selected(rest, marks)
            by_default.discard("tests without a process, 2 of 2")  # the other half of the same tests
            assert (len(by_default), len(by_rest)) == ((0, 1) if "rest" in marks else (1, 0)), marks


def test_both_halves_together_are_all_tests(in_checkout):
    one, two = run_tests.halves()
    assert not set(one) & set(two)
    assert sorted(one + two) == sorted(
        str(path)
        for path in Path("tests").iterdir()
        if (path.is_dir() and any(path.rglob("test_*.py"))) or path.match("test_*.py")
        if path.name not in ("bench", "hardware_can", "integration", "socketcan", "tools")
    )


def test_files_of_the_rest_are_found_by_their_mark_their_kind_their_folder_or_the_table(in_checkout):
    files = run_tests.rest_files()
    for path in ("bus/test_hub.py", "integration/test_run.py", "bench/test_against.py", "simulation/test_cluster.py"):
        assert f"tests/{path}" in files
    assert "tests/cia301/test_pdo.py" not in files
    assert all(Path(path).exists() for path in files)
    assert files == sorted(set(files))


def test_every_file_of_a_part_exists(in_checkout):
    parts = [item for lanes in run_tests.rest_steps() for lane in lanes for item in lane]
    named = [word for item in parts for word in item.command if word.startswith("tests/")]
    assert named
    assert [path for path in named if not Path(path).exists()] == []


def test_the_rest_begins_with_the_robots_that_leave_most_to_the_compiler_and_ends_with_those_it_makes(in_checkout):
    *computing, waiting = run_tests.rest_steps()[0]
    assert [item.name for item in waiting] == ["timed tests", "long tests with processes", "compiled, whole robots"]
    assert {item.nice for lane in computing for item in lane} == {run_tests._LEAVING_ALL}
    assert {item.nice for item in waiting} == {0}
    workers = {item.name: item.command[item.command.index("-n") + 1] for item in waiting}
    assert workers == {"timed tests": "2", "long tests with processes": "3", "compiled, whole robots": "2"}


# ------------------------------------------------------------------------------------------------- running parts


def test_a_part_that_fails_fails_the_run_and_the_others_continue(run, capsys):
    run.lanes([[part("bad", "echo words of it; exit 3"), part("good", "true")]])
    assert not run.good
    assert "== bad: " in (text := capsys.readouterr().out)
    assert "FAILED (exit code 3)\nwords of it" in text
    assert "== failed: bad" in run.summary()
    assert len(run.results) == 2


@pytest.mark.parametrize(("script", "code"), [("sleep 0.1; touch made", 0), ("exit 1", 1)])
def test_a_part_waits_for_the_part_of_another_lane_that_it_needs(run, script, code):
    run.lanes([[part("first", script)], [part("second", "test -e made", needs="first")]])
    assert [(result.part.name, result.code) for result in run.results] == [("first", code), ("second", code)]


def test_a_part_that_the_end_of_an_interrupted_run_has_reaped_ends_its_lane(run, monkeypatch):
    def reaped(pid, _options):
        os.waitpid(pid, 0)
        run.interrupted = True
        return wait4(pid, 0)

    wait4 = os.wait4
    monkeypatch.setattr(os, "wait4", reaped)
    run.lanes([[part("gone", "true"), part("never", "true")]])
    assert run.results == []
    assert not run.good


def pytest_on(path, text):
    path.write_text(text)
    return Part(
        "tests of it",
        (sys.executable, "-m", "pytest", "-q", "-o", "cache_dir=.pytest_cache/tests_of_it",
         "-c", os.devnull, str(path)),
        {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )  # fmt: skip


def test_a_test_that_passes_on_the_second_run_is_listed(run):
    once = pytest_on(
        run_path := Path("test_once.py"),
        "from pathlib import Path\n"
        "def test_first_time():\n    seen = Path('seen').exists()\n    Path('seen').touch()\n    assert seen\n"
        "def test_good():\n    pass\n",
    )
    run.lanes([[replace(once, second_look=(*once.command, "--last-failed"))]])
    assert not run.good
    run.second_looks()
    assert run.good, run.summary()
    assert "== failed at first and passed at the second look: 1\n   test_once.py::test_first_time" in run.summary()
    assert run_path.exists()


PROGRAM = """
import sys
from pathlib import Path
import run_tests
from run_tests import Part
SLOW = '''
import signal, subprocess
from pathlib import Path
child = subprocess.Popen(["setsid", "sleep", "600"])
Path("child").write_text(str(child.pid))
signal.pause()
'''
run_tests.default_lanes = lambda **how: [[Part("slow", (sys.executable, "-S", "-c", SLOW))]]
sys.exit(run_tests.main([]))
"""


def test_a_failure_of_the_default_run_is_final(in_checkout):
    assert not [part.name for lane in run_tests.default_lanes() for part in lane if part.second_look is not None]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_ends_every_child(tmp_path, number):
    run = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT / "tools"),
            "CANOPEN_CONTROL_REQUIRE": "",  # a run that requires nothing installs no Debian packages
        },
        stdout=subprocess.PIPE,
        text=True,
    )
    child = tmp_path / "child"
    assert eventually(lambda: child.exists() and child.read_text().strip())
    pid = int(child.read_text())
    run.send_signal(number)
    message, _ = run.communicate(timeout=60)
    assert run.returncode == run_tests.INTERRUPTED
    assert "interrupted; every process of this run has ended" in message
    assert not Path(f"/proc/{pid}").exists()


# --------------------------------------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["nonsense"], "there are no tests of 'nonsense'; subpackages with tests: bench bus"),
        (["--nonsense"], "there is no option --nonsense; `./tools/test --help` shows what there is"),
        (["--rest", "cia402"], "--rest takes no further words"),
        (["--coverage", "nonsense"], "there are no tests of 'nonsense'"),
    ],
)
def test_arguments_that_name_nothing_are_refused(in_checkout, words, text, capsys):
    assert run_tests.main(words) == run_tests.USAGE
    assert text in capsys.readouterr().err
