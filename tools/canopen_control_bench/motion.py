"""`motion`: the cost of trajectories for the runtime, and how evenly an arm's set-points arrive at its drives.

All of it in simulated time with the complete runtime, six virtual drives and their bus in this process; what is timed
is CPU of its thread. First the cycle of six axes that follow a trajectory beside that of six that get commands. Then
goals of 500 points from a client at 1 kHz: how long one request, and the cycle after it, keep the loop from others.
Last the acceleration that the drives were to have, beside that of a run in time, for a host that wakes up to
2 ms late (so that two cycles follow each other 2 ms sooner or later than they should) behind an adapter that hands
frames over once a millisecond. Judged are the defaults: SYNC of the kernel, and drives that take each SYNC as the
exact time; and SYNC of the host, and drives that recover its rhythm (`virtual.sync_rhythm`). Beside them: SYNC of a
node whose clock is 200 ppm slow; SYNC of the host and drives that recover nothing; and one set-point for each wake-up,
the time of which is the controllers'.
"""

from __future__ import annotations

import enum
import math
import os
import random
import statistics
import tempfile
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.client.robot_client import RobotClient
from canopen_control.errors import CanopenError
from canopen_control.host.lineclient import LineClient
from canopen_control.host.sockets import socket_path
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import SendTrajectory
from canopen_control.runtime.api import ApiServer
from canopen_control.virtual.device_model import GENERIC, PLAIN
from canopen_control_bench.arm import CONTROLLER, ENDS, JOINTS, NODES, POSITIONS, arm_at, planned
from canopen_control_bench.figure import Figure, compared, limited
from canopen_control_bench.simulated_arm import MS, PPM, SimulatedArm

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control_bench.runner import Options


CPU_LIMIT: Final = 1.5
HELD_LIMIT_US: Final = 1000.0
RIPPLE_LIMIT: Final = 1.1
POINTS: Final = 500
MAX_LATE_NS: Final = 2 * MS
_FOLLOWED_HZ, _ACCEPTED_HZ = 100, 1000
_POINTS_PER_S: Final = 10  # like those of MoveIt's time parameterisation
_RATES = (100, 250)
_AWAY = [0.3 * end for end in ENDS]
_HOME = [0.0] * len(ENDS)
_PLAY_S, _LOCK_MS = 0.6, 500
_QUICK_S, _COMPARED_S, _SECONDS = 2 * _PLAY_S, 20 * _PLAY_S, 600.0
_FROM_ELSEWHERE: Final = "\n  sync_producer: other"


def measure(options: Options) -> list[Figure]:
    """Measure everything; `seconds` is how long the set-points are recorded at each rate."""
    rounds, cycles = (5, 40) if options.quick else (11, 500)
    seconds = options.seconds or (_QUICK_S if options.quick else _SECONDS)
    with tempfile.TemporaryDirectory(prefix="motion-") as folder:
        places = (Path(folder) / str(number) for number in range(100))
        figures = [follow_in_turns(places.__next__, rounds, cycles), *accept_goals(next(places), rounds)]
        for hertz in _RATES:
            options.say(f"motion: set-points at {hertz} Hz")
            for who in Sync:
                figures += by_default(places.__next__, hertz, seconds, who)
            figures += beside(places.__next__, hertz)
    return figures


class Sync(enum.Enum):
    """The sender of SYNC by default, and its effect on the drives."""

    KERNEL = "SYNC of the kernel"
    HOST = "SYNC of the host, drives recover it"


def _arm(
    place: Path, hertz: int, *, trajectories: bool = True, ppm: int | None = None, model: DeviceModel | None = None
) -> SimulatedArm:
    """Create an arm; `ppm` is how slow the clock of an external SYNC producer is, None if the host sends SYNC."""
    keys = "" if ppm is None else _FROM_ELSEWHERE
    config = arm_at(place, hertz, keys, trajectories=trajectories)
    return SimulatedArm(f"motion_{place.name}_{os.getpid()}", config, own_sync=ppm is None, ppm=ppm or 0, model=model)


# --------------------------------------------------------------------------------------------- CPU time of a cycle


def _time_cycles(arm: SimulatedArm) -> list[int]:
    """Record the CPU time of each cycle from now on, in ns."""
    cycle, spent, clock = arm.robot.pacer.on_edge, list[int](), time.thread_time_ns

    def timed(now: int) -> None:
        begin = clock()
        cycle(now)
        spent.append(clock() - begin)

    arm.robot.pacer.on_edge = timed
    return spent


def follow_in_turns(place: Callable[[], Path], rounds: int, cycles: int) -> Figure:
    """Compare cycles of axes on a trajectory with cycles of axes that get a command in each cycle."""
    period_ms = 1000 / _FOLLOWED_HZ
    with ExitStack() as undo:
        ours, theirs = (
            undo.enter_context(closing(_arm(place(), _FOLLOWED_HZ, trajectories=trajectories)))
            for trajectories in (True, False)
        )
        followed, commanded = _time_cycles(ours), _time_cycles(theirs)
        seconds = (rounds + 1) * cycles / _FOLLOWED_HZ + 1.0
        goal = ours.send(_AWAY, seconds, round(seconds * _POINTS_PER_S))
        turns: list[tuple[float, float]] = []
        for number in range((rounds + 1) * cycles):
            values = [0.2 * end * math.sin(number / 50) for end in ENDS]
            theirs.robot.command(POSITIONS, values, "bench")
            theirs.run(period_ms)
            ours.run(period_ms)
            if (number + 1) % cycles == 0:
                turns.append((statistics.median(followed) / 1000, statistics.median(commanded) / 1000))
                followed.clear()
                commanded.clear()
        if goal.ended:
            raise CanopenError(f"the goal has ended too early: {goal.text}")
    return compared("CPU of a cycle, 6 axes on a trajectory", "us", turns[1:], peer_name="6 commanded", limit=CPU_LIMIT)


# -------------------------------------------------------------------------------------------- acceptance of a goal


class _Asked(LineClient):
    """A connection whose other side runs while this side waits; `held` is the time of that in ns."""

    def __init__(self, arm: SimulatedArm, name: str) -> None:
        self._arm, self.held = arm, list[int]()
        self._server = ApiServer(arm.robot)
        super().__init__(socket_path("robot", name))

    def receive(self, timeout: float | None = 5.0) -> bytes | None:
        del timeout
        begin = time.thread_time_ns()
        self._arm.serve()
        self.held.append(time.thread_time_ns() - begin)
        self._arm.run(2000 / _ACCEPTED_HZ)
        return super().receive(0)

    def close(self) -> None:
        super().close()
        self._server.close()


def accept_goals(place: Path, rounds: int) -> list[Figure]:
    """Send goals of 500 points and return how long the loop was blocked by a request, and by the following cycle."""
    requests, afterwards, usual = list[float](), list[float](), list[float]()
    with closing(_arm(place, _ACCEPTED_HZ)) as arm:
        cycles = _time_cycles(arm)
        stream = _Asked(arm, arm.robot.setup.name)
        with closing(RobotClient(stream)) as client:
            for _ in range(rounds):
                cycles.clear()
                arm.run(20)
                usual.append(statistics.median(cycles) / 1000)
                cycles.clear()
                stream.held.clear()
                _send(client, arm)
                requests.append(max(stream.held) / 1000)
                afterwards.append(max(cycles) / 1000)
    told = {"points": POINTS, "requests": len(stream.held), "a usual cycle us": round(statistics.median(usual), 1)}
    name = f"a goal of {POINTS} points at 1 kHz"
    return [
        limited(f"{name}: longest request", "us", requests, limit=HELD_LIMIT_US, absolutes=told),
        limited(f"{name}: longest cycle", "us", afterwards, limit=HELD_LIMIT_US),
    ]


def _send(client: RobotClient, arm: SimulatedArm) -> None:
    """Send a goal in pieces, like a client; CanopenError if it is refused."""
    plan = planned(arm.positions(), _AWAY, 60.0, POINTS)
    points = [
        TrajectoryPoint(
            positions=list(point.positions),
            velocities=list(point.velocities),
            accelerations=list(point.accelerations),
            time_from_start=point.time / 1e9,
        )
        for point in plan.points
    ]
    last = client.send_points(points)
    verdict = client.ask(SendTrajectory(controller=CONTROLLER, joints=JOINTS, points=last))
    if not verdict.accepted:
        raise CanopenError(f"a goal of {POINTS} points was refused: {verdict.text}")


# ----------------------------------------------------------------------------------------- regularity of set-points


def by_default(place: Callable[[], Path], hertz: int, seconds: float, who: Sync) -> list[Figure]:
    """Compare the acceleration ripple of the drives on a late host with that on a punctual one, at default settings."""
    ppm, model = (0, PLAIN) if who is Sync.KERNEL else (None, GENERIC)
    calm, late = (_arm(place(), hertz, ppm=ppm, model=model) for _ in range(2))
    with closing(calm), closing(late):
        wanted = _played(calm, min(seconds, _COMPARED_S))
        _disturb(late, hertz)
        found = _played(late, seconds)
        name = f"6 axes at {hertz} Hz, {who.value}"
        lost = limited(f"{name}: lost, doubled", "", [_lost(late)], limit=0.0, counted=True)
        return [_ripple(f"{name}: ripple", found, wanted, RIPPLE_LIMIT, _told(late)), lost]


def beside(place: Callable[[], Path], hertz: int) -> list[Figure]:
    """Compare what else there is with a host in time: SYNC of a node, drives that take each SYNC as it comes, and
    one set-point for each wake-up.
    """
    figures = []
    for text, ppm, by_wake_up in (
        ("SYNC of a node at 200 ppm", PPM, False),
        ("SYNC of the host, drives take it as it comes", None, False),
        ("one for each wake-up", None, True),
    ):
        with closing(_arm(place(), hertz, ppm=ppm, model=PLAIN)) as arm:
            wanted = _played(arm, _QUICK_S)
            _disturb(arm, hertz)
            if by_wake_up:
                arm.command_by_wake_up()
            found = _played(arm, _QUICK_S)
            figures.append(_ripple(f"6 axes at {hertz} Hz, {text}: ripple", found, wanted, None, _told(arm)))
    return figures


def _disturb(arm: SimulatedArm, seed: int) -> None:
    chance = random.Random(seed)
    arm.late = lambda: round(chance.random() * MAX_LATE_NS)
    arm.batch_ns = MS


def _played(arm: SimulatedArm, seconds: float) -> list[float]:
    """Move back and forth for the given time, once the cycle follows SYNC; return the ripple of each drive."""
    arm.run(_LOCK_MS)
    arm.measure_anew()
    for number in range(max(1, round(seconds / _PLAY_S))):
        arm.play(_HOME if number % 2 else _AWAY, _PLAY_S)
    ripples = [arm.quality(node).acceleration_ripple for node in NODES]
    return [ripple if ripple is not None else math.nan for ripple in ripples]


def _lost(arm: SimulatedArm) -> int:
    """Return the number of lost or repeated set-points over all drives."""
    found = [arm.quality(node) for node in NODES]
    return sum(result.missed + result.doubled + result.overwritten for result in found)


def _told(arm: SimulatedArm) -> dict[str, float | str]:
    found = [arm.quality(node) for node in NODES]
    phase = found[0].phase_us
    return {
        "taken": sum(result.taken for result in found),
        "lost or doubled": _lost(arm),
        "cycles left out": arm.robot.pacer.missed,
        **({} if phase is None else {"RPDO after SYNC us": f"{phase.min:.0f} to {phase.max:.0f}"}),
    }


def _ripple(
    name: str, found: Sequence[float], wanted: Sequence[float], limit: float | None, told: dict[str, float | str]
) -> Figure:
    """Return the figure of the worst axis."""
    worst = max(zip(found, wanted, strict=True), key=lambda pair: pair[0] / pair[1])
    return compared(name, "", [worst], peer_name="in time", limit=limit, absolutes=told)
