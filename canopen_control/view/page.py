"""One page of the robot, as one browser has it: STOP, then the panels of the table below, the Drive view, and the feed.

STOP is plain HTML and needs nothing of what follows. A new panel is a class in `panels` and a line in `PANELS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.view.drive.drive_view import DriveView
from canopen_control.view.elements.nicegui_elements import Feed
from canopen_control.view.panels.banner import BannerPanel
from canopen_control.view.panels.fault_panel import FaultPanel
from canopen_control.view.panels.power import PowerPanel
from canopen_control.view.panels.read_only import DrivesPanel, EventsPanel, JointsPanel
from canopen_control.view.panels.scene_and_plots import PlotsPanel, ScenePanel
from canopen_control.view.panels.target_panel import TargetPanel
from canopen_control.view.panels.teleop_panel import TeleopPanel
from canopen_control.view.panels.trajectory_panel import TrajectoryPanel
from canopen_control.view.panels.world_panel import WorldPanel
from canopen_control.view.sampling import titles

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.view.elements.nicegui_elements import FeedMessage
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import Panel, PanelContext

__all__ = ["PANELS", "Page", "PanelSlot", "build_waiting", "stop_html"]

_ELEMENTS: Final = Path(__file__).parent / "elements"


@dataclass(frozen=True, slots=True)
class PanelSlot:
    """A panel and where it stands: "side", "middle" or "right"; without a title it has no frame of its own."""

    key: str
    where: str
    title: str
    make: Callable[[PanelContext], Panel]


PANELS: Final = (
    PanelSlot("banner", "side", "", BannerPanel),
    PanelSlot("drive", "side", "Teleop: hold a button", TeleopPanel),
    PanelSlot("targets", "side", "Drives by their targets", TargetPanel),
    PanelSlot("trajectory", "side", "Trajectory", TrajectoryPanel),
    PanelSlot("power", "side", "Power", PowerPanel),
    PanelSlot("faults", "side", "", FaultPanel),
    PanelSlot("world", "side", "", WorldPanel),
    PanelSlot("scene", "middle", "", ScenePanel),
    PanelSlot("drives", "right", "Drives", DrivesPanel),
    PanelSlot("joints", "right", "Joints", JointsPanel),
    PanelSlot("plots", "right", "", PlotsPanel),
    PanelSlot("events", "right", "Events, newest first", EventsPanel),
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

    def __init__(self, context: PanelContext) -> None:
        self._context, self.client = context, ui.context.client
        self._commanded: Mapping[str, str] | None = None
        self._lost: bool | None = None
        self._latched: bool | None = None
        self._linear = context.robot.linear
        ui.add_body_html(stop_html())
        self._panels: list[Panel] = []
        columns = {}
        with ui.element("main").classes("cc-page") as main:
            for where in ("side", "middle", "right"):
                with ui.element("div").classes(f"cc-{where}") as columns[where]:
                    self._panels += [self._make(slot) for slot in PANELS if slot.where == where]
            self._drive = DriveView(context, main, columns["side"], _query())
        self._feed = Feed()

    def _make(self, slot: PanelSlot) -> Panel:
        if slot.where == "middle":
            return slot.make(self._context)
        with ui.element("section").classes(f"cc-panel cc-p-{slot.key}"):
            if slot.title:
                ui.html(escape(slot.title), sanitize=False, tag="h2")
            return slot.make(self._context)

    def show(self, content: PageContent) -> None:
        """Show what is known now; a few times a second."""
        with self.client:
            for panel in self._panels:
                panel.show(content)
            self._drive.show(content)

    def leave(self) -> None:
        """End what this page alone reads: it is closed."""
        self._drive.leave()

    def changes(self, content: PageContent) -> FeedMessage:
        """Return what the feed has to tell this page: what of the content has changed since the last time."""
        found: FeedMessage = {}
        if content.commanded != self._commanded:
            self._commanded = content.commanded
            found["titles"] = titles(content.commanded, self._linear)
        if bool(content.lost) is not self._lost:
            self._lost = found["lost"] = bool(content.lost)
        if content.state.latched is not self._latched:
            self._latched = found["latched"] = content.state.latched
        return found

    def send(self, data: FeedMessage) -> None:
        """Send to the page's scene and plots; nothing at all says that the view is alive."""
        self._feed.send(data)

    def reload(self) -> None:
        """Load it anew: the robot is another one."""
        self.client.run_javascript("location.reload()")


def _query() -> dict[str, str]:
    """Return what the page was asked for, which says where in it the user was."""
    return dict(ui.context.client.request.query_params)
