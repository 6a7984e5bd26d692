"""The clients bench: a program on a terminal is measured and ended; one that ends by itself says why."""

import os

import pytest
from canopen_control_bench.clients import on_a_terminal
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
