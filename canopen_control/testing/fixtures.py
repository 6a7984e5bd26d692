"""Fixtures for pytest: `robot` in virtual time, and its `drives`, `bus` and `clock`.

The ini option `canopen_robot` selects the robot (a folder, relative to the ini file, or a bundled name); the mark
`canopen_robot("config/robby", controllers=["..."], seed=7)` selects the robot of one test or module. The argument
`quirks={"left_drive": ["brake_delay=0.5"]}` sets quirks of drives from power-on ("all" stands for every drive). A test
fails if an invariant was violated, unless the mark has `breaches=True`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.testing.tested_robot import TestedBus, TestedClock, TestedDrives, TestedRobot


_MARK = "canopen_robot"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Declare the ini option `canopen_robot`, which selects the robot."""
    parser.addini(_MARK, "robot of the fixture `robot`: a folder, or the name of a bundled robot", default="")


def pytest_configure(config: pytest.Config) -> None:
    """Register the mark `canopen_robot`."""
    config.addinivalue_line(
        "markers",
        f"{_MARK}(config, controllers=(), seed=0, quirks=None, breaches=False): robot of the fixture `robot`",
    )


@functools.cache
def _setup(config: str, controllers: tuple[str, ...]) -> RobotSetup:
    """Return the setup of a robot; its files are read once for all tests."""
    from canopen_control.runtime.robot_files import find_robot  # tests without a robot need not wait for its imports
    from canopen_control.runtime.setup import read_robot

    return read_robot(find_robot(config), controllers=controllers)


@dataclass(frozen=True)
class _RobotMark:
    """Arguments of the marks of a test; where several marks set one, the nearest mark counts."""

    config: str = ""
    controllers: Sequence[str] = ()
    seed: int = 0
    quirks: Mapping[int | str, Sequence[str]] | None = None
    breaches: bool = False


def _configured(request: pytest.FixtureRequest) -> _RobotMark:
    marks = list(request.node.iter_markers(_MARK))
    words = {key: value for mark in reversed(marks) for key, value in mark.kwargs.items()}
    named = next((str(mark.args[0]) for mark in marks if mark.args), "")
    mark = _RobotMark(**{"config": named} | words)
    if mark.config:
        return mark
    text = str(request.config.getini(_MARK))
    if not text:
        raise pytest.UsageError(
            "the fixture `robot` needs a robot: set canopen_robot = FOLDER in the ini file, or the mark "
            '@pytest.mark.canopen_robot("FOLDER")'
        )
    folder = Path(request.config.rootpath) / text
    return replace(mark, config=str(folder) if folder.exists() else text)


@pytest.fixture
def robot(request: pytest.FixtureRequest) -> Iterator[TestedRobot]:
    """Yield a booted robot in virtual time; a violated invariant fails the test."""
    from canopen_control.testing.tested_robot import TestedRobot

    mark = _configured(request)
    tested = TestedRobot(_setup(mark.config, tuple(mark.controllers)), mark.seed, quirks=mark.quirks)
    try:
        yield tested
    finally:
        tested.close()
    if tested.breaches and not mark.breaches:
        pytest.fail("an invariant was violated: " + "; ".join(tested.breaches), pytrace=False)


@pytest.fixture
def drives(robot: TestedRobot) -> TestedDrives:
    """Return the drives of the robot, by node-ID or name."""
    return robot.drives


@pytest.fixture
def bus(robot: TestedRobot) -> TestedBus:
    """Return the buses of the robot."""
    return robot.bus


@pytest.fixture
def clock(robot: TestedRobot) -> TestedClock:
    """Return the clock of the robot."""
    return robot.clock
