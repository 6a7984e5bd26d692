import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")
from nicegui import ui
from support.pages import FakeContext, seen, visited

from canopen_control.view.elements.nicegui_elements import RobotScene, StripCharts
from canopen_control.view.panels.state_panels import PlotsPanel, ScenePanel


async def test_the_robot_is_there_and_the_camera_releases_it(monkeypatch):
    context, called = FakeContext(), []
    monkeypatch.setattr(RobotScene, "run_method", lambda self, name, *args: called.append((name, args)))
    async with visited(lambda: ScenePanel(context)) as (_user, _panel):
        assert seen(RobotScene)[0].props["tree"]["root"] == "base"
        seen(ui.checkbox)[0].value = False
    assert called == [("setFollow", (False,))]


async def test_every_chart_is_in_its_tab():
    context = FakeContext()
    async with visited(lambda: PlotsPanel(context)) as (user, _panel):
        result = [
            [chart["key"] for chart in element.props["charts"]] for element in user.find(kind=StripCharts).elements
        ]
    assert sorted(result) == [["cycle", "work", "load"], ["left", "lift", "error"]]
