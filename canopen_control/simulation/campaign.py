"""Simulation campaign: random schedules of many seeds, minimised schedules for violated invariants, and output files.

Seeds run in worker processes; if a worker dies, the seeds without a result run in this process. The results do not
depend on the number of processes or on the order.

The output files are scenario and frames of each breach, and a summary as JUnit and HTML.
"""

from __future__ import annotations

import contextlib
import errno
import multiprocessing
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import partial
from html import escape
from random import Random
from typing import TYPE_CHECKING, Final, TypeVar
from xml.sax.saxutils import escape as xml
from xml.sax.saxutils import quoteattr

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.cia402.state import State
from canopen_control.frame import frames_of
from canopen_control.host.files import failed, telling, write_whole
from canopen_control.runtime.core import RobotState
from canopen_control.simulation.fault_coverage import (
    BOOT,
    DRIVE,
    NMT,
    POWER,
    STATES,
    cells_of,
    coverage_words,
    left_out,
)
from canopen_control.simulation.motions import motions_of
from canopen_control.simulation.random_schedule import draw_schedule
from canopen_control.simulation.robot_under_test import MASTER
from canopen_control.simulation.scenario_events import KINDS
from canopen_control.simulation.scenario_steps import scenario_text
from canopen_control.simulation.simulation_run import SimulationRun
from canopen_control.virtual.scenario import ScenarioEvent

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.fault_coverage import Edge


if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.fault_coverage import Cell, Edge
    from canopen_control.simulation.invariants import Breach
    from canopen_control.simulation.motions import SampleMotion

    Acts = tuple[ScenarioEvent, ...]


T = TypeVar("T")

# Targeted schedules: each leads the robot into a state and injects a fault there, which random schedules rarely do,
# such as a cable cut in the cycle in which an axis is disabled. `_WAYS` is the table of paths into states; states
# without a path by client requests (homing, stops that drives do not execute) have no row.


_MS: Final = 1_000_000
AIMED_NS: Final = 7_000 * _MS
"""Minimum duration of a targeted schedule."""
_MOVES_NS: Final = 700 * _MS  # start of the commands
_LEAD_NS: Final = 1500 * _MS  # start of the path into the state
_BACK_NS: Final = 2500 * _MS  # start of the path back
_MENDED_NS: Final = 4_000 * _MS

_UP: Final = ("disable", _BACK_NS)
_WAYS: Final[Mapping[tuple[str, str], tuple[str, int]]] = {
    (POWER, "DISABLED"): ("disable", _LEAD_NS),
    (POWER, "SWITCHING_ON"): _UP,
    (POWER, "ENABLING"): _UP,
    (POWER, "ENABLED"): _UP,
    (POWER, "READY"): _UP,
    (POWER, "FOLLOWING"): ("", _LEAD_NS),
    (POWER, "HALTED"): ("halt", _LEAD_NS),
    (POWER, "RAMPING_DOWN"): ("stop", _LEAD_NS),
    (POWER, "AWAITING_STANDSTILL"): ("stop", _LEAD_NS),
    (POWER, "DISABLING"): ("stop", _LEAD_NS),
    (POWER, "QUICK_STOPPING"): ("quick-stop", _LEAD_NS),
    (POWER, "QUICK_STOPPED"): ("quick-stop", _LEAD_NS),
    (DRIVE, State.SWITCH_ON_DISABLED.name): ("disable", _LEAD_NS),
    (DRIVE, State.READY_TO_SWITCH_ON.name): _UP,
    (DRIVE, State.SWITCHED_ON.name): _UP,
    (DRIVE, State.OPERATION_ENABLED.name): ("", _LEAD_NS),
    (DRIVE, State.QUICK_STOP_ACTIVE.name): ("quick-stop", _LEAD_NS),
    (DRIVE, State.FAULT_REACTION_ACTIVE.name): ("fault", _LEAD_NS),
    (DRIVE, State.FAULT.name): ("fault", _LEAD_NS),
    (NMT, "OPERATIONAL"): ("", _LEAD_NS),
    (NMT, "PRE_OPERATIONAL"): ("nmt 128", _LEAD_NS),
    (NMT, "STOPPED"): ("nmt 2", _LEAD_NS),
    (BOOT, "READY"): ("", _LEAD_NS),
    (BOOT, "BOOTING"): ("power", _LEAD_NS),
    (BOOT, "WAITING"): ("power", _LEAD_NS),
}
"""Path to each state, and the time from which the fault waits for the state."""


def cells_to_aim_at(hit: Container[Cell], faults: Sequence[str], most: int) -> list[Cell]:
    """Return at most `most` uncovered cells that a targeted schedule can reach, spread evenly over the table."""
    empty = [cell for cell in cells_of(faults) if cell not in hit and cell[:2] in _WAYS]
    return [empty[number * len(empty) // most] for number in range(most)] if len(empty) > most else empty


def targeted_schedule(
    seed: int, cell: Cell, motions: Sequence[SampleMotion], nodes: Sequence[int]
) -> tuple[ScenarioEvent, ...]:
    """Return a schedule that injects the fault of `cell` in the state of `cell`; `seed` determines the details."""
    machine, state, kind = cell
    draw = Random(f"{seed}/aimed").random
    way, armed = _WAYS[machine, state]
    node = str(nodes[int(draw() * len(nodes))])
    acts = [
        *_commands(motions, draw()),
        *_state_events(way, node),
        _fault_event(kind, f"{machine} {state}", node, armed, draw()),
    ]
    acts += [
        ScenarioEvent(_MENDED_NS, "axis", name="fault-reset"),
        ScenarioEvent(_MENDED_NS + 300 * _MS, "axis", name="enable"),
    ]
    return tuple(sorted(acts, key=lambda act: act.at_ns))


def _commands(motions: Sequence[SampleMotion], drawn: float) -> list[ScenarioEvent]:
    """Return commands before and after the fault; empty if no controller that starts active moves joints."""
    motion = next((candidate for candidate in motions if candidate.starts), None)
    if motion is None:
        return []
    values = tuple(round(low + (high - low) * (0.1 + 0.9 * drawn), 3) for low, high in motion.ranges)
    lasting = ((_MOVES_NS, _BACK_NS + 500 * _MS), (_MENDED_NS + 900 * _MS, AIMED_NS - 1000 * _MS))
    return [
        ScenarioEvent(at, motion.kind, motion.controller, values=values, for_ns=until - at) for at, until in lasting
    ]


def _state_events(way: str, node: str) -> list[ScenarioEvent]:
    """Return the events that bring the robot into a state of an axis, and back to operation."""
    again = [
        ScenarioEvent(_BACK_NS - 100 * _MS, "axis", name="fault-reset"),
        ScenarioEvent(_BACK_NS, "axis", name="enable"),
    ]
    if way in ("disable", "halt", "quick-stop"):
        return [ScenarioEvent(_LEAD_NS, "axis", name=way), *again]
    if way == "stop":
        return [ScenarioEvent(_LEAD_NS, "stop"), *again]
    if way == "fault":
        return [ScenarioEvent(_LEAD_NS, "fault", node, "drive_fault", for_ns=300 * _MS), *again]
    if way == "power":
        return [ScenarioEvent(_LEAD_NS, "power", node, for_ns=900 * _MS), *again]
    if way.startswith("nmt"):
        return [ScenarioEvent(_LEAD_NS, "frame", values=(0.0, float(way.split()[1]), float(node))), *again]
    return []


def _fault_event(kind: str, when: str, node: str, armed: int, drawn: float) -> ScenarioEvent:
    """Return the fault event; the player delays it until the state `when` is reached."""
    lasts = (50 + int(1000 * drawn)) * _MS
    if kind not in KINDS:
        return ScenarioEvent(armed, "fault", node, kind, for_ns=lasts, when=when)
    if kind == "frame":
        return ScenarioEvent(armed, kind, values=(0x580 + float(node), 128.0), when=when)
    target = {"node": node, "member": MASTER if drawn < 0.3 and kind != "power" else node}.get(KINDS[kind].target, "")
    values = (float(1 + int(3 * drawn)),) if KINDS[kind].values else ()
    return ScenarioEvent(armed, kind, target, values=values, for_ns=lasts, when=when)


# Minimisation of a schedule that breaks an invariant: parts are removed, halves before single events (delta debugging);
# then durations and start times are halved while the same rule still breaks. The number of tries is limited.


MAX_TRIES: Final = 150
_FIRST_NS: Final = 600_000_000  # the robot boots until then
_SHORT_NS: Final = 20_000_000


class Shrinker:
    """Search for the smallest schedule for which `breaks(acts)` is true; `tries` counts the calls."""

    def __init__(self, breaks: Callable[[Acts], bool], most: int = MAX_TRIES) -> None:
        self.tries = 0
        self._breaks, self._max = breaks, most

    def shrink(self, acts: Sequence[ScenarioEvent]) -> Acts:
        """Return the smallest schedule found that breaks the rule; in the worst case, `acts` itself."""
        smallest = tuple(acts)
        while (smaller := self._round(smallest)) != smallest:
            smallest = smaller
        return smallest

    def _round(self, acts: Acts) -> Acts:
        return self._shorten(self._drop(acts))

    def _still(self, acts: Acts) -> bool:
        if self.tries >= self._max:
            return False
        self.tries += 1
        return self._breaks(acts)

    def _drop(self, acts: Acts) -> Acts:
        """Remove events, in progressively smaller groups, as long as the rule is still broken."""
        size = max(1, len(acts) // 2)
        while acts:
            at = 0
            while at < len(acts):
                fewer = acts[:at] + acts[at + size :]
                if self._still(fewer):
                    acts = fewer
                else:
                    at += size
            if size == 1:
                break
            size //= 2
        return acts

    def _shorten(self, acts: Acts) -> Acts:
        """Halve the durations of events, and the times between events, as long as the rule is still broken."""
        for number in range(len(acts)):
            for changed in self._shorter(acts, number):
                if self._still(changed):
                    acts = changed
        return acts

    def _shorter(self, acts: Acts, number: int) -> Iterator[Acts]:
        act = acts[number]
        if act.for_ns is not None and act.for_ns > _SHORT_NS:
            yield (*acts[:number], replace(act, for_ns=_whole(act.for_ns // 2)), *acts[number + 1 :])
        before = acts[number - 1].at_ns if number else _FIRST_NS
        gap = act.at_ns - before
        if gap > _SHORT_NS:
            cut = _whole(gap // 2)
            yield (*acts[:number], *(replace(act, at_ns=act.at_ns - cut) for act in acts[number:]))


def _whole(time_ns: int) -> int:
    """Round a time in ns down to whole ms."""
    return time_ns // 1_000_000 * 1_000_000


_TO_RUN_NS: Final = 20_000_000_000  # an undisturbed robot is running after this time
_AFTER_NS: Final = 3_000_000_000  # duration of a minimised schedule after its last event


@dataclass(frozen=True, slots=True)
class SeedResult:
    """Result of one seed; `troubles` counts the faults by kind and state of the robot.

    `edges` counts the transitions of the state machines, `cells` the kinds of faults by the states in which they
    occurred.
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
    """Results of a campaign by seed, with their sums."""

    results: dict[int, SeedResult] = field(default_factory=dict)

    def add(self, result: SeedResult) -> None:
        self.results[result.seed] = result

    @property
    def broken(self) -> list[SeedResult]:
        """Results with breaches, in order of their seeds."""
        return [result for _, result in sorted(self.results.items()) if result.breaches]

    @property
    def robot_s(self) -> float:
        """Simulated time of all seeds in s."""
        return sum(result.robot_s for _, result in sorted(self.results.items()))

    @property
    def frames(self) -> int:
        return sum(result.frames for result in self.results.values())

    @property
    def troubles(self) -> Counter[tuple[str, str]]:
        """Number of faults by kind and state of the robot, in all seeds."""
        return _sum(result.troubles for _, result in sorted(self.results.items()))

    @property
    def edges(self) -> Counter[Edge]:
        """Number of occurrences of each transition of the state machines, in all seeds."""
        return _sum(result.edges for _, result in sorted(self.results.items()))

    @property
    def cells(self) -> Counter[Cell]:
        """Number of faults by state machine, state and kind, in all seeds."""
        return _sum(result.cells for _, result in sorted(self.results.items()))


def _sum(counts: Iterable[Mapping[T, int]]) -> Counter[T]:
    total: Counter[T] = Counter()
    for count in counts:
        total.update(count)
    return total


class Campaign:
    """Campaign of simulations on a robot, one of `duration_ns` per seed; `tries` limits the minimisation."""

    def __init__(self, setup: RobotSetup, duration_ns: int, faults: Sequence[str], tries: int = MAX_TRIES) -> None:
        self._tries = tries
        self._setup, self._duration_ns, self._faults = setup, duration_ns, list(faults)
        self._motions: Sequence[SampleMotion] = motions_of(setup)
        self._aims: dict[int, Cell] = {}
        self._nodes = [node.node_id for bus in setup.joined.values() for node in bus.nodes.values()]

    def aim(self, seeds: Sequence[int], hit: Container[Cell]) -> list[int]:
        """Assign uncovered cells (a state and a fault) to seeds; return the seeds that have a cell."""
        cells = cells_to_aim_at(hit, self._faults, len(seeds)) if self._nodes else []
        self._aims.update(zip(seeds, cells, strict=False))
        return list(seeds[: len(cells)])

    def schedule(self, seed: int) -> tuple[ScenarioEvent, ...]:
        """Return the random or targeted schedule of a seed."""
        if seed in self._aims:
            return targeted_schedule(seed, self._aims[seed], self._motions, self._nodes)
        return draw_schedule(seed, self._duration_ns, self._motions, self._nodes, self._faults)

    def start_failure(self) -> str:
        """Return why the undisturbed robot never reaches RUNNING, or "" if it does."""
        run = SimulationRun(self._setup, 0, (), motions=self._motions)
        most = max(self._duration_ns, _TO_RUN_NS)
        try:
            run.run(most, stop=lambda: run.robot.core.has_run or run.robot.core.state is RobotState.STOPPED)
            return run.start_failure(most)
        finally:
            run.close()

    def run(self, seeds: Sequence[int], jobs: int) -> Iterator[SeedResult]:
        """Simulate the seeds in `jobs` processes; yield the results in the order of completion."""
        if jobs == 1:
            yield from map(self.run_seed, seeds)
            return
        done: set[int] = set()
        # with fork the robot's files, which are not picklable, need not be read again
        context = multiprocessing.get_context("fork")
        try:
            with ProcessPoolExecutor(jobs, mp_context=context, initializer=_inherit, initargs=(self,)) as pool:
                for result in pool.map(_run_seed, seeds):
                    done.add(result.seed)
                    yield result
        except BrokenProcessPool:
            yield from map(self.run_seed, [seed for seed in seeds if seed not in done])

    def run_seed(self, seed: int) -> SeedResult:
        least = AIMED_NS if seed in self._aims else 0
        return self._result(seed, self.schedule(seed), max(self._duration_ns, least))

    def shrink(
        self, result: SeedResult, hear: Callable[[int], object] = lambda _tries: None
    ) -> tuple[ScenarioEvent, ...]:
        """Return the smallest schedule found that breaks the first broken rule; `hear` receives the number of tries."""
        rule = result.breaches[0].rule

        def breaks(acts: tuple[ScenarioEvent, ...]) -> bool:
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

    def length_of(self, acts: Sequence[ScenarioEvent]) -> int:
        """Return the duration in ns of a schedule's simulation, which ends 3 s after the schedule's last event."""
        return max((act.at_ns + (act.for_ns or 0) for act in acts), default=0) + _AFTER_NS

    def _result(self, seed: int, acts: Sequence[ScenarioEvent], duration_ns: int) -> SeedResult:
        run = SimulationRun(self._setup, seed, acts, motions=self._motions)
        try:
            run.run(duration_ns)
            outcome = run.outcome
            return SeedResult(
                seed,
                outcome.robot_s,
                outcome.real_s,
                outcome.frames,
                outcome.events,
                outcome.sha256,
                tuple(run.invariants.breaches),
                dict(run.player.troubles),
                run.invariants.coverage.walked,
                dict(run.invariants.fault_coverage.cells),
            )
        finally:
            run.close()


_inherited: list[Campaign] = []  # in a worker process


def _inherit(campaign: Campaign) -> None:
    _inherited[:] = [campaign]


def _run_seed(seed: int) -> SeedResult:
    return _inherited[0].run_seed(seed)


def _broken(run: SimulationRun, rule: str) -> bool:
    return any(breach.rule == rule for breach in run.invariants.breaches)


_STYLE: Final = "body{font:14px sans-serif;margin:2em}td,th{padding:.1em .6em;text-align:right}"


def write_breach(
    folder: Path, setup: RobotSetup, result: SeedResult, acts: Sequence[ScenarioEvent], duration_ns: int, command: str
) -> Path:
    """Write the scenario and the frames of a breach; return the scenario's path, or raise ConfigError on failure.

    `command` is the command that replays the scenario, without the file name.
    """
    path = folder / f"{setup.name}-seed{result.seed}.yml"
    note = f"{result.breaches[0].sentence}\n# {command} --scenario {path}"
    write_text(path, scenario_text(acts, seed=result.seed, duration_ns=duration_ns, note=note))
    run = SimulationRun(setup, result.seed, acts)
    with contextlib.ExitStack() as stack:
        stack.callback(run.close)
        for name, wire in run.robot.wires.items():
            writer = stack.enter_context(RecordingWriter(folder / f"{path.stem}-{name}.log", name))
            wire.listeners.append(partial(_record, writer))
        run.run(duration_ns)
    return path


def _record(writer: RecordingWriter, now: int, _label: str, record: bytes) -> None:
    for frame in frames_of(record):
        writer.write(now, frame)


def make_folder(folder: Path) -> None:
    """Create a folder for output files if necessary; raise ConfigError if it is not writable."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise failed(folder, error, "nothing was written") from error


def write_text(path: Path, text: str) -> None:
    """Write a text file, creating its folder if necessary; raise ConfigError or DiskFull on failure."""
    with telling(path, "nothing was written"):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, text.encode())


def junit_summary(robot: str, totals: Totals) -> str:
    """Return the results of a campaign as JUnit XML with one test case per seed."""
    cases = "".join(_case(robot, result) for _, result in sorted(totals.results.items()))
    count = f'tests="{len(totals.results)}" failures="{len(totals.broken)}"'
    seconds = sum(result.real_s for result in totals.results.values())
    return (
        f'<?xml version="1.0" encoding="utf-8"?>\n<testsuite name={quoteattr(f"simulate {robot}")} {count} '
        f'time="{seconds:.3f}">\n{cases}</testsuite>\n'
    )


def _case(robot: str, result: SeedResult) -> str:
    head = f'<testcase classname={quoteattr(robot)} name="seed {result.seed}" time="{result.real_s:.3f}"'
    if not result.breaches:
        return f"{head}/>\n"
    text = "\n".join(breach.sentence for breach in result.breaches)
    return f"{head}><failure message={quoteattr(result.breaches[0].sentence)}>{xml(text)}</failure></testcase>\n"


def html_summary(robot: str, totals: Totals) -> str:
    """Return the results of a campaign as an HTML page: breaches, faults by state, state transitions."""
    states = sorted({state for _, state in totals.troubles})
    kinds = sorted({kind for kind, _ in totals.troubles})
    head = "".join(f"<th>{escape(heading)}</th>" for heading in ("", *states))
    rows = "".join(f"<tr>{_cells(kind, states, totals)}</tr>\n" for kind in kinds)
    breaches = "".join(
        f"<li>seed {heading.seed}: {escape(breach.sentence)}</li>\n"
        for heading in totals.broken
        for breach in heading.breaches
    )
    edges = totals.edges
    walked = "".join(f"<tr>{_edge(edge, edges[edge])}</tr>\n" for edge in sorted({*edges, *left_out(edges)}))
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>simulate {escape(robot)}</title>
<style>{_STYLE}</style>
<h1>{escape(robot)}</h1>
<p>{len(totals.results)} schedules, {totals.robot_s / 3600:.2f} hours of the robot, {totals.frames} frames,
{len(totals.broken)} seeds with breaches</p>
<h2>Breaches</h2><ul>{breaches or "<li>none</li>"}</ul>
<h2>Faults by the state of the robot</h2>
<table><tr>{head}</tr>
{rows}</table>
<h2>Faults by the states of the affected nodes</h2>
{_cell_tables(totals)}
<h2>Transitions of the state machines</h2>
<p>{escape(coverage_words(edges))}</p>
<table><tr><th>machine</th><th>state</th><th>trigger or next state</th><th>count</th></tr>
{walked}</table></html>
"""


def _cell_tables(totals: Totals) -> str:
    """Return one HTML table per state machine with the number of faults by kind and state."""
    cells = totals.cells
    kinds = sorted({kind for _, _, kind in cells})
    tables = ""
    for machine, states in STATES.items():
        head = "".join(f"<th>{escape(heading)}</th>" for heading in (machine, *states))
        rows = "".join(
            f"<tr>{_counts(kind, [cells[machine, heading, kind] for heading in states])}</tr>\n" for kind in kinds
        )
        tables += f"<table><tr>{head}</tr>\n{rows}</table>\n"
    return tables


def _cells(kind: str, states: Sequence[str], totals: Totals) -> str:
    return _counts(kind, [totals.troubles[kind, state] for state in states])


def _counts(kind: str, counts: Sequence[int]) -> str:
    return "".join(f"<td>{cell}</td>" for cell in (escape(kind), *(cell or "" for cell in counts)))


def _edge(edge: Edge, count: int) -> str:
    return "".join(f"<td>{escape(cell)}</td>" for cell in (*edge, str(count) if count else "not covered"))
