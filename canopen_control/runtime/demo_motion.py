"""The motion of `demo`: velocities, positions or a curve, until somebody commands the robot.

It is a commander like any other and the humblest: the first command of anyone else ends it for good. Velocities step,
positions swing slowly about where the joints were, a base goes a curve; an effort, whose end nobody could foresee, is
not played.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.controllers.base import twist_axes_of
from canopen_control.errors import ControlError
from canopen_control.hardware.interfaces import POSITION, VELOCITY
from canopen_control.master.event_log import Event
from canopen_control.runtime.core import RobotState

if TYPE_CHECKING:
    from canopen_control.host.reactor import Timer
    from canopen_control.runtime.core import RobotCore

__all__ = ["SOURCE", "DemoMotion"]

SOURCE = "demo"
_STEP_NS = 100_000_000
_STEPS_EACH = 30  # three seconds of each phase
_PHASES = (0, 1, -1)
_SPEED = 10.0  # rad/s (m/s)
_TWIST = {"linear.x": 0.2, "linear.y": 0.1, "angular.z": 0.5}  # m/s, rad/s
_SWING = 0.25  # rad (m), each way
_SWING_STEPS = 80  # eight seconds there and back: 0.2 rad/s at most


class DemoMotion:
    """Plays on a controller in a loop: velocities and twists stand, go and go back; positions swing."""

    def __init__(self, robot: RobotCore, controller: str) -> None:
        self._robot, self._controller = robot, controller
        self._step = 0
        self._middle: list[float] | None = None
        self._timer: Timer | None = robot.reactor.call_later(_STEP_NS, self._play)

    def _play(self) -> None:
        robot = self._robot
        if robot.commander not in (None, SOURCE):
            robot.report(
                Event(robot.reactor.now(), "demo", "", f"{robot.commander} commands now; the demo motion ends")
            )
            return
        if robot.state in (RobotState.STOPPING, RobotState.STOPPED):
            return
        self._timer = robot.reactor.call_later(_STEP_NS, self._play)
        if robot.state is RobotState.RUNNING:
            self._command()

    def _command(self) -> None:
        try:
            values = self._values()
            if values:
                self._robot.command(self._controller, values, SOURCE)
        except ControlError:
            return  # somebody deactivated the controller: there is nothing to play on
        self._step += 1

    def _values(self) -> list[float]:
        """Return the commands of this step, none where there is nothing to play."""
        controller = self._robot.manager.get(self._controller)
        if controller.topic is None:  # it takes goals
            return []
        if axes := twist_axes_of(controller):
            return [_TWIST[axis] * _PHASES[self._step // _STEPS_EACH % len(_PHASES)] for axis in axes]
        names = controller.command_interface_names()
        kinds = {name.rpartition("/")[2] for name in names}
        if kinds == {VELOCITY}:
            return [_SPEED * _PHASES[self._step // _STEPS_EACH % len(_PHASES)]] * len(names)
        if kinds != {POSITION}:
            return []
        if self._middle is None:
            self._middle = [self._robot.registry.state(name).value for name in names]
        swing = _SWING * math.sin(math.tau * self._step / _SWING_STEPS)
        return [middle + swing for middle in self._middle]
