"""The shell scripts of tools/: who asks what one does gets the answer, and nothing is installed for it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

TOOLS = Path(__file__).parents[2] / "tools"


@pytest.mark.parametrize("script", ["demo", "test", "bench", "compile"])
def test_help_says_what_it_does_and_installs_nothing(tmp_path, script):
    copied = tmp_path / "tools"
    copied.mkdir()
    for name in (script, "environment"):
        shutil.copy(TOOLS / name, copied / name)
    done = subprocess.run([copied / script, "--help"], capture_output=True, text=True, timeout=10, check=True)
    assert len(done.stdout.splitlines()) >= 3
    assert "#" not in done.stdout
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tools"]


STUB = """root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
PYTHON=$root/python
show_help() { :; }
has_ros_wheels() { false; }
prepare() { [ "${FAIL:-}" != prepare ]; }
"""
PYTHON = """#!/usr/bin/env bash
echo "begin $*" >>log
case "$*" in *"${FAIL:-nothing}"*) code=${CODE:-1} ;; esac
case "$*" in *"--last-failed"*) code=${AGAIN:-1} ;; esac
# the two lanes wait for each other, which they could not do one after the other
case "$*" in
    *"(process and"*) other="begin .*(not process and" ;;
    *"(not process and"*) other="begin .*(process and" ;;
esac
for _ in $(seq "${LANES:-0}"); do
    grep -q "${other:-begin}" log && break
    sleep 0.05
done
echo "end $*" >>log
exit "${code:-0}"
"""


@pytest.fixture
def checkout(tmp_path):
    """Return what runs tools/test in a checkout whose python notes its arguments instead."""
    (tmp_path / "tools" / "guest").mkdir(parents=True)
    (tmp_path / "tests" / "cia402").mkdir(parents=True)
    shutil.copy(TOOLS / "test", tmp_path / "tools" / "test")
    (tmp_path / "tools" / "environment").write_text(STUB)
    programs = {
        "python": PYTHON,
        "tools/guest/run_tests": 'echo "begin $2" >>log; echo "end $2" >>log',
        "tools/compile": "pwd",
    }
    programs |= dict.fromkeys(("tools/socketcan_guest", "tools/can_hardware_guest", "chromium", "tmux"), "exit 0")
    for name, text in programs.items():
        path = tmp_path / name
        path.write_text(text if text.startswith("#!") else f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)

    def checkout(*words, fail="", again=1, code=1):
        environment = {
            **os.environ,
            "PATH": f"{tmp_path}:{os.environ['PATH']}",
            "FAIL": fail,
            "AGAIN": str(again),
            "CODE": str(code),
            "LANES": "0" if words else "200",
        }
        environment.pop("CANOPEN_CONTROL_REQUIRE", None)
        done = subprocess.run(
            [tmp_path / "tools" / "test", *words], env=environment, capture_output=True, text=True, timeout=60
        )
        log = tmp_path / "log"
        return done, log.read_text().splitlines() if log.exists() else []

    return checkout


def span(log, words):
    return log.index(next(line for line in log if line.startswith("begin") and words in line)), log.index(
        next(line for line in log if line.startswith("end") and words in line)
    )


def test_what_measures_runs_while_nothing_else_does_and_what_computes_runs_beside_what_waits(checkout):
    done, log = checkout()
    assert done.returncode == 0, done.stdout + done.stderr
    alone = span(log, "and (alone)")
    assert alone[1] == alone[0] + 1
    waiting, computing = span(log, "(process and not alone and"), span(log, "(not process and not alone)")
    assert waiting[0] < computing[1]
    assert computing[0] < waiting[1]
    for guest in ("tools/socketcan_guest", "tools/can_hardware_guest"):
        assert waiting[1] < span(log, guest)[0] < alone[0]
    for part in (
        "mypy --strict",
        "pytest, compiled, whole robots",
        "pytest, timed",
        "guests: CAN of a real kernel, CAN cards",
    ):
        assert f"\n{part} 0 min" in done.stdout.partition("== time")[2]


@pytest.mark.parametrize("what", ["prepare", "mypy", "(not process and not alone)", "and (alone)"])
def test_a_part_that_fails_in_either_lane_fails_the_whole_and_the_others_run(checkout, what):
    done, log = checkout(fail=what)
    assert done.returncode == 1
    assert " failed\n" in done.stdout
    assert bool(log) == (what != "prepare")
    if log:
        assert any("and (alone)" in line for line in log)


@pytest.mark.parametrize("part", ["(not process and not alone)", "and (alone)"])
def test_a_test_that_failed_is_run_once_more_when_nothing_else_runs_and_that_decides(checkout, part):
    done, log = checkout(fail=part, again=0)
    assert done.returncode == 0, done.stdout + done.stderr
    again = [line for line in log if "--last-failed" in line]
    first = next(line for line in log if part in line)
    assert all(
        re.search("cache_dir=([^ ]+)", line)[1] == re.search("cache_dir=([^ ]+)", first)[1] for line in again[:2]
    )
    assert log[-2:] == again[-2:]
    assert "== looked at twice: pytest" in done.stdout
    assert checkout(fail=part, again=1)[0].returncode == 1
    assert "looked at twice" not in checkout()[0].stdout


def test_tests_that_could_not_be_run_at_all_are_not_looked_at_twice(checkout):
    done, log = checkout(fail="(process and not alone and", code=4)
    assert done.returncode == 1
    assert not any("--last-failed" in line for line in log)


def test_the_fast_ones_and_rooms(checkout):
    done, log = checkout("--fast", "-x")
    assert done.returncode == 0
    assert [line for line in log if line.startswith("begin")] == [
        "begin -m pytest -q -rs -m not socketcan and not hardware and (not process and not robot and not alone) "
        "-n auto --dist worksteal -x"
    ]
    assert checkout("cia402")[1][-1].endswith("tests/cia402")
    assert checkout("nonsense")[0].returncode == 2


def test_coverage_of_a_room_says_which_room(checkout):
    done, log = checkout("--coverage", "cia402")
    assert done.returncode == 0, done.stderr
    assert log[-1] == "end tools/room_coverage.py build/coverage.json cia402"
    assert checkout("--coverage", fail="run -m pytest")[0].returncode == 1
