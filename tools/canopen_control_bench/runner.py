"""Families of figures by name, run one after the other; the table for users, and the JSON."""

from __future__ import annotations

import contextlib
import importlib
import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from canopen_control.errors import CanopenError
from canopen_control.runtime.realtime import keep_awake
from canopen_control_bench.history import kept_rows, row_of, slower_than_before
from canopen_control_bench.machine import describe

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path
    from types import ModuleType

    from canopen_control_bench.figure import Figure


#: family: its description; each is a module of this subpackage with `measure(options) -> list[Figure]`
FAMILIES = {
    "cycle": "two drives: CPU, lateness and wake-to-RPDO, compared with the canopen package and python-can",
    "scale": "from 2 to 126 drives, at the shortest period that fits a bus, and on several buses",
    "latency": "from a command to the wire, by API and ROS topic; from the wire to /joint_states",
    "clients": "effect of ROS bridge, view and monitor on the cycle",
    "idle": "CPU of a robot at rest: its runtime, its view with one browser and four",
    "load": "a full bus of 1 Mbit/s, received, decoded and supervised",
    "buses": "140,000 frames a second on one bus, and eight full ones: frames lost, CPU of hubs and listener",
    "motion": "trajectories: CPU of a cycle, long goals at 1 kHz, set-points of a host that is late",
    "physics": "a robot on a floor compared with the same run without; at rest, repeatability, slip",
    "simulate": "robots in virtual time compared with real time, 2 and 16 drives, and their boot",
    "memory": "memory after a million cycles; a cycle without a wire",
    "soak": "random commands and breaking drives, for a minute (--for 3600: an hour)",
    "boot": "from nothing to all drives operational, 2 and 64 of them",
    "start": "from the command line to wheels under command, and to the first /joint_states",
    "services": "SDO and EDS compared with the canopen package",
    "drive": "one drive on a paced bus: its first turn, its stops, a clone, a program",
    "bridge": "CPU of the ROS bridge compared with a node that only publishes; from a topic to the runtime",
    "import": "duration of --help and status, compared with a bare interpreter",
}
#: Families whose figures in a quick run do not depend on a clock or another process; they may run in parallel.
SIMULATED = ("motion", "physics", "simulate", "memory")
#: word: the families that it stands for
GROUPS = {
    "all": tuple(FAMILIES),
    "simulated": SIMULATED,
    "live": tuple(name for name in FAMILIES if name not in SIMULATED),
}
_MODULES = {"drive": "one_drive", "import": "imports", "simulate": "virtual_robots"}
# families that compare the CPU time of waiting programs: the cost of a wake-up depends on the machine
AWAKE = ("cycle", "scale", "services")
IDLE_ENOUGH = 0.9  # of all CPUs, before the first process starts


@dataclass(frozen=True, slots=True)
class Options:
    """How to measure: `quick` is for CI, `seconds` is the length of a long run, `say` reports progress.

    In the families of `AWAKE`, and in the pairs of `clients`, processors are kept awake, where this user may do that;
    there who is compared with others has one for itself. Not so `as_is`: what it takes to wake a
    processor, to wake another process on it, or to be put aside for one, is the machine's and differs threefold from
    turn to turn. Every contender is at its best so.
    """

    quick: bool = False
    seconds: float | None = None
    say: Callable[[str], None] = lambda _text: None
    as_is: bool = False


@dataclass(slots=True)
class Report:
    """The figures, place and time of a run; `failures` gives the reasons for families that failed.

    `last` is what an earlier run has seen, by family, figure and peer, and `last_run` which one that was; `slower` says
    what is worse than in the last run of this machine.
    """

    machine: dict[str, Any]
    figures: dict[str, list[Figure]]
    quick: bool = False
    failures: dict[str, str] = field(default_factory=dict)
    last: dict[tuple[str, str, str], float] = field(default_factory=dict)
    last_run: str = ""
    slower: list[str] = field(default_factory=list)

    def short(self) -> list[Figure]:
        """Return the figures that miss their limits; for a quick run only those that a busy machine does not affect."""
        return [figure for figures in self.figures.values() for figure in self._short_of(figures)]

    def fell_short(self) -> list[str]:
        """Return the families that have such a figure or could not be measured."""
        return [name for name, figures in self.figures.items() if self._short_of(figures)] + list(self.failures)

    def take(self, other: Report) -> None:
        """Replace families with those of another run."""
        for name in (*other.figures, *other.failures):
            self.failures.pop(name, None)
        self.figures.update(other.figures)
        self.failures.update(other.failures)

    def _short_of(self, figures: Sequence[Figure]) -> list[Figure]:
        return [figure for figure in figures if not figure.good and (figure.steady or not self.quick)]

    def put_beside(self, path: Path) -> None:
        """Show an earlier run's values from a file next to the new ones; a missing or invalid file is ignored."""
        self.slower = slower_than_before(kept_rows(path), self._row(), self.figures)
        try:
            found = json.loads(path.read_text())
            last_run = f"{found['machine']['date']}, {found['machine']['package']}"
            last = {
                (family, figure["name"], figure["peer_name"]): float(figure["ours"])
                for family, figures in found["figures"].items()
                for figure in figures
            }
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return
        self.last, self.last_run = last, last_run

    def write(self, path: Path) -> None:
        """Write it as JSON, appending a row of this run to the history in the file."""
        figures = {name: [figure.as_dict() for figure in figures] for name, figures in self.figures.items()}
        history = [*kept_rows(path), self._row()]
        found = {"machine": self.machine, "quick": self.quick, "figures": figures, "failures": self.failures}
        found["history"] = history
        path.write_text(json.dumps(found, indent=2) + "\n")

    def _row(self) -> dict[str, Any]:
        return row_of(self.machine, self.figures, quick=self.quick)

    def __str__(self) -> str:
        machine = self.machine
        idle = machine["idle"]
        busy = "" if idle is None or idle >= IDLE_ENOUGH else "; NOT IDLE: only ratios count"
        return "\n".join(
            [
                f"{machine['machine']}, {machine['kernel']}, {machine['python']}, "
                f"{machine['package']}, {machine['date']}",
                f"before the run: load {machine['load']}, {'?' if idle is None else f'{idle:.0%}'} idle{busy}; "
                f"niceness {machine['nice']}; processors {machine['processors']}",
                *([f"last: {self.last_run}"] if self.last_run else []),
                *(f"\n{name}\n{self._table(name, figures)}" for name, figures in self.figures.items() if figures),
                *(f"\n{name}\n  FAILED: {text}" for name, text in self.failures.items()),
                *(f"\nslower than before: {text}" for text in self.slower),
            ]
        )

    def _table(self, family: str, figures: Sequence[Figure]) -> str:
        if not self.last_run:
            return table(figures)
        return table(figures, [self.last.get((family, figure.name, figure.peer_name)) for figure in figures])


def run_families(names: Sequence[str], options: Options) -> Report:
    """Measure the families and return the report."""
    report = Report(describe(), {}, options.quick)
    report.machine["processors"] = "may sleep"
    for name in names:
        options.say(f"{name}: {FAMILIES[name]}")
        with contextlib.ExitStack() as undo:
            if name in AWAKE and not options.as_is:
                asleep = keep_awake(undo)
                report.machine["processors"] = f"may sleep ({asleep})" if asleep else f"awake for {', '.join(AWAKE)}"
            try:
                report.figures[name] = module_of(name).measure(options)
            except CanopenError as error:
                report.failures[name] = str(error)
    return report


def module_of(name: str) -> ModuleType:
    """Return the module of a family."""
    return importlib.import_module(f"canopen_control_bench.{_MODULES.get(name, name)}")


def table(figures: Sequence[Figure], last: Sequence[float | None] = ()) -> str:
    """Return figures as table rows, each followed by its other results; `last` holds our values of another run."""
    head = f"{'last':>12}" if last else ""
    lines = [f"  {'':<46}{head}{'ours':>12}{'peer':>12} {'unit':<6}{'ratio':>7}  must be"]
    told: object = None
    for number, figure in enumerate(figures):
        lines.append(_line(figure, _column(last[number]) if last else ""))
        if figure.absolutes and figure.absolutes != told:
            told = figure.absolutes
            lines.append("      " + ", ".join(f"{name} {_short(value)}" for name, value in figure.absolutes.items()))
    return "\n".join(lines)


def _column(value: float | None) -> str:
    return f"{'' if value is None else _short(value):>12}"


def _line(figure: Figure, last: str) -> str:
    name = f"{figure.name} / {figure.peer_name}" if figure.peer_name else figure.name
    peer = "" if figure.peer is None else _short(figure.peer)
    ratio = "" if figure.ratio is None else f"{figure.ratio:.2f}"
    must = "" if figure.limit is None else f"{figure.direction} {figure.limit:g}{'' if figure.good else '   SHORT'}"
    return f"  {name:<46}{last}{_short(figure.ours):>12}{peer:>12} {figure.unit:<6}{ratio:>7}  {must}".rstrip()


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}" if abs(value) < 1000 else f"{value:.0f}"
