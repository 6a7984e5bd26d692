"""What the verb `world` does to a robot that a simulation plugin moves: pause, play, step, reset, what happens in it.

Such a robot has no drives and no bus; its own process holds the world, so that its own socket is asked.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

from canopen_control.cli.support.output import json_line
from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.simulation import (
    MAX_STEPS,
    GetSimulation,
    PauseSimulation,
    ResetSimulation,
    StepSimulation,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.rpc.messages.simulation import Simulation

    Acts = dict[str, Callable[[str | None], Request[Simulation]]]

__all__ = ["SIMULATION_ACTS", "act_in_simulation", "act_on_simulation", "tell_simulation"]

_TIMEOUT_S = 600.0  # of as many steps as somebody asks for


def _pause(value: str | None) -> Request[Simulation]:
    return _without(value, "pause", PauseSimulation(paused=True))


def _play(value: str | None) -> Request[Simulation]:
    return _without(value, "play", PauseSimulation(paused=False))


def _without(value: str | None, what: str, request: Request[Simulation]) -> Request[Simulation]:
    if value is not None:
        raise ConfigError(f"world {what} {value}: {what} takes no value")
    return request


def _step(value: str | None) -> Request[Simulation]:
    count = int(value) if value is not None and value.isascii() and value.isdigit() else 1 if value is None else 0
    if not 1 <= count <= MAX_STEPS:
        raise ConfigError(f"world step {value}: a number of cycles from 1 to {MAX_STEPS}")
    return StepSimulation(steps=count)


def _reset(value: str | None) -> Request[Simulation]:
    return ResetSimulation(keyframe=value or "")


SIMULATION_ACTS: Acts = {"pause": _pause, "play": _play, "step": _step, "reset": _reset}
"""What may be done, with what the robot is asked for it."""


def act_on_simulation(args: argparse.Namespace) -> int:
    """Pause, play, step or reset, and say how the simulation goes then."""
    request = SIMULATION_ACTS[args.what](args.value)
    with RobotClient.connect(args.name) as robot:
        return _tell(robot.ask(request, _TIMEOUT_S), args)


def act_in_simulation(args: argparse.Namespace, act: WorldAct) -> bool:
    """Let something happen in the world of the running robot; False where no simulation plugin moves it."""
    with contextlib.ExitStack() as opened:
        try:
            robot = opened.enter_context(RobotClient.connect(args.name))
            robot.ask(GetSimulation())
        except CanopenError:
            return False
        robot.ask(act)
        _tell(robot.ask(GetSimulation()), args)
    return True


def tell_simulation(args: argparse.Namespace) -> bool:
    """Say how the simulation of the running robot goes; False where none is to be found."""
    try:
        with RobotClient.connect(args.name) as robot:
            _tell(robot.ask(GetSimulation()), args)
    except CanopenError:
        return False
    return True


def _tell(simulation: Simulation, args: argparse.Namespace) -> int:
    if args.json:
        print(json_line(simulation))
        return 0
    how = "paused; go on with: canopen-control world play" if simulation.paused else "running"
    print(f"{simulation.seconds:.6g} s simulated, in cycles of {1000.0 * simulation.period:g} ms, {how}")
    return 0
