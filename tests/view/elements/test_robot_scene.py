import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import visited

from canopen_control.view.elements import robot_scene
from canopen_control.view.elements.robot_scene import RobotScene


def test_three_js_is_the_toolkits_own():
    assert (robot_scene._THREE / "index.js").is_file()


def test_it_is_given_its_tree():
    async def act(_user, scene):
        return scene.props["tree"]

    assert visited(lambda: RobotScene({"root": "base"}), act) == {"root": "base"}
