"""TargetController: one number for one joint, in whatever mode of operation its drive is.

The law of the file (ros2_canopen's `target` service, made safe): what the number is follows the mode, which a user asks
for by `axis mode` or the services of the node: a position, a velocity or an effort, in SI units. A position is a place
to go to, and to stay at: it has no end, but ends with who gave it. A velocity or effort ends after `command_timeout`
(s; absent 2 s, 0 never, see `command_life`). A target is forgotten with every change of the mode, since it would be
another quantity then, and whenever the drive is no longer enabled; activating the controller enables nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.command_life import MOVING
from canopen_control.controllers.forward_command import ForwardCommandController
from canopen_control.controllers.standard_params import SingleParams
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import TARGET, ReturnType

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params

__all__ = ["TYPE", "TargetController"]

TYPE = "canopen_control/TargetController"


class TargetController(ForwardCommandController):
    """Forwards one number to the command interface `target` of one joint; `interface` is what the number is now."""

    topic: ClassVar[str | None] = TARGET

    def __init__(self, name: str, type_name: str = TYPE) -> None:
        super().__init__(name, type_name)

    def on_configure(self, params: Params) -> None:
        """Read joint and command_timeout."""
        given = params.read(SingleParams)
        if not given.joint:
            raise RobotConfigError(f"{self.name}: no 'joint'; give it under {self.name}: ros__parameters: joint: NAME")
        self._set_up(given, (given.joint,), TARGET, None)
        self._set_life(given.command_timeout, tuple(MOVING))

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Take one finite number, if the drive is in a mode that takes one; `now` in ns starts the timeout anew."""
        if self.commands and self.commands[0].quantity == TARGET:
            joint = self.joints[0]
            how = f"canopen-control axis mode {joint} PV"
            raise self.refusal(f"has no target yet: {joint} is in no mode that takes one; ask for one: {how}")
        super().set_command(values, now, stamp)

    def update(self, now: int, period: float) -> ReturnType:
        """Write the target."""
        self.interface = self.commands[0].quantity
        return super().update(now, period)

    def _runs_out(self, now: int) -> bool:
        """Whether a velocity or effort ends now because nobody has renewed it; a position never does."""
        return self.commands[0].quantity in MOVING and super()._runs_out(now)
