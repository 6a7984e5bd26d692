"""Base class for observers of a running robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mypy_extensions import mypyc_attr

if TYPE_CHECKING:
    from canopen_control.master.event_log import Event


@mypyc_attr(allow_interpreted_subclasses=True)
class RobotObserver:
    """Base class of a robot's `observers`; the methods are called on the robot's thread and do nothing by default."""

    def event(self, event: Event) -> None:
        """Process a reported event."""

    def running(self) -> None:
        """React to the completed start of the robot; called once."""

    def stopped(self) -> None:
        """React to the stop of the robot; called once."""

    def after_cycle(self, now: int) -> None:
        """React to the end of a cycle whose frames have been sent; `now` is in ns."""
