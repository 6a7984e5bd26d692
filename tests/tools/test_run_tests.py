"""tools/run_tests.py: which tests belong to which run, lanes side by side, second looks, and no process left behind."""

import ctypes
import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
import run_tests
from _pytest.mark.expression import Expression
from run_tests import Part, Run, UsageError

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
        each.name
        for each in parts
        if "pytest" in each.command
        and "PYTHONPATH" not in each.environment
        and Expression.compile(each.command[each.command.index("-m", 4) + 1]).evaluate(lambda name, **_: name in marks)
    ]


def possible(marks):
    return "rest" in marks or not {"alone", "timed"} & marks  # tests/conftest.py adds the mark `rest`


def test_every_test_belongs_to_one_part_of_one_run(in_checkout, monkeypatch):
    monkeypatch.delenv("CANOPEN_CONTROL_LOOP_S", raising=False)
    default = [each for lane in run_tests.default_lanes() for each in lane]
    rest = [each for lanes in run_tests.rest_steps() for lane in lanes for each in lane]
    for marks in (set(each) for n in range(len(KINDS) + 1) for each in itertools.combinations(KINDS, n)):
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


def test_files_of_tests_with_processes_are_found_by_their_mark_or_their_folder(in_checkout):
    files = run_tests.files_with(*run_tests.PROCESS_MARKS)
    assert "tests/integration/test_run.py" in files
    assert "tests/host/test_spawn.py" in files
    assert "tests/cia402/test_drive.py" not in files


def test_files_of_the_rest_are_found_by_their_mark_their_kind_their_folder_or_the_table(in_checkout):
    files = run_tests.rest_files()
    for path in ("bus/test_hub.py", "integration/test_run.py", "bench/test_against.py", "simulation/test_cluster.py"):
        assert f"tests/{path}" in files
    assert "tests/cia301/test_pdo.py" not in files
    assert all(Path(path).exists() for path in files)
    assert files == sorted(set(files))


@pytest.mark.parametrize(("seconds", "part_name"), [("", "timed tests"), ("60", "loops of ROS programs")])
def test_long_loops_of_ros_programs_are_a_part_of_their_own(in_checkout, monkeypatch, seconds, part_name):
    monkeypatch.setenv("CANOPEN_CONTROL_LOOP_S", seconds)
    parts = [each for lanes in run_tests.rest_steps() for lane in lanes for each in lane]
    with_loops = [each.name for each in parts if run_tests.ROS_LOOPS in each.command]
    assert [name for name in with_loops if not name.startswith("long tests")] == [
        part_name
    ]  # those take no `timed` one


def test_every_file_of_a_part_exists(in_checkout):
    parts = [each for lanes in run_tests.rest_steps() for lane in lanes for each in lane]
    named = [word for each in parts for word in each.command if word.startswith("tests/")]
    assert named
    assert [path for path in named if not Path(path).exists()] == []


def test_the_compiled_package_is_tested_by_the_tests_of_its_compiled_modules(in_checkout):
    files = run_tests.files_of_compiled_modules()
    assert "tests/cia301/test_pdo.py" in files
    assert "tests/cia301/test_sdo_properties.py" in files
    assert "tests/cli/test_sdo.py" not in files


# ------------------------------------------------------------------------------------------------- running parts


def test_lanes_run_side_by_side_and_a_lane_in_its_order(run):
    wait = "for _ in $(seq 200); do [ -e {0} ] && exit; sleep 0.05; done; exit 1"
    run.lanes([[part("one", "touch a; " + wait.format("b"))], [part("two", wait.format("a")), part("next", "touch b")]])
    assert run.good, run.summary()
    names = [each.part.name for each in run.results]
    assert names.index("two") < names.index("next")


def test_a_part_that_fails_fails_the_run_and_the_others_go_on(run, capsys):
    run.lanes([[part("bad", "echo words of it; exit 3"), part("good", "true")]])
    assert not run.good
    assert "== bad: " in (said := capsys.readouterr().out)
    assert "FAILED (exit code 3)\nwords of it" in said
    assert "== failed: bad" in run.summary()
    assert len(run.results) == 2


def pytest_on(path, text):
    path.write_text(text)
    return Part(
        "tests of it",
        (sys.executable, "-m", "pytest", "-q", "-o", "cache_dir=.pytest_cache/tests_of_it",
         "-c", os.devnull, str(path)),
        {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"},
    )  # fmt: skip


def test_a_test_that_passes_at_the_second_look_is_listed(run):
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


def test_a_test_that_fails_again_and_one_that_cannot_be_collected_fail_the_run(run):
    bad = pytest_on(Path("test_bad.py"), "def test_it():\n    assert False\n")
    run.lanes([[replace(bad, second_look=(*bad.command, "--last-failed"))]])
    run.second_looks()
    assert not run.good
    assert run.hidden == []


def test_what_needs_a_part_that_failed_is_not_run_and_fails(run, capsys):
    run.lanes([[part("compile", "exit 1"), part("compiled tests", "touch ran", needs="compile"), part("sources", ":")]])
    assert "not run: 'compile' has failed" in capsys.readouterr().out
    assert not Path("ran").exists()
    assert "== failed: compile, compiled tests" in run.summary()
    run.lanes([[part("compiled tests", "touch ran", needs="another")]])
    assert Path("ran").exists()


def test_a_failure_without_second_look_is_final(run):
    run.lanes([[pytest_on(Path("test_bad.py"), "def test_it():\n    assert False\n")]])
    run.second_looks()
    assert not run.good


def test_processes_that_parts_leave_behind_are_adopted_and_reaped(run):
    before = run_tests._descendants()  # of tests before this one
    run.lanes([[part("leaves one", "setsid sleep 0.1 & exit 0"), part("waits", "sleep 0.5")]])
    assert run_tests._descendants() == before


@pytest.mark.parametrize(("required", "good"), [("", True), ("ros", True), ("ros,socketcan", False), ("all", False)])
def test_a_guest_that_a_machine_lacks_fails_only_where_it_is_required(run, monkeypatch, required, good):
    monkeypatch.setenv("CANOPEN_CONTROL_REQUIRE", required)
    run.lanes([[part("guest", "exit 2", environment={"CANOPEN_CONTROL_GUEST_KIND": "socketcan"})]])
    assert run.good is good


PROGRAM = """
import sys
from pathlib import Path
import run_tests
from run_tests import Part
SLOW = "setsid sleep 600 & echo $! > child; sleep 600"
run_tests.default_lanes = lambda **how: [[Part("slow", ("/bin/sh", "-c", SLOW))]]
sys.exit(run_tests.main([]))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_ends_every_child(tmp_path, number):
    run = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
        cwd=tmp_path,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT / "tools"),
            "CANOPEN_CONTROL_REQUIRE": "",  # a run that requires nothing installs no Debian packages
            "CANOPEN_CONTROL_SECOND_LOOK": "",
        },
        stdout=subprocess.PIPE,
        text=True,
    )
    child = tmp_path / "child"
    deadline = time.monotonic() + 30
    while not (child.exists() and child.read_text().strip()) and time.monotonic() < deadline:
        time.sleep(0.05)
    pid = int(child.read_text())
    run.send_signal(number)
    said, _ = run.communicate(timeout=60)
    assert run.returncode == run_tests.INTERRUPTED
    assert "interrupted; every process of this run has ended" in said
    assert not Path(f"/proc/{pid}").exists()


# --------------------------------------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nonsense"], "there are no tests of 'nonsense'; subpackages with tests: bench bus"),
        (["--nonsense"], "there is no option --nonsense; `./tools/test --help` shows what there is"),
        (["--rest", "cia402"], "--rest takes no further words"),
        (["--coverage", "nonsense"], "there are no tests of 'nonsense'"),
    ],
)
def test_arguments_that_name_nothing_are_refused(in_checkout, words, said, capsys):
    assert run_tests.main(words) == run_tests.USAGE
    assert said in capsys.readouterr().err


def test_words_name_folders_modules_and_files(in_checkout):
    assert run_tests.paths_of(["cia402", "cli/sdo", "tests/test_errors.py"]) == [
        "tests/cia402",
        "tests/cli/test_sdo.py",
        "tests/test_errors.py",
    ]
    with pytest.raises(UsageError):
        run_tests.paths_of(["cia402", "cli/nothing"])


def test_words_from_the_first_option_on_are_pytests():
    assert run_tests.split(["cia402", "-k", "word", "-x"]) == (["cia402"], ["-k", "word", "-x"])


def test_coverage_of_subpackages_names_them_to_the_table(in_checkout):
    parts = run_tests.coverage_parts(["cia402"])
    assert parts[-1].command[-2:] == ("build/coverage.json", "cia402")
    assert "tests/cia402" in parts[0].command
    assert any("not rest" in word for word in run_tests.coverage_parts([])[0].command)


def test_folders_that_cannot_be_written_are_refused_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / ".mypy_cache").mkdir()
    monkeypatch.setattr(run_tests.os, "access", lambda path, mode: path != ".mypy_cache")
    with pytest.raises(UsageError, match=r"\.mypy_cache is read-only for this user; run the tests in a clone"):
        run_tests.refuse_unwritable_folders()


def test_what_failed_is_read_from_pytests_cache(run, tmp_path):
    one = Part("a part", ("true",))
    assert run_tests._failed_tests(one) == ()
    cache = one.cache / "v" / "cache"
    cache.mkdir(parents=True)
    (cache / "lastfailed").write_text(json.dumps({"tests/a.py::test_b": True}))
    assert run_tests._failed_tests(one) == ("tests/a.py::test_b",)
