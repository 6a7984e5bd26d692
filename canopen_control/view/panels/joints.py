"""The joints: where they are, how fast they turn, and what is commanded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from canopen_control.view.panels.html import Html
from canopen_control.view.words import joint_table

if TYPE_CHECKING:
    from canopen_control.view.desk import Desk
    from canopen_control.view.picture import Picture

__all__ = ["JointsPanel"]


class JointsPanel:
    """The table of joints, in SI units."""

    def __init__(self, desk: Desk) -> None:
        self._linear = desk.robot.linear
        self._table = Html("cc-stale")

    def show(self, picture: Picture) -> None:
        """Show the joints; without a connection the last values stay, greyed."""
        if not picture.lost:
            self._table.show(joint_table(picture.state.joints, self._linear, picture.commanded))
