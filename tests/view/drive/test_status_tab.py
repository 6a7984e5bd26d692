import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import FakeContext, html, visited

from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.status_tab import StatusTab


def test_it_shows_the_node():
    page = FakeContext()

    async def act(user, tab):
        tab.show(page.content())
        return html(user)

    text = visited(lambda: StatusTab(DriveTabContext(page, page.robot.desk("left_drive"))), act)
    assert "enabled, follows commands" in text
