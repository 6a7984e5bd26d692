"""The panels that are only read: the tables of drives and joints, and the log of events."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.view.panels.panel import Html
from canopen_control.view.words import axis_rows, drive_table, event_log, joint_table

if TYPE_CHECKING:
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext

__all__ = ["DrivesPanel", "EventsPanel", "JointsPanel"]

_UNKNOWN = "<p class='cc-note'>No connection: nobody knows what the drives do.</p>"


class DrivesPanel:
    """The table of drives; empty without a connection, since what was known is not what is."""

    def __init__(self, context: PanelContext) -> None:
        del context
        self._table = Html()

    def show(self, content: PageContent) -> None:
        """Show the drives."""
        self._table.show(_UNKNOWN if content.lost else drive_table(axis_rows(content.state)))


class JointsPanel:
    """The table of joints, in SI units."""

    def __init__(self, context: PanelContext) -> None:
        self._linear = context.robot.linear
        self._table = Html("cc-stale")

    def show(self, content: PageContent) -> None:
        """Show the joints; without a connection the last values stay, greyed."""
        if not content.lost:
            self._table.show(joint_table(content.state.joints, self._linear, content.commanded))


class EventsPanel:
    """The list of events, which scrolls."""

    def __init__(self, context: PanelContext) -> None:
        del context
        self._log = Html("cc-log")

    def show(self, content: PageContent) -> None:
        """Show the events."""
        self._log.show(event_log(content.events))
