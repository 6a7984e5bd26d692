"""What the campaign watches beside the bus: memory, output, and who is left."""

import sys
import time

import pytest
from campaigner.health import GROWTH_MB, LINES_PER_MINUTE, WARM_UP_S, Logs, Memory, watch_orphans
from campaigner.processes import MARK, Program, Run, marked, resident_mb


def test_memory_that_grows_after_the_warm_up_is_a_breach_once():
    memory = Memory()
    assert memory.look(WARM_UP_S - 1, 500.0, 0.0) is None
    assert memory.look(WARM_UP_S + 1, 30.0, 1.0) is None
    assert memory.look(WARM_UP_S + 2, 30.0 + GROWTH_MB, 2.0) is None
    assert memory.look(WARM_UP_S + 3, None, 3.0) is None
    breach = memory.look(WARM_UP_S + 4, 30.1 + GROWTH_MB, 4.0)
    assert breach is not None
    assert (breach.time, breach.rule) == (4.0, "memory")
    assert memory.look(WARM_UP_S + 5, 90.0, 5.0) is None
    assert memory.growth == 60.0
    assert Memory().growth == 0.0


@pytest.mark.parametrize(
    "words", ["Traceback (most recent call last):\n  File", "canopen-control: a fault of this program, X"]
)
def test_a_traceback_is_told_once_with_the_file(tmp_path, words):
    path, logs = tmp_path / "run.out", Logs()
    path.write_text("all is well\n")
    assert logs.look([path], 0.0) == []
    with path.open("a") as file:
        file.write(f"{words}\n")
    (breach,) = logs.look([path], 1.0)
    assert breach.rule == "traceback"
    assert breach.text.startswith("run.out: ")
    assert logs.look([path], 2.0) == []


def test_a_flood_of_lines_is_told_once_and_the_same_in_an_hour_is_none(tmp_path):
    slow, fast = tmp_path / "slow.log", tmp_path / "fast.log"
    logs, found = Logs(), []
    for minute in range(6):
        for path, lines in ((slow, LINES_PER_MINUTE // 2), (fast, LINES_PER_MINUTE)):
            with path.open("a") as file:
                file.write("a line\n" * lines)
        found += logs.look([slow, fast], minute * 50.0)
    assert [(each.rule, each.text.split(":")[0]) for each in found] == [("output", "fast.log")]


def test_a_file_that_was_begun_anew_is_read_from_its_beginning(tmp_path):
    path, logs = tmp_path / "flight.log", Logs()
    path.write_text("a line\n" * 100)
    logs.look([path], 0.0)
    path.write_text("Traceback (most recent call last)\n")
    assert [each.rule for each in logs.look([path], 1.0)] == ["traceback"]


def test_a_file_that_is_not_there_is_nothing(tmp_path):
    assert Logs().look([tmp_path / "none"], 0.0) == []


def test_a_program_is_found_by_its_mark_until_it_has_ended(tmp_path):
    program = Program(tmp_path, "status", ["drive", "--help"], "a-mark")
    assert program.wait_for(lambda text: "--node-id" in text, 20.0)
    assert program.wait(20.0) == 0
    assert marked("a-mark") == {}
    assert marked("") == {}
    assert not program.wait_for(lambda text: not text, 0.1)


def test_who_is_left_of_a_killed_run_is_told(tmp_path, monkeypatch):
    import subprocess

    from campaigner import health

    monkeypatch.setattr(health, "GONE_S", 0.2)
    run = Run(tmp_path, "run", ["run", "--help"], "orphaned")
    run.wait(20.0)
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], env={MARK: "orphaned"})
    try:
        while not run.survivors():
            time.sleep(0.01)
        while resident_mb(child.pid) < 1.0:  # it is there before its Python is
            time.sleep(0.01)
        breaches = []
        watch_orphans(run, breaches.append).join(10.0)
        (breach,) = breaches
        assert breach.rule == "orphan"
        assert f"(pid {child.pid})" in breach.text
    finally:
        child.kill()
        child.wait()
    assert resident_mb(child.pid) is None
    watch_orphans(run, breaches.append).join(10.0)
    assert len(breaches) == 1
