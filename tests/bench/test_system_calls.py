"""System calls are counted as strace tells them, and nothing is where it cannot."""

import os

import pytest
from canopen_control_bench import system_calls
from canopen_control_bench.system_calls import count_calls, parse_calls

TABLE = """% time     seconds  usecs/call     calls    errors syscall
------ ----------- ----------- --------- --------- ----------------
 60.00    0.000600           3       199           epoll_wait
 40.00    0.000400           2       200         1 recvfrom
------ ----------- ----------- --------- --------- ----------------
100.00    0.001000           2       399         1 total
"""


def test_a_table_is_read_call_by_call():
    assert parse_calls(TABLE) == {"epoll_wait": 199, "recvfrom": 200}
    assert parse_calls("") == {}


def test_without_strace_nothing_is_counted(monkeypatch):
    monkeypatch.setattr(system_calls.shutil, "which", lambda _name: None)
    assert count_calls(os.getpid(), 60.0) == {}


@pytest.mark.process
def test_a_process_that_is_not_there_is_not_waited_for():
    assert count_calls(2**22 + 1, 60.0) == {}
