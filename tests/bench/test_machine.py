"""The machine: CPU of processes, idleness, description."""

import os
import time

import pytest

from canopen_control.bench.machine import cpu_ns, describe, idle_part, may_be_realtime, resident_bytes


def test_cpu_of_a_process_is_what_the_process_itself_reads():
    before = time.process_time_ns()
    seen = cpu_ns(os.getpid())
    assert before <= seen <= time.process_time_ns()


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


def test_trying_realtime_changes_nothing_here():
    before = os.sched_getscheduler(0)
    assert may_be_realtime() in (True, False)
    assert os.sched_getscheduler(0) == before


def test_the_description_names_date_kernel_and_load():
    found = describe()
    assert {"date", "machine", "kernel", "python", "package", "load", "idle"} <= set(found)
    assert found["package"] in ("sources", "compiled")
    assert str(found["kernel"]).startswith(os.uname().sysname)
