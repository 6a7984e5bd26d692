"""Campaigns of `simulate` over many seeds: progress, violated invariants (breaches), files and summary."""

from __future__ import annotations

import contextlib
import shlex
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.output import Progress, json_line
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.simulation.campaign import (
    Campaign,
    Totals,
    html_summary,
    junit_summary,
    make_folder,
    write_breach,
    write_text,
)
from canopen_control.simulation.fault_coverage import cells_words, coverage_words

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.campaign import SeedResult


_SHRUNK: Final = 5  # breaches of a campaign that are shrunk: each takes a hundred simulations
_INTERRUPTED: Final = 130  # the exit code that shells use for Ctrl-C


@dataclass(frozen=True, slots=True)
class CampaignOrder:
    """Parameters of a campaign: `seeds` of `duration_ns` each are run in `jobs` processes.

    `words` are the robot options of the command line. `dask` is the address of a cluster that runs the seeds instead.
    `aim` is the number of further seeds, for states that the first seeds did not cover. Breaches and the summary are
    written to `folder`; if None and there are breaches, to a folder with the robot's name.
    """

    seeds: range
    duration_ns: int
    faults: Sequence[str]
    words: Sequence[str]
    jobs: int = 1
    folder: Path | None = None
    as_json: bool = False
    dask: str | None = None
    aim: int = 0


@dataclass(frozen=True, slots=True)
class CampaignDocument:
    """Result of a campaign in `--json`: simulated time, breaches, and the files of written scenarios."""

    seeds: int
    robot_s: float
    real_s: float
    frames: int
    breaches: tuple[str, ...]
    scenarios: tuple[str, ...]


def run_campaign(setup: RobotSetup, order: CampaignOrder, folder: Path) -> int:
    """Run seeds, shrink failing ones, print the result; return 1 after a breach or error, 130 after Ctrl-C.

    A robot that fails even without injected faults is reported once; then no seed is run, and 1 is returned.
    """
    if order.folder is not None:
        make_folder(order.folder)  # before the seeds, which may take hours
    start = time.perf_counter()
    campaign = Campaign(setup, order.duration_ns, order.faults)
    totals = Totals()
    if never := campaign.start_failure():
        print(f"canopen-control: {never}", file=sys.stderr)
        return 1
    code, problem = _run(campaign, order.seeds, order, totals)
    if order.aim and code == 0:
        further = range(order.seeds.stop, order.seeds.stop + order.aim)
        code, problem = _run(campaign, campaign.aim(further, totals.cells), order, totals)
    scenarios = _shrink(campaign, setup, totals, order, folder)
    if totals.broken or order.folder is not None:
        write_text(folder / "junit.xml", junit_summary(setup.name, totals))
        write_text(folder / "summary.html", html_summary(setup.name, totals))
    _sum_up(totals, scenarios, time.perf_counter() - start, order)
    if problem:
        print(f"canopen-control: {problem}", file=sys.stderr)
    return 1 if totals.broken else code


def _run(campaign: Campaign, seeds: Sequence[int], order: CampaignOrder, totals: Totals) -> tuple[int, str]:
    """Run seeds and print their breaches; return the exit code, and the reason for an early end or ""."""
    with Progress("seeds", stream=sys.stderr) as progress:
        try:
            for result in _results(campaign, seeds, order, progress):
                totals.add(result)
                progress.at(len(totals.results), len(order.seeds) + order.aim)
                for breach in result.breaches:
                    _print(f"seed {result.seed}: {breach.sentence}", progress, order)
        except ConfigError:
            raise
        except CanopenError as error:
            return 1, str(error)
        except KeyboardInterrupt:
            return _INTERRUPTED, f"interrupted: {len(totals.results)} of {len(order.seeds) + order.aim} seeds were run"
    return 0, ""


def _results(
    campaign: Campaign, seeds: Sequence[int], order: CampaignOrder, progress: Progress
) -> Iterator[SeedResult]:
    if order.dask is None:
        return campaign.run(seeds, order.jobs)
    from canopen_control.simulation.cluster import run_on_cluster

    return run_on_cluster(campaign, seeds, order.dask, lambda text: _note(text, progress))


def _note(text: str, progress: Progress) -> None:
    progress.end()
    print(f"canopen-control: {text}", file=sys.stderr)


def _shrink(
    campaign: Campaign, setup: RobotSetup, totals: Totals, order: CampaignOrder, folder: Path
) -> tuple[str, ...]:
    """Write the minimal schedules of the first failing seeds; return the paths of these files."""
    command = shlex.join(["canopen-control", "simulate", *order.words])
    written: list[str] = []
    with contextlib.suppress(KeyboardInterrupt), Progress("shrinking", "tries", stream=sys.stderr) as progress:
        for result in totals.broken[:_SHRUNK]:
            acts = campaign.shrink(result, progress.at)
            path = write_breach(folder, setup, result, acts, campaign.length_of(acts), command)
            written.append(str(path))
            _print(
                f"seed {result.seed}: shrunk to {len(acts)} acts: {command} --scenario {shlex.quote(str(path))}",
                progress,
                order,
            )
    return tuple(written)


def _print(line: str, progress: Progress, order: CampaignOrder) -> None:
    if not order.as_json:
        progress.end()
        print(line)


def _sum_up(totals: Totals, scenarios: tuple[str, ...], real_s: float, order: CampaignOrder) -> None:
    count, hours = len(totals.results), totals.robot_s / 3600
    if order.as_json:
        breaches = tuple(f"seed {run.seed}: {breach.sentence}" for run in totals.broken for breach in run.breaches)
        print(json_line(CampaignDocument(count, totals.robot_s, round(real_s, 3), totals.frames, breaches, scenarios)))
        return
    print(
        f"{count} seeds, {hours:.2f} hours of the robot in {real_s:.1f} s, {totals.frames} frames, "
        f"{len(totals.broken)} with breaches"
    )
    print(f"edges walked: {coverage_words(totals.edges)}")
    if order.faults:
        print(f"faults by state: {cells_words(totals.cells, order.faults)}")
