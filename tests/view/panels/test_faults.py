import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from nicegui import ui
from support.pages import Desk, html, seen, settle, visited

from canopen_control.errors import RemoteError
from canopen_control.view.faults import FaultBoard
from canopen_control.view.panels.faults import FaultsPanel


def played(act, switch=None):
    desk = Desk().with_faults()
    switched = []
    desk.robot.fault_desk.switch = switch or (lambda *args, **how: switched.append((*args, how["on"])))

    async def show(user, panel):
        panel.show(desk.picture())
        return await act(user, panel, desk)

    return visited(lambda: FaultsPanel(desk), show), switched


def test_drives_and_faults_are_offered_and_what_is_on_is_said():
    async def act(user, _panel, _desk):
        drive, fault = seen(ui.select)
        assert (drive.value, fault.value, fault.options) == ("left_drive", "silent", ["silent", "hot"])
        fault.value = "hot"
        return html(user)

    found, _ = played(act)
    assert "left_drive: silent" in found
    assert "The drive is hot (once)" in found


def test_a_fault_is_switched():
    async def act(user, _panel, _desk):
        user.find("Switch off").click()
        user.find("Switch on").click()
        await settle()

    _, switched = played(act)
    assert sorted(switched) == [("left_drive", "silent", False), ("left_drive", "silent", True)]


def test_what_the_drive_refuses_is_told():
    def refuse(*_args, **_how):
        raise RemoteError("DriveError", "not while it moves")

    async def act(user, _panel, _desk):
        user.find("Switch on").click()
        await settle(turns=10)
        await user.should_see("not while it moves")

    played(act, refuse)


def test_where_no_drive_is_virtual_nothing_is_offered():
    async def act(user, panel, desk):
        desk.robot.faults = FaultBoard()
        panel.show(desk.picture())
        return html(user)

    assert "No virtual drive" in played(act)[0]
