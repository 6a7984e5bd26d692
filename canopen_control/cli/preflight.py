"""Check a robot before it moves on real drives for the first time.

Checks the link and its bit rate, compares the devices on the bus with bus.yml, and checks EDS revisions, errors and
limits. Then, after you confirm each one, it turns the joints slowly one by one, and tests STOP. It starts no virtual
drives. A pass is valid for these files and these drives only; without one, `run --real` is limited to 1 rad/s unless
you give --full-speed.

Exit codes: 0 passed; 1 not passed; 2 wrong usage or configuration.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.run import add_file_arguments, find_files
from canopen_control.cli.support.arguments import add_new_name, number
from canopen_control.cli.support.preflight_jog import Jog, jog_interfaces
from canopen_control.cli.support.preflight_steps import Step, link_steps, node_steps
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.files import write_whole
from canopen_control.host.sockets import check_name
from canopen_control.runtime.clearance import SLOW, config_hash, keep_pass, read_serials

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable

    from canopen_control.runtime.setup import RobotSetup

__all__ = ["EXAMPLE", "add_arguments", "run"]

EXAMPLE = "canopen-control preflight robby --can can0"

_MARKS = {True: "ok  ", False: "FAIL", None: "note"}
_NOT_TURNED = "; it is not turned, and stays slow with --real"
_WARNING = (
    "The next steps turn the motors. Lift the wheels off the ground, keep hands and cables away, and have the supply "
    "within reach: STOP is not a safety function."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add_file_arguments(parser)
    add_new_name(parser, "robot name that the pass is recorded for (default: the folder's)")
    parser.add_argument("--yes", action="store_true", help="assume yes to all questions (unattended use)")
    parser.add_argument("--no-jog", action="store_true", help="check only, move nothing; this does not count as a pass")
    parser.add_argument(
        "--speed",
        type=number(f"speed above 0 and up to {SLOW:g} rad/s", lambda value: 0 < value <= SLOW),
        default=0.5,
        metavar="RAD/S",
        help=f"speed of the joints (default: 0.5, at most {SLOW:g})",
    )
    parser.add_argument("--report", metavar="FILE", help="write the findings as JSON to this file")


@dataclass(slots=True)
class Preflight:
    """One pre-flight: what was found so far, who is told, who is asked."""

    setup: RobotSetup
    say: Callable[[str], None]
    ask: Callable[[str], bool]
    speed: float
    steps: list[Step] = field(default_factory=list)
    covered: list[str] = field(default_factory=list)  # the joints that turned as they should

    def note(self, steps: Iterable[Step]) -> bool:
        """Tell steps as they come; return whether all of them passed."""
        good = True
        for step in steps:
            self.steps.append(step)
            self.say(f"{_MARKS[step.passed]}  {step.name:<8}  {step.text}")
            good = good and step.passed is not False
        return good

    def look(self) -> bool:
        """Look at links and nodes; nothing is written to a drive."""
        good = True
        for name, bus in self.setup.buses.items():
            channel = self.setup.channels[name]
            linked = self.note(link_steps(channel, bus.master.baudrate))
            good = linked and self.note(node_steps(bus, channel)) and good
        return good

    def move(self) -> bool:
        """Jog and stop; True if all did what was expected, False as soon as something or somebody said no."""
        for joint, interface in jog_interfaces(self.setup).items():
            if interface is None:
                self.note([Step("jog", None, f"{joint} has neither velocity nor position to command{_NOT_TURNED}")])
        if not any(jog_interfaces(self.setup).values()):
            verdict = None if self.setup.files.bus_alone else False  # its drives are turned by their targets alone
            return self.note([Step("jog", verdict, "no joint has a velocity or a position to command")])
        self.say(_WARNING)
        if not self.ask("Go on?"):
            return self.note([Step("jog", False, "not wanted")])
        with Jog(self.setup, self.speed) as jog:
            if not all(self._turn(jog, joint) for joint in jog.joints):
                return False
            if not jog.turned:
                return self.note([Step("jog", False, "no joint could be turned")])
            self.covered += jog.turned
            return self.note([jog.stop()])

    def _turn(self, jog: Jog, joint: str) -> bool:
        if (why := jog.no_room(joint)) is not None:
            return self.note([Step("jog", None, f"{joint}: {why}{_NOT_TURNED}")])
        if not self.ask(f"Turn {joint} forward at {self.speed:g} rad/s?"):
            return self.note([Step("jog", False, f"{joint}: not wanted")])
        if not self.note([jog.turn(joint)]):
            return False
        if self.ask(f"Did {joint}, and nothing else, turn forward?"):
            return True
        return self.note([Step("jog", False, f"{joint}: turned the wrong way, or something else turned")])


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if not (args.yes or args.no_jog or sys.stdin.isatty()):
        raise ConfigError(
            "nobody is there to ask (no terminal); add --yes to answer every question with yes, or --no-jog"
        )
    flight = Preflight(_read_setup(args), print, (lambda _question: True) if args.yes else _ask, args.speed)
    passed = flight.look() and not args.no_jog and flight.move()
    return _conclude(flight, passed=passed, looked_only=args.no_jog, report=args.report)


def _read_setup(args: argparse.Namespace) -> RobotSetup:
    """Read the files that the arguments name, for real drives; ConfigError."""
    from canopen_control.runtime.setup import read_robot

    files = find_files(args)
    if args.name is not None:
        check_name(args.name)
    setup = read_robot(
        files,
        name=args.name,
        can=args.can,
        real=True,
        strict=args.strict,
        peer_merge=args.peer_merge,
        allow_unsupervised=args.allow_unsupervised,
    )
    setup.require_places("preflight")
    return setup


def _ask(question: str) -> bool:
    print(f"{question} [y/N] ", end="", flush=True)
    answer = ""
    try:
        answer = sys.stdin.readline()
    finally:
        if not answer.endswith("\n"):  # Ctrl-C or Ctrl-D: what follows begins a line
            print(flush=True)
    return answer.strip().lower() in ("y", "yes")


def _conclude(flight: Preflight, *, passed: bool, looked_only: bool, report: str | None) -> int:
    setup = flight.setup
    failed = [step for step in flight.steps if step.passed is False]
    serials = read_serials(setup) if passed else {}
    silent = [name for name, serial in serials.items() if serial is None]
    if passed and silent:
        raise CanopenError(f"{', '.join(silent)} does not answer any more; no pass was written")
    if report is not None:
        _write_report(flight, Path(report), passed, serials)
    if passed:
        known = {name: serial for name, serial in serials.items() if serial is not None}
        path = keep_pass(setup, known, flight.covered)
        slow = [joint for joint in jog_interfaces(setup) if joint not in flight.covered]
        but = f"; slow stays what was not turned: {', '.join(slow)}" if slow else ""
        print(f"{setup.name} has passed{but}; run it with --real ({path})")
        return 0
    if looked_only and not failed:
        print(f"nothing is wrong with what can be seen; without the jog {setup.name} has not passed")
        return 0
    print(f"{setup.name} has not passed: {len(failed)} of {len(flight.steps)} steps failed")
    return 1


def _write_report(flight: Preflight, path: Path, passed: bool, serials: dict[str, int | None]) -> None:
    report = {
        "robot": flight.setup.name,
        "time": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "passed": passed,
        "channels": flight.setup.channels,
        "configuration": config_hash(flight.setup),
        "serial_numbers": serials,
        "joints": flight.covered,
        "steps": [asdict(step) for step in flight.steps],
    }
    write_whole(path, f"{json.dumps(report, indent=2)}\n".encode())
