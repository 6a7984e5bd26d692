"""Makes the folder of a new robot: its files are written aside, checked as `check --strict` does, then put in place.

The law of this file: a folder that is there is not touched unless that is asked for, and then nothing but the files
that are made anew. What the check finds to be an error is written into bus.yml as a comment, and told; so is why a
drive cannot be moved.
"""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import INTERPOLATION_TIME_PERIOD
from canopen_control.errors import RobotConfigError
from canopen_control.master.budget import HIGH
from canopen_control.runtime.check import CheckOptions, check_robot
from canopen_control.runtime.check_data import Severity
from canopen_control.runtime.robot_files import BUS, CONTROLLERS, find_robot
from canopen_control.scaffold.bus_text import bus_text
from canopen_control.scaffold.controllers_text import controllers_text
from canopen_control.scaffold.description_text import description_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.runtime.check import CheckReport
    from canopen_control.scaffold.new_robot import NewRobot

__all__ = ["Written", "refuse_existing", "write_robot"]

_PERIODS_US: Final = (20_000, 50_000, 100_000, 200_000)
"""SYNC periods, the shortest that the bus can carry is taken."""
_FASTEST_US: Final = 5_000  # of a period that a file tells
_LARGEST_POWER: Final = 10


@dataclass(frozen=True, slots=True)
class Written:
    """What was written: the robot as it is, its files, the warnings that `check` gives, and the errors: problems."""

    robot: NewRobot
    folder: Path
    files: tuple[str, ...]
    warnings: tuple[str, ...]
    problems: tuple[str, ...] = ()


def write_robot(robot: NewRobot, parent: Path, *, force: bool = False) -> Written:
    """Write the folder of a robot into `parent`; RobotConfigError where it is there, or cannot be made."""
    folder = parent / robot.name
    refuse_existing(folder, force=force)
    robot = _with_distinct_files(robot)
    with tempfile.TemporaryDirectory(prefix="canopen-control-") as aside:
        made = Path(aside) / robot.name
        robot, warnings = _make_checked(robot, made)
        names = tuple(sorted(path.name for path in made.iterdir()))
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name in names:
                shutil.copyfile(made / name, folder / name)
        except OSError as error:
            raise RobotConfigError(f"{folder} cannot be written: {error.strerror}") from error
    return Written(robot, folder, names, warnings, robot.problems)


def refuse_existing(folder: Path, *, force: bool) -> None:
    """Raise RobotConfigError for a folder that may not be written to."""
    if folder.is_symlink() or (folder.exists() and not folder.is_dir()):
        raise RobotConfigError(f"{folder} is there and is no folder; choose another name")
    if folder.exists() and not force:
        raise RobotConfigError(f"{folder} is there already; choose another name, or write its files anew with --force")


def _with_distinct_files(robot: NewRobot) -> NewRobot:
    """Rename the copies of EDS files of one name: they are to lie in one folder."""
    names: dict[Path, str] = {}
    for node in robot.nodes:
        path, name = node.device.eds, node.device.eds.name
        number = 2
        while path not in names and name in names.values():
            name, number = f"{path.stem}_{number}{path.suffix}", number + 1
        names.setdefault(path, name)
    return replace(robot, eds_names=names)


def _make_checked(robot: NewRobot, folder: Path) -> tuple[NewRobot, tuple[str, ...]]:
    """Make the files with the shortest SYNC period that the bus carries; return the robot and what `check` warns of."""
    errors, warnings, robot = list[str](), tuple[str, ...](), replace(robot, problems=())
    for period in dict.fromkeys([*_told_periods(robot), *_PERIODS_US]):
        robot = replace(robot, sync_us=period)
        _make(robot, folder)
        errors, warnings, loaded = _judge(folder)
        if not loaded:
            break
    problems = [f"{robot.eds_name(node)}: {node.unusable}" for node in robot.nodes if node.unusable] + errors
    if problems:
        robot = replace(robot, problems=tuple(dict.fromkeys(problems)))
        _make(robot, folder)
    return robot, warnings


def _told_periods(robot: NewRobot) -> Iterator[int]:
    """Yield the us over which drives interpolate by the word of a DCF (0x60C2), which was made for that SYNC."""
    for node in robot.drives:
        value, exponent = (node.device.od.get(INTERPOLATION_TIME_PERIOD, subindex) for subindex in (1, 2))
        told = None if value is None else value.parameter_value
        power = -3 if exponent is None else exponent.value
        if isinstance(told, int) and isinstance(power, int) and abs(power) < _LARGEST_POWER:
            period = Fraction(told) * Fraction(10) ** power * 1_000_000
            if _FASTEST_US <= period <= _PERIODS_US[-1] and (1_000_000 / period).denominator == 1:  # a rate in whole Hz
                yield int(period)


def _make(robot: NewRobot, folder: Path) -> None:
    folder.mkdir(exist_ok=True)
    texts = {BUS: bus_text(robot)}
    if not robot.is_bus_alone:
        texts[CONTROLLERS] = controllers_text(robot)
        texts[f"{robot.name}.urdf"] = description_text(robot)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    for path, name in robot.eds_names.items():
        try:
            shutil.copyfile(path, folder / name)
        except OSError as error:
            raise RobotConfigError(f"{path} cannot be copied: {error.strerror}") from error


def _judge(folder: Path) -> tuple[list[str], tuple[str, ...], bool]:
    """Return errors, warnings, and whether the bus is loaded too high."""
    report: CheckReport = check_robot(find_robot(str(folder)), CheckOptions())
    texts = {
        severity: [each.text for each in report.findings if each.severity is severity]
        for severity in (Severity.ERROR, Severity.WARNING)
    }
    loaded = any(not budget.fits or budget.load > HIGH for budget in report.budgets.values())
    return texts[Severity.ERROR], tuple(texts[Severity.WARNING]), loaded
