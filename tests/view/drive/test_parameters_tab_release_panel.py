import contextlib

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

from msgspec import structs
from nicegui import ui
from support.pages import FakeContext, drive_state, expect_seen, html, seen, settle, visited

from canopen_control.rpc.messages.robot import NmtRequest
from canopen_control.view.drive.drive_tab import DriveTabContext
from canopen_control.view.drive.parameters_tab import ReleasePanel

OFF = {"cia402_state": "SWITCH_ON_DISABLED"}
OUT = {"taken_out": True, "nmt_state": "PRE_OPERATIONAL", "ready": False}


@contextlib.asynccontextmanager
async def played(new=None, **how):
    page = FakeContext(**how)
    context = DriveTabContext(page, page.robot.node_jobs("left_drive"))
    async with visited(lambda: ReleasePanel(context)) as (user, panel):
        panel.show(page.content(new))
        yield user, page


async def look(new=None):
    async with played(new) as (user, _page):
        return html(user), [(item.text, item.enabled) for item in seen(ui.button)]


async def test_an_enabled_drive_is_not_taken_out():
    words, buttons = await look()
    assert "Parameter sets cannot be written to an enabled drive; disable left first." in words
    assert buttons == [("Take out of the robot", False)]


@pytest.mark.rest
@pytest.mark.parametrize(("node", "command"), [({}, "preop"), (OUT, "start")], ids=["taken out", "given back"])
async def test_a_drive_is_taken_out_and_given_back_by_the_robot(node, command):
    async with played(drive_state(OFF, **node)) as (user, page):
        user.find(seen(ui.button)[0].text).click()
        await settle(lambda: page.asked)
    assert page.asked == [NmtRequest(command=command, node="left_drive", source="view")]


async def test_what_the_robot_refuses_is_reported():
    async with played(drive_state(OFF)) as (user, page):
        page.refusal = "STOP is latched"
        user.find("Take out of the robot").click()
        await expect_seen(user, "left_drive: not taken out: STOP is latched")


@pytest.mark.rest
async def test_taken_out_is_reported_of_a_node_that_has_confirmed_it():
    assert "The node is taken out of the robot, which sends it no commands" in (await look(drive_state(OFF, **OUT)))[0]
    for more in ({"nmt_state": "OPERATIONAL"}, {"nmt_state": None}, {"age_s": None}):
        words, _ = await look(drive_state(OFF, **OUT | more))
        assert "has not confirmed that" in words
        assert "sends it no commands" not in words


async def test_taken_out_does_not_hide_that_the_robot_is_in_fault():
    new = structs.replace(drive_state(OFF, **OUT, error="guarding: no answer"), state="fault")
    words, _ = await look(new)
    assert (
        "The node is taken out of the robot (pre-operational), and the robot is in fault: left_drive: guarding" in words
    )
    assert "sends it no commands" not in words
