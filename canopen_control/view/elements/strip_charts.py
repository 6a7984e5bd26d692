"""Strip charts of the last 30 seconds: the browser keeps the samples, so that only new ones are sent."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from nicegui.element import Element

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.view.sampling import Chart

__all__ = ["StripCharts"]


class StripCharts(Element, component="strip_charts.js"):
    """Draws what the feed brings: `plots` {"rows": [[time, value, ...], ...]} by `names`, and `titles` by chart."""

    def __init__(self, charts: Sequence[Chart], names: Sequence[str], span: float) -> None:
        super().__init__()
        self._props["charts"] = [asdict(chart) for chart in charts]
        self._props["names"] = list(names)
        self._props["span"] = span
        self.classes("cc-strips")
