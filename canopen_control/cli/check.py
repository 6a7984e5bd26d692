"""Validate a robot's files, and report the load of its buses and its stopping times; no bus is opened.

The stopping time is the detection time plus the ramp from the joint's maximum speed. It is shown for the cause that
takes longest; --json lists all causes.

Exit codes: 0 success; 2 the files have errors, or wrong usage.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.cli.run import add_controller_argument, add_file_arguments, find_files
from canopen_control.cli.support.output import json_text, painted
from canopen_control.od.issues import Severity
from canopen_control.rpc.messages.declare import Document
from canopen_control.rpc.wire import attributes

if TYPE_CHECKING:
    import argparse

    from canopen_control.check.checker import CheckReport
    from canopen_control.check.stop_times import StopTime
    from canopen_control.master.budget import Budget


EXAMPLE = "canopen-control check robby"


class FindingDocument(Document, frozen=True):
    """Finding about a line of a file; `fix` is advice, or "" if `text` includes the advice."""

    path: str
    line: int
    column: int
    severity: Severity
    text: str
    fix: str


class FrameShare(Document, frozen=True):
    """Frame in a bus budget, with its number of data bytes and the number of such frames per cycle."""

    name: str
    cob_id: int
    length: int
    per_cycle: float


class BudgetDocument(Document, frozen=True, kw_only=True):
    """Load of a bus; a cycle has `bits` without stuff bits, and `worst_bits` with all possible stuff bits.

    `load` is the average load, from 0 to 1.
    """

    bitrate: int
    period_s: float
    bits: int
    worst_bits: int
    load: float
    shortest_period_s: float
    fits: bool
    frames: list[FrameShare]


class StopCaseDocument(Document, frozen=True):
    """Cause of a stop, with its detection time and ramp time in s; an unlimited ramp is infinite (null in JSON)."""

    cause: str
    detection_s: float
    ramp_s: float
    by: str


class StopDocument(Document, frozen=True):
    """Stopping time of a joint from `speed` in units of the drive; an unlimited time is infinite (null in JSON)."""

    joint: str
    node: str
    node_id: int
    speed: float
    longest_s: float
    cases: list[StopCaseDocument]


class CheckDocument(Document, frozen=True):
    """Document that `check --json` prints."""

    robot: str
    findings: list[FindingDocument]
    buses: dict[str, BudgetDocument]
    sync: dict[str, str]
    stops: list[StopDocument]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_file_arguments(parser, strict="exit with code 2 for warnings, too")
    parser.add_argument("--real", action="store_true", help="check the files for real drives")
    parser.add_argument("--mock", action="store_true", help="check the files for mock hardware: no drives and no bus")
    add_controller_argument(parser, "check the files for these active controllers (repeatable; default: the first)")
    parser.add_argument("--json", action="store_true", help="print findings, bus loads and stopping times as JSON")


def run(args: argparse.Namespace) -> int:
    """Print the findings; return 2 if there are errors (with --strict also for warnings), else 0."""
    from canopen_control.check.checker import CheckOptions, check_robot
    from canopen_control.runtime.robot_files import find_launch

    files = find_files(args)
    options = CheckOptions(
        controllers=args.controller,
        can=args.can,
        mock=args.mock,
        real=args.real,
        peer_merge=args.peer_merge,
        allow_unsupervised=args.allow_unsupervised,
        launch=find_launch(args.launch) if args.launch else None,
    )
    report = check_robot(files, options)
    if args.json:
        print(json_text(_document(files.name, report)))
    else:
        print("\n".join(painted(_lines(files.name, report))))
    return 0 if report.passes(strict=args.strict) else 2


def _document(name: str, report: CheckReport) -> CheckDocument:
    return CheckDocument(
        name,
        attributes(report.findings, list[FindingDocument]),
        {bus: _budget(budget) for bus, budget in report.budgets.items()},
        report.sync,
        [_stop(stop) for stop in report.stops],
    )


def _stop(stop: StopTime) -> StopDocument:
    facts = stop.facts
    cases = attributes(stop.cases, list[StopCaseDocument])
    return StopDocument(facts.joint, facts.node, facts.node_id, facts.speed, stop.longest_s, cases)


def _budget(budget: Budget) -> BudgetDocument:
    return BudgetDocument(
        bitrate=budget.bitrate,
        period_s=budget.period_ns / 1e9,
        bits=budget.bits,
        worst_bits=budget.worst_bits,
        load=budget.load,
        shortest_period_s=budget.shortest_period_ns / 1e9,
        fits=budget.fits,
        frames=attributes(budget.shares, list[FrameShare]),
    )


def _lines(name: str, report: CheckReport) -> list[str]:
    lines = [str(finding) for finding in report.findings]
    lines += [_budget_line(bus, budget) for bus, budget in report.budgets.items()]
    lines += [f"bus {bus}: {words}" for bus, words in report.sync.items()]
    lines += [stop.words for stop in report.stops]
    counts = [(report.count(severity), severity.value) for severity in Severity]
    summary = ", ".join(f"{count} {word}{'s' if count > 1 else ''}" for count, word in counts if count)
    return [*lines, f"{name}: {summary or 'nothing is wrong'}"]


def _budget_line(bus: str, budget: Budget) -> str:
    return (
        f"bus {bus}: {budget.bits} to {budget.worst_bits} bits in a cycle of {budget.period_ns / 1e6:g} ms, load "
        f"{budget.load:.1%} of {budget.bitrate // 1000} kbit/s, shortest possible period "
        f"{budget.shortest_period_ns / 1e6:.2f} ms"
    )
