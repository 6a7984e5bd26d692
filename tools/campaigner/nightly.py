"""The nightly campaign in virtual time: ten thousand seeds of several robots, and the page of its results.

    tools/campaign --hours 1                              # runs what is not in the results yet, for an hour at most
    tools/campaign --hours 1 --seeds 1000 --jobs 2        # a tenth of it, in two processes
    tools/campaign --page                                 # writes docs/reference/seeds.md of the results

Robots take turns, of two hundred seeds in the proportion of the plan, and the results are written after each turn, so
that a run that is ended, or whose hours are over, has some of each and is taken up by the next. Results of another
version of the package are not added to: its files have another check sum. What a breach takes is shrunk and written
beside the results. Exit codes: 0 good, 1 breaches or not all seeds were run, 2 usage.
"""

from __future__ import annotations

import argparse
import gc
import hashlib
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from campaigner.seed_results import SIMULATED, Plan, Results, RobotResults, page_of, read_results, write_results
from canopen_control.errors import CanopenError
from canopen_control.runtime.robot_files import find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.simulation.campaign import Campaign, Totals, write_breach
from canopen_control.simulation.random_schedule import known_faults
from canopen_control.version import COMPILED, build

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.runtime.setup import RobotSetup


ROOT: Final = Path(__file__).parents[2]
RESULTS: Final = ROOT / "docs" / "reference" / "seeds.json"
PAGE: Final = RESULTS.with_suffix(".md")
PLANS: Final = (
    Plan("robby", 4600, 6),
    Plan("robby", 300, 6, physics=True),
    Plan("forklift", 2000, 6),
    Plan("forklift", 100, 6, physics=True),
    Plan("mecanum", 1500, 6),
    Plan("arm6", 1500, 6),
)
ALL: Final = sum(plan.seeds for plan in PLANS)
_ROUND: Final = 200  # seeds of all robots per round, divided among them
_SHRUNK: Final = 5


class Limits(NamedTuple):
    """The deadline on the monotonic clock, and the number of processes."""

    until: float
    jobs: int


class NightlyRobot:
    """One row of the plan: runs its next seeds and adds the outcomes to its results."""

    def __init__(self, plan: Plan, results: RobotResults, folder: Path) -> None:
        self.plan, self.results = plan, results
        self._folder = folder
        self._setup: RobotSetup = read_robot(find_robot(plan.robot), physics=plan.physics)
        self._campaign = Campaign(self._setup, plan.seconds * 1_000_000_000, known_faults(physics=plan.physics))

    def turn(self, most: int, jobs: int, until: float) -> None:
        """Run the next seeds, at most `most`, until a deadline on the monotonic clock."""
        first = self.results.seeds
        totals = Totals()
        for result in self._campaign.run(range(first, first + most), jobs):
            totals.add(result)
            self.results.add(result)
            for breach in result.breaches:
                print(f"{self.plan.name}, seed {result.seed}: {breach.sentence}", flush=True)
            if time.monotonic() > until:
                break
        for broken in totals.broken[:_SHRUNK]:
            acts = self._campaign.shrink(broken)
            command = f"canopen-control simulate {self.plan.robot}{' --physics' if self.plan.physics else ''}"
            length = self._campaign.length_of(acts)
            print(f"  {command} --scenario {write_breach(self._folder, self._setup, broken, acts, length, command)}")


def run_plans(
    robots: Sequence[NightlyRobot], wanted: Sequence[int], path: Path, results: Results, limits: Limits
) -> None:
    """Run the robots in turns until each has run its seeds or the deadline has passed."""
    gc.collect()
    gc.freeze()  # the garbage collector must not scan the loaded files for each seed
    try:
        _take_turns(robots, wanted, path, results, limits)
    finally:
        gc.unfreeze()


def _take_turns(
    robots: Sequence[NightlyRobot], wanted: Sequence[int], path: Path, results: Results, limits: Limits
) -> None:
    while time.monotonic() < limits.until:
        waiting = [(robot, most) for robot, most in zip(robots, wanted, strict=True) if robot.results.seeds < most]
        if not waiting:
            return
        for robot, most in waiting:
            if time.monotonic() < limits.until:
                share = max(1, robot.plan.seeds * _ROUND // ALL)
                robot.turn(min(share, most - robot.results.seeds), limits.jobs, limits.until)
                write_results(path, results)
                print(results.sentence, flush=True)


def wanted_of(seeds: int) -> list[int]:
    """Return how many of the given number of seeds each robot runs, in the proportions of the plan."""
    return [max(1, plan.seeds * seeds // ALL) for plan in PLANS]


def code_sum(root: Path = ROOT) -> str:
    """Return a checksum of the package and of the robots' files."""
    digest = hashlib.sha256()
    for path in sorted([*root.glob("canopen_control/**/*.py"), *root.glob("config/**/*.*"), *root.glob("eds/*")]):
        if path.is_file():
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="tools/campaign", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--hours", type=float, metavar="H", help="run seeds in virtual time, for so long at most")
    parser.add_argument("--seeds", type=int, default=ALL, metavar="N", help=f"of all robots together (default: {ALL})")
    parser.add_argument("--jobs", type=int, default=1, metavar="J", help="in J processes (default: 1)")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="FILE", help=f"results (default: {SIMULATED})")
    parser.add_argument("--page", action="store_true", help="write the page of the results beside them")
    return parser


def main(arguments: Sequence[str]) -> int:
    """Run seeds, or write the page."""
    parser = _parser()
    args = parser.parse_args(arguments)
    if args.hours is not None and not 0 < args.hours <= 1000:
        parser.error(f"--hours: {args.hours:g} is not a time in hours above 0")
    if args.seeds < 1 or args.jobs < 1:
        parser.error("--seeds and --jobs are numbers from 1 on")
    try:
        return _run(args)
    except KeyboardInterrupt:
        print("ended; what is there is kept, and the same command goes on from it", file=sys.stderr)
        return 1
    except CanopenError as error:
        print(f"tools/campaign: {error}", file=sys.stderr)
        return 2


def _run(args: argparse.Namespace) -> int:
    code = code_sum()
    results = read_results(args.out)
    if args.hours is not None:
        if results.code != code or results.plans != PLANS:
            results = Results(code, PLANS)
        mine = "compiled" if build() == COMPILED else "sources"
        results.build = mine if not results.seeds or results.build == mine else "both"
        wanted, folder = wanted_of(args.seeds), args.out.parent / f"{args.out.stem}-breaches"
        robots = [NightlyRobot(plan, robot, folder) for plan, robot in zip(PLANS, results.robots, strict=True)]
        run_plans(robots, wanted, args.out, results, Limits(time.monotonic() + args.hours * 3600, args.jobs))
        complete = all(robot.seeds >= most for robot, most in zip(results.robots, wanted, strict=True))
    else:
        complete = results.seeds > 0
    if args.page:
        args.out.with_suffix(".md").write_text(page_of(read_results(args.out)), encoding="utf-8")
    return 0 if complete and not results.breaches else 1
