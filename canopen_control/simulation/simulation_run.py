"""Runs of simulations: one robot with its schedule, or several robots in one physics world, and their results.

Robots in one world push each other and their range finders see each other, as in `run --world FILE`. The seed of each
robot is derived from the common seed and its number in the file.
"""

from __future__ import annotations

import hashlib
import time
import time as real_time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.runtime.core import RobotState
from canopen_control.simulation.event_player import EventPlayer
from canopen_control.simulation.invariants import Invariants, user_rules
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule
from canopen_control.simulation.robot_under_test import RobotUnderTest
from canopen_control.simulation.simulated_floor import SimulatedFloor, open_shared_floor
from canopen_control.simulation.virtual_time import VirtualTime

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.served_simulation import ServedSimulation
    from canopen_control.virtual.scenario import ScenarioEvent


_SLICE_NS: Final = 100_000_000


@dataclass(frozen=True, slots=True)
class SimulationResult:
    """Result of a simulation; `sha256` covers all frames and events with their times."""

    seed: int
    robot_s: float
    real_s: float
    frames: int
    events: int
    sha256: str
    breaches: tuple[str, ...] = ()


class SimulationRun:
    """Run of a schedule on a robot from its start; `outcome` is the result so far.

    `speed` is the maximum ratio of virtual to real time, or None without a limit. `began_ns` is the virtual time at
    which the schedule starts. `robot` is an existing robot to use. `served` is set to let other programs take part.
    """

    def __init__(
        self,
        setup: RobotSetup,
        seed: int,
        acts: Sequence[ScenarioEvent],
        *,
        speed: float | None = None,
        motions: Sequence[SampleMotion] | None = None,
        robot: RobotUnderTest | None = None,
    ) -> None:
        self.seed, self.speed = seed, speed
        self.robot = RobotUnderTest(setup, seed) if robot is None else robot
        self.player = EventPlayer(self.robot)
        self.invariants = Invariants(
            self.robot, self.player, motions_of(setup) if motions is None else motions, user_rules()
        )
        self.player.plan(acts)
        self.served: ServedSimulation | None = None
        self.began_ns = self.robot.now_ns
        self._began = time.perf_counter()

    def run(
        self,
        duration_ns: int,
        progress: Callable[[float, float], object] = lambda _robot, _real: None,
        stop: Callable[[], bool] = lambda: False,
    ) -> None:
        """Start the robot and simulate; `progress` is called repeatedly with the simulated and the real time in s.

        The run ends early if `stop` returns True.
        """
        self._began = time.perf_counter()
        self.robot.start()
        end = self.began_ns + duration_ns
        slice_ns = _SLICE_NS if self.served is None else self.served.slice_ns
        while (now := self.robot.now_ns) < end and not stop():
            self.robot.time.run_until(min(end, now + slice_ns))
            progress(self.robot_s, self.real_s)
            self._keep_pace()

    def _keep_pace(self) -> None:
        """Sleep if the simulation is ahead of `speed`, and exchange data with connected programs."""
        ahead = 0.0 if self.speed is None else max(0.0, self.robot_s / self.speed - self.real_s)
        if self.served is not None:
            self.served.wait(ahead)
        elif ahead:
            time.sleep(ahead)

    @property
    def robot_s(self) -> float:
        return (self.robot.now_ns - self.began_ns) / 1e9

    @property
    def real_s(self) -> float:
        """Real time in s since the start of the run."""
        return time.perf_counter() - self._began

    @property
    def outcome(self) -> SimulationResult:
        """Result of the run so far."""
        robot = self.robot
        digest = robot.digest
        return SimulationResult(
            self.seed, self.robot_s, round(self.real_s, 3), robot.frames, digest.events, digest.hex, self.breaches
        )

    @property
    def breaches(self) -> tuple[str, ...]:
        return tuple(breach.sentence for breach in self.invariants.breaches)

    def start_failure(self, duration_ns: int) -> str:
        """Return why the robot never reached RUNNING, or "" if it did or the run ended early."""
        core, seconds = self.robot.core, self.robot_s
        ended = core.state is RobotState.STOPPED or seconds * 1e9 >= duration_ns
        if core.has_run or not ended:
            return ""
        why = core.failure or core.hint or "see its events for the progress, or allow more time with --for"
        return f"{core.setup.name} did not reach the state RUNNING within {seconds:g} s: {why}"

    @property
    def immobility(self) -> str:
        """Why no command to a controller could move anything, or ""."""
        reasons = self.robot.core.manager.immobile
        return "; ".join(f"{name} moved nothing: {reason}" for name, reason in reasons.items() if reason)

    def close(self) -> None:
        """Shut down robot, drives and served socket, and delete temporary files."""
        if self.served is not None:
            self.served.close()
        self.robot.close()


@dataclass(frozen=True, slots=True)
class SharedOutcome(SimulationResult):
    """Result of a simulation of several robots, in total and by robot."""

    robots: dict[str, SimulationResult] = field(default_factory=dict)


class SharedSimulation:
    """Robots in one physics world, each with its own random schedule and observers.

    `runs` contains the run of each robot by name. Raises ConfigError if the world refuses a robot.
    """

    def __init__(
        self, setups: Sequence[RobotSetup], world: Path, seed: int, duration_ns: int, faults: Sequence[str]
    ) -> None:
        self.seed, self._duration_ns = seed, duration_ns
        self.time = VirtualTime()
        robots = [RobotUnderTest(setup, seed + number, time=self.time) for number, setup in enumerate(setups)]
        joints = (robot.core.joints for robot in robots)
        floor = open_shared_floor(zip(setups, joints, strict=True), world)
        self.notes = floor.notes
        self.runs: dict[str, SimulationRun] = {}
        for robot in robots:
            setup = robot.setup
            robot.floor = SimulatedFloor(floor.side(setup.name), self.time, robot.awake)
            motions = motions_of(setup)
            acts = draw_schedule(robot.seed, duration_ns, motions, list(robot.drives), faults)
            self.runs[setup.name] = SimulationRun(setup, robot.seed, acts, motions=motions, robot=robot)
        self._began, self._began_ns = real_time.perf_counter(), self.time.now_ns

    def run(self, progress: Callable[[float], object] = lambda _robot_s: None, speed: float | None = None) -> None:
        """Simulate from start to end; `progress` is called repeatedly with the simulated time in s."""
        self._began = real_time.perf_counter()
        for run in self.runs.values():
            run.robot.start()
        end = self._began_ns + self._duration_ns
        while (now := self.time.now_ns) < end:
            self.time.run_until(min(end, now + _SLICE_NS))
            progress(self.robot_s)
            if speed is not None and (ahead := self.robot_s / speed - self.real_s) > 0:
                real_time.sleep(ahead)

    @property
    def robot_s(self) -> float:
        return (self.time.now_ns - self._began_ns) / 1e9

    @property
    def real_s(self) -> float:
        """Real time in s since the start of the run."""
        return real_time.perf_counter() - self._began

    @property
    def outcome(self) -> SharedOutcome:
        """Result of the simulation so far."""
        outcomes = {name: run.outcome for name, run in self.runs.items()}
        return SharedOutcome(
            self.seed,
            self.robot_s,
            round(self.real_s, 3),
            sum(outcome.frames for outcome in outcomes.values()),
            sum(outcome.events for outcome in outcomes.values()),
            hashlib.sha256("".join(outcome.sha256 for outcome in outcomes.values()).encode()).hexdigest(),
            tuple(f"{name}: {breach}" for name, outcome in outcomes.items() for breach in outcome.breaches),
            outcomes,
        )

    def close(self) -> None:
        """Shut down all robots and drives, and delete their temporary files."""
        for run in self.runs.values():
            run.close()
