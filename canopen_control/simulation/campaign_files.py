"""Output files of a campaign: scenario and frames of each breach, and a summary as JUnit and HTML."""

from __future__ import annotations

import contextlib
import errno
import os
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Final
from xml.sax.saxutils import escape as xml
from xml.sax.saxutils import quoteattr

from canopen_control.bus.recordings import RecordingWriter
from canopen_control.frame import frames_of
from canopen_control.host.files import failed
from canopen_control.simulation.fault_coverage import STATES, coverage_words, left_out
from canopen_control.simulation.scenario_steps import scenario_text
from canopen_control.simulation.simulation_run import SimulationRun

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.campaign import SeedResult, Totals
    from canopen_control.simulation.fault_coverage import Edge
    from canopen_control.simulation.scenario_events import ScenarioEvent


_STYLE: Final = "body{font:14px sans-serif;margin:2em}td,th{padding:.1em .6em;text-align:right}"


def write_breach(
    folder: Path, setup: RobotSetup, result: SeedResult, acts: Sequence[ScenarioEvent], duration_ns: int, command: str
) -> Path:
    """Write scenario and frames of a breach; return the scenario's path. ConfigError on failure.

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
    """Write a text file, creating its folder if necessary; raise ConfigError on failure."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise failed(path, error, "nothing was written") from error


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
