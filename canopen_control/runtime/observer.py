"""Observer of a robot: one class with a method for each kind of event."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from canopen_control.master.event_log import Event


@mypyc_attr(allow_interpreted_subclasses=True)
class RobotObserver:
    """Base of the `observers` of a robot, called on the robot's thread; does nothing unless overridden."""

    def event(self, event: Event) -> None:
        """Process an event."""

    def running(self) -> None:
        """Process the start of running; called once."""

    def stopped(self) -> None:
        """Process the stop of the robot; called once."""

    def after_cycle(self, now: int) -> None:
        """Process the end of a cycle, whose frames were sent; `now` in ns."""
