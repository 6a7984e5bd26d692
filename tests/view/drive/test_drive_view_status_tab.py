import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from support.pages import AXIS, NODE, TARGET, FakeContext, StubDesk, at_rest, drive_state, html, state, visited
from support.service_node import NodeStub

from canopen_control.errors import SdoTimeout
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.drive_view import StatusTab
from canopen_control.view.elements.nicegui_elements import HoldButtons
from canopen_control.view.page_content import RecentEvents

HISTORY = {(0x1003, 0): b"\1", (0x1003, 1): (0x2310).to_bytes(4, "little")}


@contextlib.asynccontextmanager
async def played(page=None, *, new=None, held=HISTORY, axes=1):
    page = page or FakeContext()
    desk = StubDesk(NodeStub(held), None)
    desk.place = type(desk.place)(name="left_drive", node_id=3, bus="can", axes=axes)
    async with visited(lambda: StatusTab(DriveTabContext(page, desk))) as (user, tab):
        tab.show(page.content(new))
        await at_rest()
        yield user, tab


async def read(*page, **how):
    async with played(*page, **how) as (user, _tab):
        return html(user)


async def test_it_shows_the_state_of_the_node_from_the_robot():
    text = await read(new=drive_state({"statusword": 0x1637}, taken_out=True, sdo={"reads": 7}))
    assert "operational, taken out of the robot" in text
    assert "operation enabled, mode PV" in text
    assert "7 reads, 0 writes, 0 failed" in text
    assert "left: 0x1637" in text
    assert "<span class='cc-set'>12 speed is zero</span>" in text
    assert "forward commands this drive" in text


@pytest.mark.rest
async def test_it_shows_the_error_history_of_the_drive():
    assert "0x2310" in await read()
    assert "error history is empty" in await read(held={(0x1003, 0): b"\0"})
    assert "has no error history" in await read(held={})


async def test_a_node_that_does_not_answer_is_reported():
    async with played() as (user, tab):
        tab._context.node_jobs.stub.error = SdoTimeout(3, 0x1003, 0, 0.5)
        user.find("Read again").click()
        await at_rest()
        assert "no answer" in html(user)


async def test_only_the_events_of_this_node_are_there():
    page = FakeContext()
    page.robot.events = RecentEvents(
        RobotEvent(time=1.0, kind="emcy", node=node, level="warning", text=f"of {node}")
        for node in ("left_drive", "io")
    )
    text = await read(page)
    assert "of left_drive" in text
    assert "of io" not in text


async def test_a_drive_that_takes_targets_is_driven_while_a_button_is_held_and_left_when_the_tab_is():
    page = FakeContext(controllers=(TARGET,))
    async with played(page) as (user, tab):
        user.find(kind=HoldButtons).trigger("hold", "target")
        tab.leave()
    assert len(page.held) == 1
    assert page.let >= 1


async def test_what_is_not_a_drive_has_no_statusword_and_nothing_moves_it():
    text = await read(new=state(nodes={"left_drive": NODE | {"axes": []}}), axes=0)
    assert "This node is not a drive" in text
    assert "0x1637" not in text


async def test_a_drive_that_is_not_commanded_is_reported():
    page = FakeContext(controllers=())
    new = drive_state(AXIS | {"error": "following error"})
    text = await read(page, new=new)
    assert "No active controller commands this drive" in text
    assert "following error" in text
