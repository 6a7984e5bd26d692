"""`check`: everything wrong with a robot's files, and what its buses have to carry; opens nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.run import add_robot_arguments

if TYPE_CHECKING:
    import argparse

    from canopen_control.master.budget import Budget
    from canopen_control.runtime.check import CheckReport

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "canopen-control check robby"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_robot_arguments(parser)
    parser.add_argument("--launch", metavar="FILE", help="a ROS launch file in XML, to be held against the rest")
    parser.add_argument("--json", action="store_true", help="findings and budgets as JSON")


def run(args: argparse.Namespace) -> int:
    """Print what was found; 0 good, 2 for errors, with --strict for warnings too."""
    from canopen_control.runtime.check import CheckOptions, check_robot
    from canopen_control.runtime.files import find_robot

    files = find_robot(args.config, bus=args.bus, controllers=args.controllers, description=args.description)
    options = CheckOptions(
        controllers=args.controller,
        can=args.can,
        mock=args.mock,
        real=args.real,
        peer_merge=args.peer_merge,
        launch=Path(args.launch) if args.launch else None,
    )
    report = check_robot(files, options)
    if args.json:
        print(json.dumps(_as_dict(files.name, report), indent=2))
    else:
        print("\n".join(_lines(files.name, report)))
    return 0 if report.passes(strict=args.strict) else 2


def _as_dict(name: str, report: CheckReport) -> dict[str, object]:
    return {
        "robot": name,
        "findings": [finding.as_dict() for finding in report.findings],
        "buses": {bus: budget.as_dict() for bus, budget in report.budgets.items()},
    }


def _lines(name: str, report: CheckReport) -> list[str]:
    from canopen_control.runtime.finding import Severity

    lines = [str(finding) for finding in report.findings]
    lines += [_budget_line(bus, budget) for bus, budget in report.budgets.items()]
    counts = [(report.count(severity), severity.value) for severity in Severity]
    said = ", ".join(f"{count} {word}{'s' if count > 1 else ''}" for count, word in counts if count)
    return [*lines, f"{name}: {said or 'nothing is wrong'}"]


def _budget_line(bus: str, budget: Budget) -> str:
    return (
        f"bus {bus}: {budget.bits} to {budget.worst_bits} bits in a cycle of {budget.period_ns / 1e6:g} ms, load "
        f"{budget.load:.1%} of {budget.bitrate // 1000} kbit/s, shortest possible period "
        f"{budget.shortest_period_ns / 1e6:.2f} ms"
    )
