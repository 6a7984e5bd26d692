"""Base class for observers of a running robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from canopen_control.master.event_log import Event


@mypyc_attr(allow_interpreted_subclasses=True)
class RobotObserver:
    """Base class of a robot's observers; all methods are called on the robot's thread and do nothing by default."""

    def event(self, event: Event) -> None:
        """Handle a reported event."""

    def booted(self) -> None:
        """Handle the end of the boot of all required nodes, before the controllers are activated; called once."""

    def running(self) -> None:
        """Handle the completion of the start; called once."""

    def stopped(self) -> None:
        """Handle the end of the run; called once."""

    def after_cycle(self, now: int) -> None:
        """Handle the end of a control cycle, after its frames were sent; `now` is in ns."""
