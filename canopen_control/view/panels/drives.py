"""The drives: state in words, mode, and when they were last heard."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.view.panels.html import Html
from canopen_control.view.words import axis_rows, drive_table

if TYPE_CHECKING:
    from canopen_control.view.desk import Desk
    from canopen_control.view.picture import Picture

__all__ = ["DrivesPanel"]

_UNKNOWN = "<p class='cc-note'>No connection: nobody knows what the drives do.</p>"


class DrivesPanel:
    """The table of drives; empty without a connection, since what was known is not what is."""

    def __init__(self, desk: Desk) -> None:
        del desk
        self._table = Html()

    def show(self, picture: Picture) -> None:
        """Show the drives."""
        self._table.show(_UNKNOWN if picture.lost else drive_table(axis_rows(picture.state)))
