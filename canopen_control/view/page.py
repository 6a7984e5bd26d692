"""One page of the robot, as one browser has it: STOP, then the panels of the table below, then the feed.

STOP is plain HTML and needs nothing of what follows. A new panel is a file in `panels` and a line in `PANELS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.view.elements.feed import Feed
from canopen_control.view.panels.banner import BannerPanel
from canopen_control.view.panels.drive import DrivePanel
from canopen_control.view.panels.drives import DrivesPanel
from canopen_control.view.panels.faults import FaultsPanel
from canopen_control.view.panels.joints import JointsPanel
from canopen_control.view.panels.log import LogPanel
from canopen_control.view.panels.plots import PlotsPanel
from canopen_control.view.panels.power import PowerPanel
from canopen_control.view.panels.scene import ScenePanel
from canopen_control.view.sampling import titles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.view.desk import Desk, Panel
    from canopen_control.view.elements.feed import FeedMessage
    from canopen_control.view.picture import Picture

__all__ = ["PANELS", "Page", "Place", "build_waiting", "stop_html"]

_ELEMENTS: Final = Path(__file__).parent / "elements"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a panel stands: "side", "middle" or "right"; without a title it has no frame of its own."""

    key: str
    where: str
    title: str
    make: Callable[[Desk], Panel]


PANELS: Final = (
    Place("banner", "side", "", BannerPanel),
    Place("drive", "side", "Drive: hold a button", DrivePanel),
    Place("power", "side", "Power", PowerPanel),
    Place("faults", "side", "", FaultsPanel),
    Place("scene", "middle", "", ScenePanel),
    Place("drives", "right", "Drives", DrivesPanel),
    Place("joints", "right", "Joints", JointsPanel),
    Place("plots", "right", "", PlotsPanel),
    Place("events", "right", "Events, newest first", LogPanel),
)


@cache
def stop_html() -> str:
    """Return STOP: a button, its style and its script, complete in themselves."""
    style, html, script = ((_ELEMENTS / name).read_text() for name in ("page.css", "stop.html", "stop.js"))
    return f"<style>{style}</style>\n{html}\n<script>{script}</script>"


def build_waiting(robot: str, why: str) -> None:
    """Make the page of a robot that has never been there: STOP, and why it does not reach anybody."""
    ui.add_body_html(stop_html())
    text = f"<div class='cc-head'><span class='cc-name'>{escape(robot)}</span></div>"
    note = f"<div class='cc-cause cc-bad'>not connected<span>{escape(why)}</span></div>"
    with ui.element("main").classes("cc-page"), ui.element("div").classes("cc-side"):
        ui.html(f"<div class='cc-panel cc-p-banner'>{text}{note}</div>", sanitize=False)


class Page:
    """Made in the page that is current; `show` and `send` keep it up to date."""

    def __init__(self, desk: Desk) -> None:
        self._desk, self.client = desk, ui.context.client
        self._commanded: Mapping[str, str] | None = None
        self._lost: bool | None = None
        self._latched: bool | None = None
        self._linear = desk.robot.linear
        ui.add_body_html(stop_html())
        self._panels: list[Panel] = []
        with ui.element("main").classes("cc-page"):
            for where in ("side", "middle", "right"):
                with ui.element("div").classes(f"cc-{where}"):
                    self._panels += [self._place(place) for place in PANELS if place.where == where]
        self._feed = Feed()

    def _place(self, place: Place) -> Panel:
        if place.where == "middle":
            return place.make(self._desk)
        with ui.element("section").classes(f"cc-panel cc-p-{place.key}"):
            if place.title:
                ui.html(escape(place.title), sanitize=False, tag="h2")
            return place.make(self._desk)

    def show(self, picture: Picture) -> None:
        """Show what is known now; a few times a second."""
        with self.client:
            for panel in self._panels:
                panel.show(picture)

    def news(self, picture: Picture) -> FeedMessage:
        """Return what of the picture the feed has to tell this page: what has changed since the last time."""
        found: FeedMessage = {}
        if picture.commanded != self._commanded:
            self._commanded = picture.commanded
            found["titles"] = titles(picture.commanded, self._linear)
        if bool(picture.lost) is not self._lost:
            self._lost = found["lost"] = bool(picture.lost)
        if picture.state.latched is not self._latched:
            self._latched = found["latched"] = picture.state.latched
        return found

    def send(self, data: FeedMessage) -> None:
        """Send to the page's scene and plots; nothing at all says that the view is alive."""
        self._feed.send(data)

    def reload(self) -> None:
        """Load it anew: the robot is another one."""
        self.client.run_javascript("location.reload()")
