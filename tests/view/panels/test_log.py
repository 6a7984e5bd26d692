import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import Desk, html, visited
from support.samples import event_of

from canopen_control.view.panels.log import LogPanel


def test_an_event_is_shown_and_escaped():
    desk = Desk()
    desk.robot.events.add(event_of({"time": 1.0, "kind": "x", "level": "error", "text": "<img src=x onerror=1>"}))

    async def act(user, panel):
        panel.show(desk.picture())
        return html(user)

    assert "&lt;img" in visited(lambda: LogPanel(desk), act)
