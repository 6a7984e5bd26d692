"""The demonstration's motion: something to see until somebody commands the robot.

It is a commander like any other and the humblest: the first command of anyone else ends it for good.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.errors import ControlError
from canopen_control.master.events import Event
from canopen_control.runtime.core import RobotState

if TYPE_CHECKING:
    from canopen_control.host.reactor import Timer
    from canopen_control.runtime.core import RobotCore

__all__ = ["SOURCE", "DemoMotion"]

SOURCE = "demo"
_STEP_NS = 100_000_000
_STEPS_EACH = 30  # three seconds at each speed
_SPEEDS = (0.0, 10.0, -10.0)  # rad/s


class DemoMotion:
    """Plays 0, 10, -10 rad/s on a forward controller in a loop."""

    def __init__(self, robot: RobotCore, controller: str) -> None:
        self._robot, self._controller = robot, controller
        self._step = 0
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
        speed = _SPEEDS[self._step // _STEPS_EACH % len(_SPEEDS)]
        self._step += 1
        try:
            count = len(self._robot.manager.get(self._controller).command_interface_names())
            self._robot.command(self._controller, [speed] * count, SOURCE)
        except ControlError:
            return  # somebody deactivated the controller: there is nothing to play on
