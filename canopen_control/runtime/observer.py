"""The observer of a robot: one class with a method for each thing that happens to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from canopen_control.master.event_log import Event


@mypyc_attr(allow_interpreted_subclasses=True)
class RobotObserver:
    """Is called by a robot in whose `observers` it is, on the robot's thread; does nothing but what is overridden."""

    def event(self, event: Event) -> None:
        """Take an event."""

    def running(self) -> None:
        """Take that the robot runs; once."""

    def stopped(self) -> None:
        """Take that the robot has stopped; once."""

    def after_cycle(self, now: int) -> None:
        """Take that a cycle has ended, whose frames are on their way; `now` in ns."""
