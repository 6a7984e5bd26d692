import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import Desk, seen, visited

from canopen_control.view.elements.robot_scene import RobotScene
from canopen_control.view.panels.scene import ScenePanel


def test_the_robot_is_there_and_the_camera_lets_go_of_it(monkeypatch):
    desk, called = Desk(), []
    monkeypatch.setattr(RobotScene, "run_method", lambda self, name, *args: called.append((name, args)))

    async def act(user, _panel):
        assert seen(RobotScene)[0].props["tree"]["root"] == "base"
        seen(ui.checkbox)[0].value = False

    visited(lambda: ScenePanel(desk), act)
    assert called == [("setFollow", (False,))]
