"""The stream from the view to one page: everything that changes often, in one message at a time."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

from nicegui.element import Element

if TYPE_CHECKING:
    from canopen_control.view.history import Row

__all__ = ["Feed", "FeedMessage", "PlotRows", "SceneChange"]


class SceneChange(TypedDict, total=False):
    """What has moved: joints by their order in the tree, in rad or m, the base's pose, joints of drives in a fault."""

    angles: list[float | None]
    pose: list[float] | None
    tint: list[str]


class PlotRows(TypedDict, total=False):
    """Rows that are new; `anew`: they are all there is."""

    anew: bool
    rows: list[Row]


class FeedMessage(TypedDict, total=False):
    """One message; a key that is not there has not changed. `trail` are points in m, `titles` those of charts."""

    scene: SceneChange
    plots: PlotRows
    trail: list[tuple[float, float]]
    titles: dict[str, str]
    lost: bool
    latched: bool


class Feed(Element, component="feed.js"):
    """Nothing to see. Every key of what is sent becomes the event `cc-KEY` of the page's window."""

    def send(self, data: FeedMessage) -> None:
        """Send what has changed; nothing at all says that the view is alive."""
        self.run_method("take", data)
