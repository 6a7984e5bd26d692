"""Simulation of all robots of a world file in one virtual time, for `simulate --world FILE` without a robot."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.output import Progress, json_line
from canopen_control.errors import ConfigError
from canopen_control.runtime.shared_world import read_shared
from canopen_control.simulation.robot_under_test import SimulationObserver
from canopen_control.simulation.simulation_run import SharedSimulation

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from canopen_control.master.event_log import Event


_NEEDS_ROBOT: Final = ("scenario", "recording", "record", "seeds", "jobs", "dask", "aim", "out")
_IN_WORLD_FILE: Final = ("can", "controller")


class EventPrinter(SimulationObserver):
    """Observer that prints the events of a simulation with time in s and `prefix`, and ends the progress line."""

    def __init__(self, progress: Progress, prefix: str = "") -> None:
        self._progress, self._prefix = progress, prefix

    def event(self, event: Event) -> None:
        self._progress.end()
        print(f"{event.time / 1e9 - 1.0:9.3f} {self._prefix}{event.sentence}")


def simulate_world(args: argparse.Namespace, duration_ns: int, faults: Sequence[str]) -> int:
    """Simulate the robots of a world file; return 1 if an invariant was violated, else 0; Ctrl-C ends early."""
    for option in _NEEDS_ROBOT:
        if getattr(args, option) is not None:
            raise ConfigError(f"--{option} needs a ROBOT; --world FILE alone simulates all robots of the file")
    for option in _IN_WORLD_FILE:
        if getattr(args, option):
            raise ConfigError(f"--{option} needs a ROBOT; a world file sets it for each robot")
    world = Path(args.world)
    setups = [robot.setup for robot in read_shared(world)]
    simulation = SharedSimulation(setups, world, args.seed or 0, duration_ns, faults)
    for note in simulation.notes:
        print(f"canopen-control: {note}", file=sys.stderr)
    progress = Progress("robot time", "s", stream=sys.stderr)
    try:
        for name, run in ({} if args.json else simulation.runs).items():
            run.robot.observers.append(EventPrinter(progress, f"{name}: "))
        with contextlib.suppress(KeyboardInterrupt), progress:
            simulation.run(lambda robot_s: progress.at(int(robot_s), int(duration_ns / 1e9) or None), args.speed)
        outcome = simulation.outcome
    finally:
        simulation.close()
    if args.json:
        print(json_line(outcome))
        return 1 if outcome.breaches else 0
    for name, robot in outcome.robots.items():
        print(f"{name}: seed {robot.seed}, {robot.frames} frames, {robot.events} events, sha256 {robot.sha256}")
    print(f"{outcome.robot_s:g} s of {len(outcome.robots)} robots in {outcome.real_s:.1f} s, sha256 {outcome.sha256}")
    for breach in outcome.breaches:
        print(f"breach: {breach}")
    return 1 if outcome.breaches else 0
