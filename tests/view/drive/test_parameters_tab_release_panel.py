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


def played(act, new=None, **how):
    page = FakeContext(**how)

    async def begin(user, panel):
        panel.show(page.content(new))
        return await act(user, page)

    return visited(lambda: ReleasePanel(DriveTabContext(page, page.robot.node_jobs("left_drive"))), begin)


async def look(user, _page):
    return html(user), [(each.text, each.enabled) for each in seen(ui.button)]


def test_an_enabled_drive_is_not_taken_out():
    words, buttons = played(look)
    assert "Parameter sets cannot be written to an enabled drive; disable left first." in words
    assert buttons == [("Take out of the robot", False)]


@pytest.mark.rest
def test_a_drive_is_taken_out_and_given_back_by_the_robot():
    async def press(user, page):
        user.find(seen(ui.button)[0].text).click()
        await settle(lambda: page.asked)
        return page.asked

    assert played(press, drive_state(OFF)) == [NmtRequest(command="preop", node="left_drive", source="view")]
    assert played(press, drive_state(OFF, **OUT)) == [NmtRequest(command="start", node="left_drive", source="view")]


def test_what_the_robot_refuses_is_told():
    async def press(user, page):
        page.refusal = "STOP is latched"
        user.find("Take out of the robot").click()
        await expect_seen(user, "left_drive: not taken out: STOP is latched")

    played(press, drive_state(OFF))


@pytest.mark.rest
def test_taken_out_is_said_of_a_node_that_has_confirmed_it():
    assert "The node is taken out of the robot, which sends it no commands" in played(look, drive_state(OFF, **OUT))[0]
    for more in ({"nmt_state": "OPERATIONAL"}, {"nmt_state": None}, {"age_s": None}):
        words = played(look, drive_state(OFF, **OUT | more))[0]
        assert "has not confirmed that" in words
        assert "sends it no commands" not in words


def test_taken_out_does_not_hide_that_the_robot_is_in_fault():
    new = structs.replace(drive_state(OFF, **OUT, error="guarding: no answer"), state="fault")
    words = played(look, new)[0]
    assert (
        "The node is taken out of the robot (pre-operational), and the robot is in fault: left_drive: guarding" in words
    )
    assert "sends it no commands" not in words
