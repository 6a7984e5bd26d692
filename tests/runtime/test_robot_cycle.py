"""Cycles that raise exceptions: a single one passes, a few in a row end in a controlled stop."""

import pytest
from support.observers import Observer
from support.robots import LEFT, RIGHT, Bench

from canopen_control.controllers.command_limits import CommandLimits
from canopen_control.hardware.system import CanopenSystem
from canopen_control.runtime.core import RobotState
from canopen_control.runtime.robot_bus import RobotBus
from canopen_control.runtime.robot_cycle import RAISED_CYCLES

pytestmark = pytest.mark.sources


@pytest.fixture
def moving():
    bench = Bench("raised")
    bench.start()
    bench.hold(10.0, 10.0, ms=1000)
    assert bench.speed(LEFT) != 0 != bench.speed(RIGHT)
    bench.raised = []
    bench.reactor.on_error = bench.raised.append
    yield bench
    bench.close()


class Raising:
    """A method that raises in its first `times` calls after `begin`, and then does what it replaces."""

    def __init__(self, monkeypatch, owner, name, times=10**9):
        self.left, self.before = times, getattr(owner, name)
        raising = self

        def method(this, *arguments):
            if raising.left > 0:
                raising.left -= 1
                raise ZeroDivisionError(f"in {name}")
            return raising.before(this, *arguments)

        monkeypatch.setattr(owner, name, method)


PLACES = [
    (CanopenSystem, "read", "read of robby"),
    (CanopenSystem, "write", "write of robby"),
    (CommandLimits, "enforce", "the update of the controllers"),
    (RobotBus, "send_cycle", "the cycle"),
    (RobotBus, "tick", "the cycle"),
]


@pytest.mark.parametrize(("owner", "name", "where"), PLACES)
def test_a_cycle_that_raises_again_and_again_stops_the_drives_and_ends_the_run(moving, monkeypatch, owner, name, where):
    if owner is CommandLimits and moving.robot.manager.limiter is None:
        moving.robot.manager.limiter = CommandLimits(moving.setup.description, moving.robot.registry)
    Raising(monkeypatch, owner, name)
    moving.run(20 * RAISED_CYCLES + 10)
    assert moving.robot.state in (RobotState.STOPPING, RobotState.STOPPED)
    (text,) = moving.texts("failed")
    assert f"raised ZeroDivisionError in {RAISED_CYCLES} cycles in a row: in {name}" in text
    assert where.split(" of ")[0] in text
    moving.run(2000)
    assert moving.speed(LEFT) == 0 == moving.speed(RIGHT)
    moving.run(16_000)
    assert moving.robot.state is RobotState.STOPPED
    assert moving.robot.failure == text
    assert all(isinstance(error, ZeroDivisionError) for error in moving.raised)


@pytest.mark.parametrize(("owner", "name", "where"), PLACES)
def test_less_cycles_that_raise_do_not_stop_the_robot(moving, monkeypatch, owner, name, where):
    Raising(monkeypatch, owner, name, times=RAISED_CYCLES - 1)
    moving.hold(10.0, 10.0, ms=1000)
    assert moving.robot.state is RobotState.RUNNING
    assert moving.speed(LEFT) != 0
    assert not moving.texts("failed")


def test_an_observer_that_raises_stops_the_robot_along_its_ramp(moving):
    def raising(now):
        raise ValueError("no")

    moving.robot.observers.append(Observer(after_cycle=raising))
    moving.run(20 * RAISED_CYCLES + 10)
    assert moving.robot.state is RobotState.STOPPING
    moving.run(2000)
    assert moving.speed(LEFT) == 0 == moving.speed(RIGHT)
