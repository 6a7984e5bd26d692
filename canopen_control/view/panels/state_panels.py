"""Panels that show a robot: its state with the next step, drives, joints, events, the robot in 3D, and plots.

The page's feed moves the robot in 3D, and adds to the plots of the last 30 seconds.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from canopen_control.rpc.messages.robot import AxisRequest, Release
from canopen_control.view.elements.nicegui_elements import RobotScene, StripCharts
from canopen_control.view.panels.panel import Html, show_notice
from canopen_control.view.robot_connection import SOURCE
from canopen_control.view.sampling import SPAN_S, charts
from canopen_control.view.words import axis_rows, chip, drive_table, event_log, facts, joint_table

if TYPE_CHECKING:
    from canopen_control.rpc.messages.declare import Request
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext


# Read-only panels: the tables of drives and joints, and the list of events.


_UNKNOWN = "<p class='cc-note'>No connection: the state of the drives is unknown.</p>"


class DrivesPanel:
    """Table of drives, or a note while the robot is not connected."""

    def __init__(self, context: PanelContext) -> None:
        del context
        self._table = Html()

    def show(self, content: PageContent) -> None:
        self._table.show(_UNKNOWN if content.lost else drive_table(axis_rows(content.state)))


class JointsPanel:
    """Table of joints, in SI units."""

    def __init__(self, context: PanelContext) -> None:
        self._linear = context.robot.linear
        self._table = Html("cc-stale")

    def show(self, content: PageContent) -> None:
        """Update the table of joints; without a connection, the last values remain, greyed out."""
        if not content.lost:
            self._table.show(joint_table(content.state.joints, self._linear, content.commanded))


class EventsPanel:
    """Scrolling list of events."""

    def __init__(self, context: PanelContext) -> None:
        del context
        self._log = Html("cc-log")

    def show(self, content: PageContent) -> None:
        self._log.show(event_log(content.events))


# next action by the `action` of the banner: label, colour, request to the robot
_ACTIONS: Final[dict[str, tuple[str, str, Request[Any]]]] = {
    "release": ("Release STOP", "orange-9", Release(source=SOURCE)),
    "enable": ("Enable", "green-8", AxisRequest(action="enable", node="all", source=SOURCE)),
    "fault-reset": ("Reset fault", "red-8", AxisRequest(action="fault-reset", node="all", source=SOURCE)),
}


class BannerPanel:
    """State of the robot, with a button for the next step."""

    def __init__(self, context: PanelContext) -> None:
        self._context = context
        self._head = Html()
        self._buttons = {action: self._button(action) for action in _ACTIONS}
        self._facts = Html("cc-stale")

    def _button(self, action: str) -> ui.button:
        label, color, _ = _ACTIONS[action]
        button = ui.button(label, color=color, on_click=lambda: self._act(action)).classes("cc-next")
        button.props("unelevated").visible = False
        return button

    def show(self, content: PageContent) -> None:
        banner = content.banner
        name = f"<span class='cc-name'>{escape(self._context.robot.info.robot)}</span>"
        advice = f"<span>{escape(banner.advice)}</span>" if banner.advice else ""
        box = (
            f"<div class='cc-cause cc-{banner.tone}'>{escape(banner.cause)}{advice}</div>"
            if banner.cause or advice
            else ""
        )
        self._head.show(f"<div class='cc-head'>{name}{chip(banner.words, banner.tone)}</div>{box}")
        self._facts.show(facts(content.state))
        for action, button in self._buttons.items():
            if button.visible is not (action == banner.action):
                button.visible = action == banner.action

    async def _act(self, action: str) -> None:
        label, _, request = _ACTIONS[action]
        refused = await self._context.ask(request)
        if refused is not None:
            show_notice(f"{label}: not done", refused)


_TABS: Final = {"joints": "Joints", "cycle": "Cycle and bus"}


class ScenePanel:
    """Panel with the robot in 3D, moved by the page's feed."""

    def __init__(self, context: PanelContext) -> None:
        with ui.element("div").classes("cc-stale").style("position: absolute; inset: 0"):
            scene = RobotScene(context.robot.scene.tree)
        ui.checkbox("Camera follows", value=True, on_change=lambda event: scene.follow(bool(event.value))).props(
            "dense"
        ).classes("cc-follow")

    def show(self, content: PageContent) -> None:
        """Do nothing, because the feed updates the scene."""


class PlotsPanel:
    """Panel with tabs of charts, updated by the page's feed."""

    def __init__(self, context: PanelContext) -> None:
        plots = charts(context.robot.info.joints, context.robot.info.buses)
        with ui.tabs().props("dense align=left no-caps") as tabs:
            tab_of = {group: ui.tab(group, title) for group, title in _TABS.items()}
        with ui.tab_panels(tabs, value=tab_of["joints"], animated=False, keep_alive=True).classes("cc-stale"):
            for group, tab in tab_of.items():
                with ui.tab_panel(tab):
                    StripCharts([chart for chart in plots if chart.group == group], context.robot.history.names, SPAN_S)

    def show(self, content: PageContent) -> None:
        """Do nothing, because the feed updates the charts."""
