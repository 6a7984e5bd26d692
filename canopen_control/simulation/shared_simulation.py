"""Simulation of several robots in one physics world.

They push each other and their range finders see each other, as in `run --world FILE`. The seed of each robot is derived
from the common seed and its number in the file.
"""

from __future__ import annotations

import hashlib
import time as real_time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule
from canopen_control.simulation.robot_under_test import RobotUnderTest
from canopen_control.simulation.simulated_floor import SimulatedFloor, open_shared_floor
from canopen_control.simulation.simulation_run import SimulationResult, SimulationRun
from canopen_control.simulation.virtual_time import VirtualTime

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.runtime.setup import RobotSetup


_SLICE_NS: Final = 100_000_000


@dataclass(frozen=True, slots=True)
class SharedOutcome:
    """Result of a simulation of several robots, in total and by robot."""

    seed: int
    robot_s: float
    real_s: float
    frames: int
    events: int
    sha256: str
    breaches: tuple[str, ...]
    robots: dict[str, SimulationResult]


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
