"""What a panel is given: the robot it shows, and what a page may do to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.view.picture import Picture
    from canopen_control.view.robot import RobotView
    from canopen_control.view.teleop import Motion

__all__ = ["Desk", "Panel"]


class Desk(Protocol):
    """The robot as the panels of every page see it; see `app.ViewApp`."""

    teleop: bool

    @property
    def robot(self) -> RobotView:
        """What is known of the robot."""
        ...

    async def ask(self, request: Request[Any]) -> str | None:
        """Ask the robot and wait; the reason if it was not done."""
        ...

    def hold(self, page: str, motion: Motion, told: Callable[[str], None]) -> None:
        """Take note that a page holds a button; `told` gets a sentence if it may not drive."""
        ...

    def let_go(self, page: str) -> None:
        """End what a page drives, now."""
        ...

    def look_at_faults(self) -> None:
        """Ask the virtual drives again, soon."""
        ...


class Panel(Protocol):
    """A part of a page: made in its place, then shown every picture. One file each, one line in `page.PANELS`."""

    def __init__(self, desk: Desk) -> None:
        """Make the widgets in the place that is current."""
        ...

    def show(self, picture: Picture) -> None:
        """Show what is known now; what has not changed is not sent again."""
        ...
