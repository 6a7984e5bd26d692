"""The Status tab: what the node is and does, the bits of its statusword, its errors, and a target that is held."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.view.panels.panel import Html
from canopen_control.view.words import axis_rows, drive_table

if TYPE_CHECKING:
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent

__all__ = ["StatusTab"]


class StatusTab:
    """Shows the node as the robot knows it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context = context
        self._facts = Html()

    def show(self, content: PageContent) -> None:
        """Show what is known now."""
        rows = [row for row in axis_rows(content.state) if row.node == self._context.node]
        self._facts.show("" if content.lost else drive_table(rows))

    def leave(self) -> None:
        """Leave it: nothing is read."""
