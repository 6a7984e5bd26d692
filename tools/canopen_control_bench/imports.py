"""`import`: start-up time of `canopen-control --help` and `status`, against a bare `python -c pass`.

All run as a user runs them, in the same venv, so that all pay what the venv itself costs. The ROS wheels cost the most
there: their start hook (`ros_wheels_bootstrapper.pth`) starts every interpreter of the venv a second time. What is left
without it is told beside.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control.host.environment import MODULE
from canopen_control_bench.figure import Figure, compared
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control_bench.runner import Options


ROBOT = "bench"
HELP_LIMIT, STATUS_LIMIT = 2.5, 5.0
ROUNDS, RUNS = 5, 5
_GUARD = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
BARE = (sys.executable, "-c", "pass")


def measure(options: Options) -> list[Figure]:
    """Time the two verbs and the bare interpreter in turns."""
    runs = 3 if options.quick else RUNS
    with stage() as played:
        robot = played.start("canopen_control", "run", "robby", "--mock", "--name", ROBOT)
        while "runs" not in robot.line():
            pass
        program = _program()
        return [
            *_figures("--help", (*program, "--help"), HELP_LIMIT, runs),
            *_figures("status", (*program, "status", "--name", ROBOT), STATUS_LIMIT, runs),
        ]


def _figures(name: str, command: Sequence[str], limit: float, runs: int) -> list[Figure]:
    as_users = {key: value for key, value in os.environ.items() if key != _GUARD}
    figures = []
    for hook, environment in (("", as_users), (", without the ROS wheels' hook", {**as_users, _GUARD: "1"})):
        if hook and environment == as_users:
            continue
        rounds = [
            (1000 * seconds_of(command, environment, runs), 1000 * seconds_of(BARE, environment, runs))
            for _ in range(ROUNDS)
        ]
        figures.append(
            compared(f"{name}{hook}", "ms", rounds, peer_name="python -c pass", limit=None if hook else limit)
        )
    return figures


def seconds_of(command: Sequence[str], environment: Mapping[str, str], runs: int) -> float:
    """Return the median duration of a command; raises CanopenError if it fails."""
    times = []
    for _ in range(runs):
        begin = time.perf_counter()
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        times.append(time.perf_counter() - begin)
        if done.returncode:
            raise CanopenError(f"{' '.join(command)} ended with {done.returncode}: {done.stderr.strip()}")
    return statistics.median(times)


def _program() -> tuple[str, ...]:
    """Return the installed script next to this interpreter, or else the module."""
    script = Path(sys.executable).parent / "canopen-control"
    return (str(script),) if script.exists() else (*MODULE, "canopen_control")
