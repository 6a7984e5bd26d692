"""Measure wheel radii and track width of a differential drive base, by squares in both directions (UMBmark).

The base of a running robot drives squares by its odometry, counter-clockwise and clockwise, and stops at each corner.
Its true end positions show how unequal the wheels are and how far apart they are. In a simulation (drives with a `base`
in their plant file, or physics) the true pose is known and no input is needed. Measure a real base yourself: put it at
a mark, press Enter, and after the square type its end position as X Y, in metres ahead and to the left of the mark.
With --ends FILE these positions are read from a file instead, one per line, in this order.

The values are written to a copy of ros2_controllers.yaml and to the running controller, which then drives again with
them. The controller's own limits apply. STOP, a fault, Ctrl-C or the end of this process ends the calibration: the base
stops and the controller has its previous values again.

Exit codes: 0 the error was reduced or was zero; 1 stopped, no improvement, or a full disk; 2 wrong usage, no robot
runs, or implausible end positions.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import number, one_name, whole_number
from canopen_control.cli.support.output import json_alone, print_result
from canopen_control.cli.support.parsers import add_robot_name

if TYPE_CHECKING:
    import argparse

    from canopen_control.calibration.base_link import BaseLink
    from canopen_control.calibration.umbmark_session import CalibrationPlan, CalibrationResult, Ends


EXAMPLE = """canopen-control calibrate robby
         canopen-control calibrate robby --side 2 --runs 5 -o robby_calibrated.yaml"""
OUTPUT: Final = "ros2_controllers_calibrated.yaml"
_AFTER: Final = "; the base stops, and its controller has its previous values again"
_RUNS: Final = (1, 5)  # in each direction: in simulation, where all squares are equal, and on a floor

_length = number("length in m from 0.2 to 20", lambda value: 0.2 <= value <= 20.0)
_speed = number("speed above 0", lambda value: value > 0.0)
_count = whole_number("number from 1 to 50", range(1, 51))
_passes = whole_number("number from 1 to 5", range(1, 6))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "config", nargs="?", metavar="ROBOT", help="folder of the robot, or bundled robot, whose YAML is copied"
    )
    parser.add_argument(
        "--controllers", metavar="FILE", help="ros2_controllers.yaml, instead of the file in the folder"
    )
    parser.add_argument("-o", "--output", metavar="FILE", default=OUTPUT, help=f"file to write (default: {OUTPUT})")
    parser.add_argument("--overwrite", action="store_true", help="overwrite an existing file")
    parser.add_argument(
        "--controller",
        type=one_name,
        metavar="NAME",
        help="controller to calibrate (default: the only active diff drive controller)",
    )
    add_robot_name(parser)
    parser.add_argument("--side", type=_length, default=1.0, metavar="M", help="side of the square in m (default: 1)")
    parser.add_argument(
        "--speed", type=_speed, default=0.2, metavar="V", help="speed along the sides in m/s (default: 0.2)"
    )
    parser.add_argument(
        "--turn", type=_speed, default=0.6, metavar="W", help="speed at the corners in rad/s (default: 0.6)"
    )
    parser.add_argument(
        "--runs",
        type=_count,
        metavar="N",
        help=f"squares in each direction (default: {_RUNS[0]} in simulation, {_RUNS[1]} on a floor)",
    )
    parser.add_argument("--passes", type=_passes, default=1, metavar="N", help="number of corrections (default: 1)")
    parser.add_argument(
        "--ends", metavar="FILE", help="file with the measured end positions, instead of questions: X Y per line, in m"
    )


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    from canopen_control.calibration.base_link import BaseLink
    from canopen_control.client import RobotClient
    from canopen_control.errors import ControlError, RemoteError

    with RobotClient.connect(args.name) as robot:
        link = BaseLink(robot, args.controller)
        try:
            return _calibrate(args, link, robot.robot)
        except KeyboardInterrupt:
            raise ControlError(f"the calibration was interrupted{_AFTER}") from None
        except (ControlError, RemoteError) as error:
            if error.of_usage:
                raise
            raise ControlError(f"the calibration has ended: {error}{_AFTER}") from None


def _calibrate(args: argparse.Namespace, link: BaseLink, robot: str) -> int:
    from canopen_control.calibration.umbmark import Pace
    from canopen_control.calibration.umbmark_session import CalibrationPlan, calibrate, fitting_pace

    wheels = link.wheel_values()
    copy = _YamlCopy(args, link)
    simulated = link.true_pose() is not None and args.ends is None
    runs = args.runs or _RUNS[0 if simulated else 1]
    pace = fitting_pace(Pace(speed=args.speed, turn=args.turn), wheels)
    plan = CalibrationPlan(args.side, runs, args.passes, pace)
    ends = _ends(args, plan, simulated=simulated)
    with json_alone(args):
        _announce(plan, link.controller, robot)
        outcome = calibrate(link, ends, plan, _print, copy.write)
        _report(outcome, link.controller, copy)
    done = {
        "controller": link.controller,
        "largest_error_before": outcome.first.largest,
        "largest_error_after": outcome.last.largest,
        "parameters": outcome.factors,
        "file": args.output if copy.path else None,
    }
    print_result(args, done)
    return 0


def _announce(plan: CalibrationPlan, controller: str, robot: str) -> None:
    from canopen_control.calibration.umbmark_session import space

    pace = plan.pace
    _print(
        f"{controller} of {robot}: {plan.squares} squares of {plan.side:g} m at {pace.speed:g} m/s and "
        f"{pace.turn:g} rad/s, about {plan.seconds / 60.0:.0f} min of driving"
    )
    _print(f"free space it needs: {space(plan.side)}")
    _print("STOP: canopen-control stop, or Ctrl-C here")


def _report(outcome: CalibrationResult, controller: str, copy: _YamlCopy) -> None:
    """Print the improvement and the next step."""
    if outcome.first is outcome.last:
        _print(f"nothing to correct: the largest error is {1e3 * outcome.first.largest:.1f} mm")
        return
    first, last = outcome.first.largest, outcome.last.largest
    gain = f"{outcome.gain:.0f} times smaller" if last else "no error is left"
    _print(f"largest error {1e3 * first:.1f} mm before, {1e3 * last:.1f} mm now: {gain}")
    _print(f"{controller} runs with the new values until the robot ends" + (copy.hint if copy.path else ", which are:"))
    for name, value in () if copy.path else outcome.factors.items():
        _print(f"    {name}: {value:.9g}")


def _ends(args: argparse.Namespace, plan: CalibrationPlan, *, simulated: bool) -> Ends:
    """Return the source of the true end positions; raise ConfigError if none is available."""
    from canopen_control.calibration.base_link import TypedEnds, read_ends
    from canopen_control.calibration.umbmark_session import TrueEnds
    from canopen_control.errors import ConfigError

    if args.ends is not None:
        return read_ends(Path(args.ends), plan.squares, _print)
    if simulated:
        return TrueEnds(_print)
    if not sys.stdin.isatty():
        raise ConfigError(
            "the true pose of this base is unknown, and without a terminal "
            "its end positions cannot be typed: run it in a terminal, or give --ends FILE"
        )
    return TypedEnds(input, _print)


class _YamlCopy:
    """Corrected copy of ros2_controllers.yaml; `path` is the original file, or None if no copy is written."""

    def __init__(self, args: argparse.Namespace, link: BaseLink) -> None:
        from canopen_control.errors import ConfigError

        self.path: Path | None = None
        self._controller, self._copy = link.controller, Path(args.output)
        if args.config is None and args.controllers is None:
            if args.output != OUTPUT:
                raise ConfigError("--output is for a copy of a robot's YAML; name the robot's folder, or --controllers")
            return
        self.path = _controllers_file(args)
        self._require_same_values(link)
        if self._copy.exists() and not args.overwrite:
            raise ConfigError(f"{self._copy} already exists; give another --output, or --overwrite")

    def _require_same_values(self, link: BaseLink) -> None:
        """Raise ConfigError if the values in the file differ from those of the running robot."""
        from canopen_control.calibration.base_link import FACTORS
        from canopen_control.calibration.corrected_file import given_in
        from canopen_control.errors import ConfigError

        assert self.path is not None
        factors = given_in(self.path, self._controller, FACTORS)
        for name, running in zip(FACTORS, link.wheel_values().factors, strict=True):
            in_file = 1.0 if factors[name] is None else factors[name]
            if in_file != running:
                raise ConfigError(
                    f"{name} is {in_file:g} in {self.path} and {running:g} in the running robot; calibrate with the "
                    "file that the robot was started from, or restart the robot"
                )

    @property
    def hint(self) -> str:
        """Advice to run the robot with the corrected copy."""
        return f"; for good: canopen-control run ROBOT --controllers {self._copy}"

    def write(self, values: dict[str, float]) -> None:
        """Write the copy with new values and print the changes; no effect without an original file."""
        from canopen_control.calibration.corrected_file import write_corrected

        if self.path is None:
            return
        changes = write_corrected(self.path, self._copy, self._controller, values)
        _print(f"{self._copy}, a copy of {self.path}:")
        for change in changes:
            _print(f"  {change}")


def _controllers_file(args: argparse.Namespace) -> Path:
    if args.controllers is not None:
        return Path(args.controllers)
    from canopen_control.runtime.robot_files import find_robot

    return Path(find_robot(args.config).controllers)


def _print(text: str) -> None:
    print(text, flush=True)
