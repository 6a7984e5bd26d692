import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import Desk, html, visited

from canopen_control.view.panels.drives import DrivesPanel


def test_what_was_is_not_shown_as_what_is():
    desk = Desk()

    async def act(user, panel):
        panel.show(desk.picture())
        before = html(user)
        panel.show(desk.picture(lost="it has died"))
        return before, html(user)

    before, after = visited(lambda: DrivesPanel(desk), act)
    assert "enabled, follows commands" in before
    assert "enabled" not in after
    assert "No connection" in after
