"""The clients bench: a program on a terminal is measured and ended; one that ends by itself says why."""

import os
import subprocess
import sys
from types import SimpleNamespace

import pytest
from canopen_control_bench.clients import on_a_terminal, p99_of, stopped
from canopen_control_bench.stage import stage

from canopen_control.errors import CanopenError

pytestmark = pytest.mark.process


def test_a_program_that_ends_on_its_terminal_is_told():
    def watch():
        with on_a_terminal("status") as pid:
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)

    with stage(), pytest.raises(CanopenError, match="no robot is running"):
        watch()


def test_a_program_on_a_terminal_is_ended():
    with stage() as played:
        played.drives("local:terminal", "2")
        with on_a_terminal("bus", "status", "local:terminal") as pid:
            assert pid > 0


def test_a_client_is_stopped_for_a_block_and_goes_on():
    client = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], start_new_session=True)
    try:
        with stopped(client.pid):
            assert os.waitid(os.P_PID, client.pid, os.WSTOPPED | os.WNOWAIT).si_code == os.CLD_STOPPED
        assert os.waitid(os.P_PID, client.pid, os.WCONTINUED).si_code == os.CLD_CONTINUED
    finally:
        client.kill()
        client.wait()


def test_blocks_are_judged_together():
    blocks = [SimpleNamespace(whole_ns=[1000] * 99), SimpleNamespace(whole_ns=[9000] * 2)]
    assert p99_of(blocks) == 9.0
    assert p99_of(blocks[:1]) == 1.0
