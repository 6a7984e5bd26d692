"""The events, newest first; what repeats itself stands there once with its count."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.view.panels.html import Html
from canopen_control.view.words import event_log

if TYPE_CHECKING:
    from canopen_control.view.desk import Desk
    from canopen_control.view.picture import Picture

__all__ = ["LogPanel"]


class LogPanel:
    """The list of events, which scrolls."""

    def __init__(self, desk: Desk) -> None:
        del desk
        self._log = Html("cc-log")

    def show(self, picture: Picture) -> None:
        """Show the events."""
        self._log.show(event_log(picture.events))
