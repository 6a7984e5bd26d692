"""`simulate`: robots in virtual time, in seconds of robot time per second of CPU time.

Everything of `canopen-control simulate` is on: the runtime, the drives, the bit-true bus, the observer and the digest.
What is timed is CPU of this process: the first run reads the files, which the seeds of a campaign share, and is thrown
away. A boot is from a setup that was read to all drives operational. `--compiled` of tools/bench runs what is compiled.
"""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.version import COMPILED, PURE, build
from canopen_control_bench.figure import AT_LEAST, OWN_CPU, Figure, compared, limited
from canopen_control_bench.fleet import write_fleet

if TYPE_CHECKING:
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control_bench.runner import Options


#: minimum multiple of real time by build; a quick run may share its CPUs with others, and requires a quarter
LIMITS: Final[dict[str, dict[str, float]]] = {
    PURE: {"robby": 100.0},
    COMPILED: {"robby": 150.0, "16 drives": 20.0},
}
BOOT_LIMIT_MS: Final = 30.0
_SHARED: Final = 4
_PERIOD_US: Final = 20_000
_STEP_NS: Final = 5_000_000
_BOOT_NS: Final = 5_000_000_000
_SEED: Final = 7


@dataclass(frozen=True, slots=True)
class Simulated:
    """One simulation: CPU seconds of the boot and of the rest, the robot time of the rest, and the digest."""

    boot_s: float
    cpu_s: float
    robot_s: float
    sha256: str


def measure(options: Options) -> list[Figure]:
    """Simulate robby and a base with 16 drives, both at 50 Hz."""
    seconds = options.seconds or (4.0 if options.quick else 60.0)
    rounds = 3 if options.quick else 5
    figures: list[Figure] = []
    boots: list[float] = []
    with tempfile.TemporaryDirectory(prefix="simulate-") as folder:
        robots = {"robby": "robby", "16 drives": str(write_fleet(Path(folder), 16, _PERIOD_US, base=True))}
        for name, config in robots.items():
            setup = read_robot(find_robot(config))
            simulate(setup, 0.5)
            found = [simulate(setup, seconds) for _ in range(rounds)]
            times = [(result.robot_s, result.cpu_s) for result in found]
            limit = LIMITS[build()].get(name)
            if limit is not None and options.quick:
                limit /= _SHARED
            figures.append(
                compared(f"{name} at 50 Hz, {build()}", "s", times, peer_name=OWN_CPU, limit=limit, direction=AT_LEAST)
            )
            boots = boots or [1000 * result.boot_s for result in found]
    return [*figures, limited(f"boot of robby, CPU, {build()}", "ms", boots, limit=BOOT_LIMIT_MS)]


def simulate(setup: RobotSetup, seconds: float) -> Simulated:
    """Simulate a commanded robot without faults; raises CanopenError if it does not boot."""
    motions, duration_ns = motions_of(setup), round(seconds * 1e9)
    nodes = [node.node_id for bus in setup.buses.values() for node in bus.nodes.values()]
    begun = time.process_time()
    run = SimulationRun(setup, _SEED, draw_schedule(_SEED, duration_ns, motions, nodes, []), motions=motions)
    try:
        robot, began_ns = run.robot, run.robot.now_ns
        robot.start()
        while not robot.running:
            robot.run_for(_STEP_NS)
            if robot.now_ns - began_ns > _BOOT_NS:
                raise CanopenError(f"{setup.name} has not booted within {_BOOT_NS // 1_000_000_000} s of its own")
        booted, boots_ns = time.process_time(), robot.now_ns - began_ns
        robot.run_for(max(duration_ns - boots_ns, _STEP_NS))
        done = time.process_time()
        return Simulated(booted - begun, done - booted, run.robot_s - boots_ns / 1e9, run.outcome.sha256)
    finally:
        run.close()
