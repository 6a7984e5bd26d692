"""`start`: from the command line to both wheels under command, and with ROS to the first `/joint_states`.

A robot with its virtual drives, hub and flight recorder is started as a user starts it, with files and modules that
were read before (warm). The ROS program that listens is there already.
"""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError
from canopen_control_bench.clients import has_ros
from canopen_control_bench.figure import Figure, limited
from canopen_control_bench.stage import TIMEOUT_S, Stage, stage

if TYPE_CHECKING:
    from canopen_control_bench.runner import Options
    from canopen_control_bench.stage import Program


COMMANDED_LIMIT_S, JOINT_STATES_LIMIT_S = 0.6, 1.5
ROUNDS, QUICK_ROUNDS = 9, 3
_POLL_S = 0.01


def measure(options: Options) -> list[Figure]:
    """Start a robot repeatedly, without ROS and, if it is installed, with ROS."""
    rounds = range(QUICK_ROUNDS if options.quick else ROUNDS)
    with stage() as played:
        until_commanded(played, "warm")
        commanded = [until_commanded(played, f"start{number}") for number in rounds]
        figures = [_figure("run: both wheels under command", commanded, COMMANDED_LIMIT_S)]
        if has_ros():
            listener = played.start("canopen_control_bench.peers.rclpy_topics", "listen", ros=True)
            listener.line()
            heard = [until_joint_states(played, f"ros{number}", listener) for number in rounds]
            figures.append(_figure("run --ros: first /joint_states", heard, JOINT_STATES_LIMIT_S))
    return figures


def until_commanded(played: Stage, name: str) -> float:
    """Return the seconds from the command line until the robot accepts commands; then end it."""
    begin = time.monotonic()
    robot = run_robby(played, name)
    seconds = time.monotonic() - begin
    robot.end()
    return seconds


def until_joint_states(played: Stage, name: str, listener: Program) -> float:
    """Return the seconds from the command line until another ROS program has received joint states."""
    before, begin = _heard(listener), time.monotonic()
    robot = run_robby(played, name, "--ros")
    while _heard(listener) == before:
        if time.monotonic() - begin > TIMEOUT_S:
            raise CanopenError(f"no /joint_states within {TIMEOUT_S:g} s of run --ros")
        time.sleep(_POLL_S)
    seconds = time.monotonic() - begin
    robot.end()
    return seconds


def run_robby(played: Stage, name: str, *options: str) -> Program:
    """Start robby, and return it when it is running: its drives are enabled, its controller is active."""
    robot = played.start("canopen_control", "run", "robby", "--name", name, *options)
    robot.until(f"{name} runs")
    robot.drain()
    return robot


def _heard(listener: Program) -> int:
    listener.tell(json.dumps("counts"))
    return int(json.loads(listener.line())["bridge"]["joint_states"])


def _figure(name: str, seconds: list[float], limit: float) -> Figure:
    absolutes = {"least s": round(min(seconds), 3), "most s": round(max(seconds), 3)}
    return limited(name, "s", seconds, limit=limit, absolutes=absolutes)
