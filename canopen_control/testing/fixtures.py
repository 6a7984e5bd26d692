"""Fixtures for pytest: `robot` in virtual time, and its `drives`, `bus` and `clock`.

The ini option `canopen_robot` selects the robot (a folder, relative to the ini file, or a bundled name); the mark
`canopen_robot("config/robby", controllers=["..."], seed=7)` selects the robot of one test or module. The argument
`quirks={"left_drive": ["brake_delay=0.5"]}` sets quirks of drives from power-on ("all" stands for every drive). A test
fails if an invariant was violated, unless the mark has `breaches=True`.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator

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


def _configured(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    marks = list(request.node.iter_markers(_MARK))
    words = {key: value for mark in reversed(marks) for key, value in mark.kwargs.items()}
    named = next((str(mark.args[0]) for mark in marks if mark.args), "")
    if named:
        return named, words
    text = str(request.config.getini(_MARK))
    if not text:
        raise pytest.UsageError(
            "the fixture `robot` needs a robot: set canopen_robot = FOLDER in the ini file, or the mark "
            '@pytest.mark.canopen_robot("FOLDER")'
        )
    beside = Path(request.config.rootpath) / text
    return str(beside) if beside.exists() else text, words


@pytest.fixture
def robot(request: pytest.FixtureRequest) -> Iterator[TestedRobot]:
    """Yield a booted robot in virtual time; a violated invariant fails the test."""
    from canopen_control.testing.tested_robot import TestedRobot

    config, words = _configured(request)
    tested = TestedRobot(
        _setup(config, tuple(words.get("controllers", ()))), words.get("seed", 0), quirks=words.get("quirks")
    )
    try:
        yield tested
    finally:
        tested.close()
    if tested.breaches and not words.get("breaches", False):
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
