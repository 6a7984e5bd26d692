"""`physics`: the cost of a robot on a floor, compared with the same run without one, and the accuracy of its world.

Both runs are `canopen-control run` with all their processes, on buses of their own, at the same time and with the same
commands. The rest is simulated time: CPU at rest, the bits of two processes, the slip of a square.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.calibration.umbmark_session import CalibrationPlan, TrueEnds, calibrate
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, NotYetEnabled, RemoteError
from canopen_control.host.environment import MODULE
from canopen_control.physics import require_physics
from canopen_control.rpc.messages.robot import CommandController
from canopen_control_bench.figure import AT_LEAST, Figure, limited
from canopen_control_bench.machine import cpu_ns
from canopen_control_bench.stage import stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from canopen_control_bench.runner import Options
    from canopen_control_bench.stage import Stage


CORE_LIMIT: Final = 6.0  # % of a core
REST_LIMIT: Final = 0.1  # in 60 s
SLIP_M: Final = 3.5e-3  # of a 2 m square at friction 0.1
SLIP_BAND: Final = (0.8, 1.2)
MIRROR_LIMIT: Final = 1e-6  # m, for an ideal robot
CALIBRATION_GAIN: Final = 100.0  # after two passes of UMBmark
UNEQUAL, TRACK = 0.005, 1.02  # relative errors of the wheels assumed by that robot
ROUNDS: Final = 3
_SECONDS, _QUICK_S = 8.0, 3.0
_EVERY_S: Final = 0.1


def _circle(step: int) -> list[float]:
    return [0.15, 0.5 if step // 20 % 2 else -0.5]


def _swing(step: int) -> list[float]:
    return [0.3 * math.sin(0.06 * step)] * 6  # no step that is too large for a heavy arm


#: robot: its controller, and the command of each step
_MOTIONS: dict[str, tuple[str, Callable[[int], list[float]]]] = {
    "robby": ("robby_base_controller", _circle),
    "arm6": ("arm_position_controller", _swing),
}


def measure(options: Options) -> list[Figure]:
    """Measure the CPU time of whole runs, then of the world alone."""
    require_physics()
    seconds = _QUICK_S if options.quick else _SECONDS
    figures = [_beside(robot, seconds, 1 if options.quick else ROUNDS) for robot in _MOTIONS]
    return [*figures, *_alone(options)]


def _beside(robot: str, seconds: float, rounds: int) -> Figure:
    """Return by how many CPU cores a run with physics exceeds one without."""
    with stage() as played:
        runs = {kind: _start(played, robot, kind) for kind in ("physics", "plain")}
        steps = count()  # over all rounds: an arm commanded back to its start in one step does not follow
        seen = [_round(robot, runs, seconds, steps) for _ in range(rounds)]
    more = [100.0 * (sample["physics"] - sample["plain"]) / seconds for sample in seen]
    absolutes = {
        f"{kind} % of a core": round(100.0 * sum(sample[kind] for sample in seen) / (len(seen) * seconds), 1)
        for kind in runs
    }
    return limited(f"{robot} in physics, more CPU than without", "%", more, limit=CORE_LIMIT, absolutes=absolutes)


def _start(played: Stage, robot: str, kind: str) -> int:
    """Start a run and return its process id once the robot is running."""
    name = f"{robot}_{kind}"
    options = ["--physics"] if kind == "physics" else []
    controller = _MOTIONS[robot][0]
    words = ["run", robot, "--name", name, "--can", f"local:{name}", "--controller", controller, "--no-flight-recorder"]
    program = played.start("canopen_control", *words, *options)
    while " runs: " not in program.line():
        pass
    program.drain()
    return program.pid


def _round(robot: str, runs: dict[str, int], seconds: float, steps: Iterator[int]) -> dict[str, float]:
    """Command both runs for a time, and return the CPU seconds of all their processes."""
    controller, motion = _MOTIONS[robot]
    clients = [RobotClient.connect(f"{robot}_{kind}") for kind in runs]
    try:
        before = {kind: _cpu_s(pid) for kind, pid in runs.items()}
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            values = motion(next(steps))
            for client in clients:
                _command(client, controller, values)
            time.sleep(_EVERY_S)
        return {kind: _cpu_s(pid) - before[kind] for kind, pid in runs.items()}
    finally:
        for client in clients:
            client.close()


def _command(client: RobotClient, controller: str, values: list[float]) -> None:
    try:
        client.ask(CommandController(controller=controller, values=values, source="bench"))
    except NotYetEnabled:
        return
    except RemoteError as error:
        raise CanopenError(f"a robot that is measured took no command: {error}") from error


def _cpu_s(pid: int) -> float:
    """Return the CPU seconds of a process and its children since their start."""
    return sum(cpu_ns(process) for process in (pid, *_children(pid))) / 1e9


def _children(pid: int) -> Iterator[int]:
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            text = path.read_text()
        except OSError:  # the process has ended meanwhile
            continue
        if int(text.rpartition(")")[2].split()[1]) == pid:
            yield int(path.parent.name)


def _calibrated(side: float = 1.0) -> Figure:
    """Return by which factor two passes of UMBmark reduce the largest error of a robot in physics."""
    from canopen_control_bench.physics_square import MisjudgedBase

    plan = CalibrationPlan(side, passes=2)
    outcome = calibrate(MisjudgedBase(UNEQUAL, TRACK), TrueEnds(_silent), plan, _silent)
    before, after = 1e3 * outcome.first.largest, 1e3 * outcome.last.largest
    return limited(
        "UMBmark, 0.5 % unequal wheels and 2 % of track: gain", "", [outcome.gain], limit=CALIBRATION_GAIN,
        direction=AT_LEAST, counted=True,
        absolutes={"mm before": round(before, 1), "mm after": round(after, 2)},
    )  # fmt: skip


def _silent(_told: object) -> None:
    pass


def _alone(options: Options) -> list[Figure]:
    """Return the figures of the world in simulated time."""
    from canopen_control_bench.physics_square import rest_cpu, square

    seconds = 30.0 if options.quick else 600.0
    command = [*MODULE, "canopen_control_bench.physics_square", str(seconds)]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=sys.stderr, text=True) for _ in range(2)]
    digests = [process.communicate()[0].strip() for process in both]
    turns = [square(direction, 0.1) for direction in (1, -1)]
    slip = max(turn.error for turn in turns) / SLIP_M
    ideal = [square(direction) for direction in (1, -1)]
    apart = max(abs(ideal[0].x - ideal[1].x), abs(ideal[0].y + ideal[1].y))
    differing = float(len(set(digests)) - 1 + (not all(digests)))
    return [
        limited("60 s at rest, CPU of the world", "s", [rest_cpu(60.0) for _ in range(3)], limit=REST_LIMIT),
        limited(f"{seconds:g} s in two processes: digests that differ", "", [differing], limit=0.0, counted=True),
        limited(
            "square on friction 0.1: error / the known 3.5 mm", "", [slip], limit=SLIP_BAND[1], counted=True,
            absolutes={"mm": round(1e3 * slip * SLIP_M, 2), "mm on 0.8": round(1e3 * max(e.error for e in ideal), 2)},
        ),
        limited(
            "the same, at least", "", [slip], limit=SLIP_BAND[0], direction=AT_LEAST, counted=True
        ),
        limited("cw and ccw of an ideal robot, apart", "m", [apart], limit=MIRROR_LIMIT, counted=True),
        _calibrated(),
    ]  # fmt: skip
