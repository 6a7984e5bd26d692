"""The machine: CPU of processes, idleness, description."""

import os
import re
import subprocess
import sys
import time

import pytest
from canopen_control_bench import machine
from canopen_control_bench.machine import apart, cpu_ns, describe, idle_part, may_be_realtime, resident_bytes, wakeups

from canopen_control.version import build


def test_cpu_of_a_process_is_what_the_process_itself_reads():
    before = time.process_time_ns()
    seen = cpu_ns(os.getpid())
    assert before <= seen <= time.process_time_ns()


@pytest.mark.process
def test_cpu_of_nobody_is_none():
    pid = os.fork()
    if pid == 0:
        os._exit(0)
    os.waitpid(pid, 0)
    assert cpu_ns(pid) == 0


def test_what_this_process_takes_is_resident_by_its_id_too():
    before = resident_bytes()
    taken = bytearray(b"x" * 50_000_000)
    assert before + 40_000_000 < resident_bytes() == pytest.approx(resident_bytes(os.getpid()), abs=1_000_000)
    assert len(taken) == 50_000_000


def test_the_idle_part_is_a_part():
    part = idle_part(0.02)
    assert part is None or 0.0 <= part <= 1.0


@pytest.mark.process
def test_trying_realtime_changes_nothing_here():
    before = os.sched_getscheduler(0)
    assert may_be_realtime() in (True, False)
    assert os.sched_getscheduler(0) == before


@pytest.mark.process
def test_the_description_names_date_kernel_and_load():
    found = describe()
    assert {"date", "machine", "kernel", "python", "package", "load", "idle"} <= set(found)
    assert found["package"] == build()
    assert found["commit"] is None or re.fullmatch("[0-9a-f]{12}", found["commit"])
    assert str(found["kernel"]).startswith(os.uname().sysname)


@pytest.mark.process
@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="processors are chosen on Linux")
def test_who_is_measured_has_a_processor_for_itself_until_the_end():
    everywhere = os.sched_getaffinity(0)
    mine, wire = (subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) for _ in range(2))
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    try:
        with apart(mine.pid, [wire.pid, gone.pid]):
            own, rest = os.sched_getaffinity(mine.pid), os.sched_getaffinity(wire.pid)
            assert os.sched_getaffinity(0) == rest
        assert (own | rest, bool(own & rest)) == (everywhere, len(everywhere) == 1)
        assert len(own) == 1
        for pid in (0, mine.pid, wire.pid):
            assert os.sched_getaffinity(pid) == everywhere
    finally:
        mine.communicate(b"\n")
        wire.communicate(b"\n")


def test_this_process_may_be_the_one_that_is_measured():
    everywhere = os.sched_getaffinity(0)
    with apart(os.getpid(), []):
        assert len(os.sched_getaffinity(0)) == 1
    assert os.sched_getaffinity(0) == everywhere


def test_who_waits_and_is_woken_is_counted():
    before = wakeups(os.getpid())
    for _ in range(3):
        time.sleep(0.001)
    assert before + 3 <= wakeups(os.getpid()) < before + 100
    assert wakeups(2**22 + 1) == 0


@pytest.mark.process
def test_a_package_that_is_installed_elsewhere_has_no_commit(tmp_path, monkeypatch):
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    monkeypatch.setattr(machine.canopen_control, "__file__", str(tmp_path / "__init__.py"))
    assert describe()["commit"] is None
