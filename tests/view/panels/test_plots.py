import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import Desk, visited

from canopen_control.view.elements.strip_charts import StripCharts
from canopen_control.view.panels.plots import PlotsPanel


def test_every_chart_stands_in_its_tab():
    desk = Desk()

    async def act(user, _panel):
        return [[chart["key"] for chart in each.props["charts"]] for each in user.find(kind=StripCharts).elements]

    found = visited(lambda: PlotsPanel(desk), act)
    assert sorted(found) == [["cycle", "work", "load"], ["left", "lift", "error"]]
