"""Panels with the robot in 3D and with plots of the last 30 seconds, updated by the page's feed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.view.elements.nicegui_elements import RobotScene, StripCharts
from canopen_control.view.sampling import SPAN_S, charts

if TYPE_CHECKING:
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext


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
        """Do nothing, since the feed updates the scene."""


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
        """Do nothing, since the feed updates the charts."""
