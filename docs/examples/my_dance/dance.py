"""A custom controller that swings one joint back and forth."""

import math
from dataclasses import dataclass

from canopen_control import CommonParams, Controller, Params, ReturnType


@dataclass(frozen=True)
class DanceParams(CommonParams):
    """Parameters in ros2_controllers.yaml: the joint and its maximum speed in rad/s."""

    joint: str = ""
    speed: float = 5.0


class Dance(Controller):
    """Commands one velocity interface with a sine wave."""

    def on_configure(self, params: Params) -> None:
        """Read the parameters; errors are reported with file and line."""
        self.params = params.read(DanceParams)

    def command_interface_names(self) -> list[str]:
        """Return the command interfaces to claim on activation."""
        return [f"{self.params.joint}/velocity"]

    def update(self, now: int, period: float) -> ReturnType:
        """Run one cycle; `now` is monotonic time in ns, `period` is in s."""
        self.commands[0].value = self.params.speed * math.sin(now / 1e9)
        return ReturnType.OK
