"""What a tab of the Drive view is, and what it is given; how to add one stands in this folder's docstring."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from canopen_control.rpc.messages.robot import NodePlace
    from canopen_control.rpc.messages.state import NodeReading
    from canopen_control.view.node_desk import NodeDesk
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext

__all__ = ["LOOK_ONLY", "DriveTab", "DriveTabContext"]

LOOK_ONLY = "<p class='cc-note'>This page only looks. To write: <code>canopen-control view --teleop</code></p>"


@dataclass(frozen=True, slots=True)
class DriveTabContext:
    """The node that a tab is about: the page's robot, where the node is, and what is done at it for all pages."""

    panel: PanelContext
    desk: NodeDesk

    @property
    def place(self) -> NodePlace:
        """Its node id, EDS, axes and joints."""
        return self.desk.place

    @property
    def node(self) -> str:
        """Its name in bus.yml."""
        return self.desk.place.name

    def reading(self, content: PageContent) -> NodeReading | None:
        """Return what the robot says of the node; None where nobody knows it now."""
        return None if content.lost else content.state.nodes.get(self.node)


class DriveTab(Protocol):
    """A tab of one node: made in its place when it is opened first."""

    def __init__(self, context: DriveTabContext) -> None:
        """Make the widgets in the place that is current."""
        ...

    def show(self, content: PageContent) -> None:
        """Show what is known now, while the tab is seen; what has not changed is not sent again."""
        ...

    def leave(self) -> None:
        """End what it reads or drives: it is not seen any more. It may be shown again."""
        ...
