"""The results of the seeds of a nightly campaign: stored as JSON, shown as a page of the documentation."""

from __future__ import annotations

import hashlib
import json
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from canopen_control.errors import ConfigError
from canopen_control.simulation.fault_coverage import STATES, Cell

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from canopen_control.simulation.campaign import SeedResult


SIMULATED: Final = "docs/reference/seeds.json"
REPAIRED: Final = {
    "forklift, seed 1582": "the observer was wrong: a count that turned on over the end of its 32 bits was taken for a "
    "jump; repaired, and kept as a test (`tests/simulation/test_status_invariants.py`)",
}
"""Causes of breaches that have been repaired since, by robot and seed."""


@dataclass(frozen=True, slots=True)
class Plan:
    """A robot, its seeds per night, the seconds of robot time for each seed, and whether it is on a floor."""

    robot: str
    seeds: int
    seconds: int
    physics: bool = False

    @property
    def name(self) -> str:
        """A description of the robot."""
        return f"{self.robot} on a floor" if self.physics else self.robot


@dataclass(slots=True)
class RobotResults:
    """The results of the first `seeds` seeds of a robot.

    `sha256` is that of the digests of all seeds in their order, `troubles` counts what went wrong in which state of the
    robot, `cells` in which of each node that it hit.
    """

    seeds: int = 0
    robot_s: float = 0.0
    real_s: float = 0.0
    frames: int = 0
    events: int = 0
    sha256: str = ""
    breaches: list[str] = field(default_factory=list)
    troubles: Counter[tuple[str, str]] = field(default_factory=Counter)
    cells: Counter[Cell] = field(default_factory=Counter)

    def add(self, result: SeedResult) -> None:
        """Add the result of the next seed."""
        self.seeds += 1
        self.robot_s += result.robot_s
        self.real_s += result.real_s
        self.frames += result.frames
        self.events += result.events
        self.sha256 = hashlib.sha256(f"{self.sha256}{result.sha256}".encode()).hexdigest()
        self.breaches += [f"seed {result.seed}: {breach.sentence}" for breach in result.breaches]
        self.troubles.update(result.troubles)
        self.cells.update(result.cells)


@dataclass(slots=True)
class Results:
    """The results of a night; `code` is the checksum of the package, `date` that of the last seed.

    `build` is how the package ran: "sources", "compiled" or "both", which changes the time that it takes and nothing
    else.
    """

    code: str
    plans: tuple[Plan, ...]
    robots: list[RobotResults] = field(default_factory=list)
    date: str = ""
    build: str = "sources"

    def __post_init__(self) -> None:
        """Add empty results for each robot that has none yet."""
        self.robots += [RobotResults() for _ in self.plans[len(self.robots) :]]

    @property
    def seeds(self) -> int:
        """The number of seeds run."""
        return sum(robot.seeds for robot in self.robots)

    @property
    def breaches(self) -> int:
        """The number of breaches."""
        return sum(len(robot.breaches) for robot in self.robots)

    @property
    def sentence(self) -> str:
        """A sentence on the progress."""
        hours = sum(robot.robot_s for robot in self.robots) / 3600
        real = sum(robot.real_s for robot in self.robots)
        return f"{self.seeds} seeds, {hours:.2f} hours of robots in {real:.0f} s, {self.breaches} breaches"


def write_results(path: Path, results: Results) -> None:
    """Write the results as JSON."""
    results.date = time.strftime("%Y-%m-%d", time.gmtime())
    document = {
        "code": results.code,
        "build": results.build,
        "date": results.date,
        "robots": [
            {
                "robot": plan.robot,
                "planned": plan.seeds,
                "seconds": plan.seconds,
                "physics": plan.physics,
                "seeds": robot.seeds,
                "robot_s": round(robot.robot_s, 3),
                "real_s": round(robot.real_s, 1),
                "frames": robot.frames,
                "events": robot.events,
                "sha256": robot.sha256,
                "breaches": robot.breaches,
                "troubles": [[kind, state, count] for (kind, state), count in sorted(robot.troubles.items())],
                "cells": [[*cell, count] for cell, count in sorted(robot.cells.items())],
            }
            for plan, robot in zip(results.plans, results.robots, strict=True)
        ],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def read_results(path: Path) -> Results:
    """Read results; empty if the file does not exist yet, ConfigError if its content is invalid."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        rows = document["robots"]
        plans = tuple(Plan(row["robot"], row["planned"], row["seconds"], row.get("physics", False)) for row in rows)
        build = document.get("build", "sources")
        return Results(document["code"], plans, [_robot_of(row) for row in rows], document["date"], build)
    except FileNotFoundError:
        return Results("", ())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(f"{path} holds no results of seeds: {error}; move it away") from None


def _robot_of(row: dict[str, Any]) -> RobotResults:
    troubles = Counter({(kind, state): count for kind, state, count in row["troubles"]})
    names = ("seeds", "robot_s", "real_s", "frames", "events", "sha256", "breaches")
    cells = Counter({(machine, state, kind): count for machine, state, kind, count in row.get("cells", ())})
    return RobotResults(**{name: row[name] for name in names}, troubles=troubles, cells=cells)


# -- the page

_BUILDS: Final = {
    "sources": "from the sources",
    "compiled": "with the modules of its cycle compiled",
    "both": "a part from the sources, the rest with the modules of its cycle compiled",
}
_HEAD: Final = """# Seeds of the nightly campaign

Results of the nightly campaign in virtual time, `tools/campaign --hours 1`, up to {date}: {seeds:,} of {planned:,}
seeds. Each seed has its own schedule of commands, stops, switches and failures
([a robot in virtual time](../guide/simulation.md)), and an observer checks the
[invariants](../guide/simulation.md#invariants). `tools/campaign --page` writes this page from `seeds.json`. All seeds
were run with one version of the package,
{build} (`{code}`: checksum of the package, the robots and the
EDS files). The times were measured on a computer that also ran other programs.

| robot | seeds | planned | each, s | hours of the robot | times real time | frames | breaches | SHA-256 of all |
|---|---|---|---|---|---|---|---|---|
"""
_TROUBLES: Final = """
## Injected failures, by the state of the robot

The tables count how often each kind of failure began while a robot was in a state: faults of drives by their name, and
failures of supplies, processes and buses.

"""


def page_of(results: Results) -> str:
    """Return the page of the documentation with the results."""
    return "".join(_parts(results))


def _parts(results: Results) -> Iterator[str]:
    planned = sum(plan.seeds for plan in results.plans)
    build = _BUILDS[results.build]
    yield _HEAD.format(date=results.date, seeds=results.seeds, planned=planned, code=results.code, build=build)
    rows = list(zip(results.plans, results.robots, strict=True))
    for plan, result in rows:
        speed = result.robot_s / result.real_s if result.real_s else 0.0
        yield (
            f"| {plan.name} | {result.seeds:,} | {plan.seeds:,} | {plan.seconds} | {result.robot_s / 3600:.2f} "
            f"| {speed:.0f} | {result.frames:,} | {len(result.breaches)} | `{result.sha256[:12]}` |\n"
        )
    yield from _breaches([f"{plan.name}, {text}" for plan, result in rows for text in result.breaches])
    troubles: Counter[tuple[str, str]] = sum((robot.troubles for robot in results.robots), Counter())
    states = sorted({state for _, state in troubles})
    yield _TROUBLES
    yield f"| | {' | '.join(states)} |\n|{'---|' * (len(states) + 1)}\n"
    for kind in sorted({kind for kind, _ in troubles}):
        counts = [f"{troubles[kind, state]:,}" if troubles[kind, state] else "" for state in states]
        yield f"| `{kind}` | {' | '.join(counts)} |\n"
    if cells := sum((robot.cells for robot in results.robots), Counter[Cell]()):
        yield from _cell_tables(cells)


_CELLS: Final = """
## Injected failures, by the states of the affected nodes

The tables count how often each kind of failure affected a node in a state of axis power, CiA 402, NMT and boot; a
failure of a bus or of the robot's process affects all its nodes. An empty cell means that the combination has not
occurred.
"""


def _cell_tables(cells: Counter[Cell]) -> Iterator[str]:
    yield _CELLS
    kinds = sorted({kind for _, _, kind in cells})
    for machine, states in STATES.items():
        yield f"\n| {machine} | {' | '.join(states)} |\n|{'---|' * (len(states) + 1)}\n"
        for kind in kinds:
            counts = (cells[machine, state, kind] for state in states)
            yield f"| `{kind}` | {' | '.join(f'{count:,}' if count else '' for count in counts)} |\n"


def _breaches(texts: Sequence[str]) -> Iterator[str]:
    yield "\n## Breaches\n\n"
    yield "".join(f"- {text}\n" for text in texts) or "None.\n"
    for seed, what in REPAIRED.items():
        if any(text.startswith(f"{seed}:") for text in texts):
            yield f"\n{seed[0].upper()}{seed[1:]}: {what}.\n"
