"""Plots of the last 30 seconds: command and actual of each joint, following error, cycle and bus."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.view.elements.strip_charts import StripCharts
from canopen_control.view.history import SPAN_S
from canopen_control.view.sampling import charts

if TYPE_CHECKING:
    from canopen_control.view.desk import Desk
    from canopen_control.view.picture import Picture

__all__ = ["PlotsPanel"]

_TABS: Final = {"joints": "Joints", "cycle": "Cycle and bus"}


class PlotsPanel:
    """Tabs of charts, which the page's feed keeps up to date."""

    def __init__(self, desk: Desk) -> None:
        found = charts(desk.robot.welcome.joints, desk.robot.welcome.buses)
        with ui.tabs().props("dense align=left no-caps") as tabs:
            made = {group: ui.tab(group, title) for group, title in _TABS.items()}
        with ui.tab_panels(tabs, value=made["joints"], animated=False, keep_alive=True).classes("cc-stale"):
            for group, tab in made.items():
                with ui.tab_panel(tab):
                    StripCharts([chart for chart in found if chart.group == group], desk.robot.history.names, SPAN_S)

    def show(self, picture: Picture) -> None:
        """Leave it to the feed."""
