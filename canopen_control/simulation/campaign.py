"""A campaign: many seeds, each a drawn schedule on a robot; the schedule of a breach is shrunk.

Seeds run in processes of their own; one that dies costs its seeds a retry in this process. Results do not depend on how
many processes there are, nor on their order.
"""

from __future__ import annotations

import multiprocessing
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.runtime.core import RobotState
from canopen_control.simulation.aimed_schedule import AIMED_NS, aimed_schedule, cells_to_aim_at
from canopen_control.simulation.drawn_schedule import draw_schedule
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.shrink import MOST_TRIES, Shrinker
from canopen_control.simulation.simulation_run import SimulationRun

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterator, Sequence

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.fault_coverage import Cell
    from canopen_control.simulation.invariants import Breach
    from canopen_control.simulation.motions import Motion
    from canopen_control.simulation.state_coverage import Edge

__all__ = ["Campaign", "SeedResult", "Totals"]

_TO_RUN_NS: Final = 20_000_000_000  # after which a robot to which nothing happens does not run any more
_AFTER_NS: Final = 3_000_000_000  # what a shrunk schedule runs on after its last act


@dataclass(frozen=True, slots=True)
class SeedResult:
    """What came of one seed; `troubles` counts what went wrong by its kind, and the state that the robot was in.

    `edges` counts those of the state machines that were walked, `cells` kinds of trouble by the states they hit.
    """

    seed: int
    robot_s: float
    real_s: float
    frames: int
    events: int
    sha256: str
    breaches: tuple[Breach, ...]
    troubles: dict[tuple[str, str], int]
    edges: dict[Edge, int] = field(default_factory=dict)
    cells: dict[Cell, int] = field(default_factory=dict)


@dataclass(slots=True)
class Totals:
    """The results of a campaign, by seed."""

    results: dict[int, SeedResult] = field(default_factory=dict)

    def add(self, result: SeedResult) -> None:
        """Take a result."""
        self.results[result.seed] = result

    @property
    def broken(self) -> list[SeedResult]:
        """The seeds with breaches, in order."""
        return [each for _, each in sorted(self.results.items()) if each.breaches]

    @property
    def robot_s(self) -> float:
        """How long all robots have run, in s."""
        return sum(each.robot_s for _, each in sorted(self.results.items()))

    @property
    def frames(self) -> int:
        """How many frames have passed."""
        return sum(each.frames for each in self.results.values())

    @property
    def troubles(self) -> Counter[tuple[str, str]]:
        """How often what went wrong, and in which state of the robot."""
        found: Counter[tuple[str, str]] = Counter()
        for _, each in sorted(self.results.items()):
            found.update(each.troubles)
        return found

    @property
    def edges(self) -> Counter[Edge]:
        """How often each edge of the state machines was walked."""
        found: Counter[Edge] = Counter()
        for _, each in sorted(self.results.items()):
            found.update(each.edges)
        return found

    @property
    def cells(self) -> Counter[Cell]:
        """How often each kind of trouble hit in each state of each machine."""
        found: Counter[Cell] = Counter()
        for _, each in sorted(self.results.items()):
            found.update(each.cells)
        return found


class Campaign:
    """Runs seeds of `duration_ns` each on a robot, with the faults that are named; a breach is shrunk in `tries`."""

    def __init__(self, setup: RobotSetup, duration_ns: int, faults: Sequence[str], tries: int = MOST_TRIES) -> None:
        self._tries = tries
        self._setup, self._duration_ns, self._faults = setup, duration_ns, list(faults)
        self._motions: Sequence[Motion] = motions_of(setup)
        self._aims: dict[int, Cell] = {}
        self._nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]

    def aim(self, seeds: Sequence[int], hit: Container[Cell]) -> list[int]:
        """Aim seeds at cells that were not hit; return those of them that there is a cell for."""
        cells = cells_to_aim_at(hit, self._faults, len(seeds)) if self._nodes else []
        self._aims.update(zip(seeds, cells, strict=False))
        return list(seeds[: len(cells)])

    def schedule(self, seed: int) -> tuple[Act, ...]:
        """Return what a seed draws, or how it aims."""
        if seed in self._aims:
            return aimed_schedule(seed, self._aims[seed], self._motions, self._nodes)
        return draw_schedule(seed, self._duration_ns, self._motions, self._nodes, self._faults)

    def why_never(self) -> str:
        """Say that the robot does not run even if nothing happens to it, and why; "" where it runs."""
        run = SimulationRun(self._setup, 0, (), motions=self._motions)
        most = max(self._duration_ns, _TO_RUN_NS)
        try:
            run.run(most, stop=lambda: run.robot.core.has_run or run.robot.core.state is RobotState.STOPPED)
            return run.why_never(most)
        finally:
            run.close()

    def run(self, seeds: Sequence[int], jobs: int) -> Iterator[SeedResult]:
        """Yield the results of seeds as they come."""
        if jobs == 1:
            yield from map(self.run_seed, seeds)
            return
        done: set[int] = set()
        context = multiprocessing.get_context("fork")  # a robot's files were read, and are no message
        try:
            with ProcessPoolExecutor(jobs, mp_context=context, initializer=_inherit, initargs=(self,)) as pool:
                for result in pool.map(_run_seed, seeds):
                    done.add(result.seed)
                    yield result
        except BrokenProcessPool:
            yield from map(self.run_seed, [seed for seed in seeds if seed not in done])

    def run_seed(self, seed: int) -> SeedResult:
        """Run one seed to its end."""
        least = AIMED_NS if seed in self._aims else 0
        return self._result(seed, self.schedule(seed), max(self._duration_ns, least))

    def shrink(self, result: SeedResult, hear: Callable[[int], object] = lambda _tries: None) -> tuple[Act, ...]:
        """Return the smallest schedule that breaks the first rule that a seed broke; `hear` is told each try."""
        rule = result.breaches[0].rule

        def breaks(acts: tuple[Act, ...]) -> bool:
            hear(shrinker.tries)
            run = SimulationRun(self._setup, result.seed, acts, motions=self._motions)
            try:
                run.run(self.length_of(acts), stop=partial(_broken, run, rule))
                return _broken(run, rule)
            finally:
                run.close()

        shrinker = Shrinker(breaks, self._tries)
        begun = result.breaches[0].at_s * 1e9
        acts = [act for act in self.schedule(result.seed) if act.at_ns <= begun]
        return shrinker.shrink(acts if breaks(tuple(acts)) else self.schedule(result.seed))

    def length_of(self, acts: Sequence[Act]) -> int:
        """Return for how long a schedule is to be simulated, in ns."""
        return max((act.at_ns + (act.for_ns or 0) for act in acts), default=0) + _AFTER_NS

    def _result(self, seed: int, acts: Sequence[Act], duration_ns: int) -> SeedResult:
        run = SimulationRun(self._setup, seed, acts, motions=self._motions)
        try:
            run.run(duration_ns)
            found = run.outcome
            return SeedResult(
                seed,
                found.robot_s,
                found.real_s,
                found.frames,
                found.events,
                found.sha256,
                tuple(run.invariants.breaches),
                dict(run.player.troubles),
                run.invariants.coverage.walked,
                dict(run.invariants.troubled.cells),
            )
        finally:
            run.close()


_inherited: list[Campaign] = []  # of a process that runs seeds for another one


def _inherit(campaign: Campaign) -> None:
    """Keep the campaign that this process was forked with."""
    _inherited[:] = [campaign]


def _run_seed(seed: int) -> SeedResult:
    return _inherited[0].run_seed(seed)


def _broken(run: SimulationRun, rule: str) -> bool:
    return any(breach.rule == rule for breach in run.invariants.breaches)
