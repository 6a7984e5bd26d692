"""The options of the bench: which families are measured, printed, checked and stored."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from pathlib import Path

from canopen_control.cli.support.arguments import add_duration
from canopen_control.errors import ConfigError
from canopen_control.host.signals import interrupt, on_signals
from canopen_control_bench.runner import FAMILIES, GROUPS, Options, run_families


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command-line options."""
    families = "\n".join(f"  {name:<10} {text}" for name, text in FAMILIES.items())
    parser.epilog = f"families:\n{families}\n\n{parser.epilog or ''}"
    parser.add_argument(
        "family",
        nargs="*",
        type=_family,
        metavar="FAMILY",
        help="families below, or all; simulated: those that may run in parallel; live: the rest (default: cycle)",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="short runs; judge only ratios and counts, which a busy machine does not change",
    )
    parser.add_argument("--check", action="store_true", help="exit with code 1 if a figure misses its target")
    parser.add_argument(
        "--json",
        type=Path,
        metavar="FILE",
        help="write all figures to this file, which keeps a row of each run, and show the previous figures",
    )
    parser.add_argument(
        "--nice", type=int, metavar="N", help="niceness of all processes; negative: higher priority (needs root)"
    )
    parser.add_argument(
        "--as-is",
        action="store_true",
        help="allow CPU idle states and let the kernel place processes; by default cycle, scale, services and clients "
        "keep CPUs awake where permitted, and the compared program has a CPU of its own there and in services",
    )
    add_duration(parser, "length of the long runs, such as the soak", former="--seconds")


def run(args: argparse.Namespace) -> int:
    """Measure and print; return 1 with --check if a figure misses its limit."""
    if args.json is not None:
        _check_writable(args.json)
    if args.nice is not None:
        _be_nice(args.nice)
    names = _names(args.family or (["all"] if args.quick else ["cycle"]))
    with on_signals((signal.SIGTERM,), interrupt):  # its child processes are then ended as by Ctrl-C
        options = Options(args.quick, args.seconds, lambda text: print(text, file=sys.stderr), args.as_is)
        report = run_families(names, options)
        if args.check and args.quick and (families := report.fell_short()):
            print(f"{report}\n\nonce more, because other load on this machine may have ended: {', '.join(families)}\n")
            report.take(run_families(families, options))
    if args.json is not None:
        report.put_beside(args.json)
        report.write(args.json)
    print(report)
    short = report.short()
    for figure in short if args.check else ():
        print(
            f"short: {figure.name}: {figure.judged:.3g}, must be {figure.direction} {figure.limit:g}", file=sys.stderr
        )
    return 1 if report.failures or (args.check and short) else 0


def _check_writable(path: Path) -> None:
    """Refuse an unwritable file before anything is measured; the file is not changed."""
    try:
        path.open("a").close()
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror or error}") from error


def _be_nice(niceness: int) -> None:
    """Set a niceness, which all processes started here inherit; the table shows it."""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    except PermissionError as error:
        raise ConfigError(f"--nice {niceness}: only root may go before others; leave it out") from error


def _names(asked: list[str]) -> list[str]:
    """Return the families selected by the words, without duplicates."""
    return list(dict.fromkeys(name for word in asked for name in GROUPS.get(word, (word,))))


def _family(text: str) -> str:
    if text not in (*FAMILIES, *GROUPS):
        raise argparse.ArgumentTypeError(f"no family {text!r}; available: {', '.join((*FAMILIES, *GROUPS))}")
    return text
