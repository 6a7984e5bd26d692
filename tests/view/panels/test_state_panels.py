import msgspec
import pytest
from support.pages import FakeContext, drive_state, expect_seen, html, seen, settle, state, visited
from support.samples import event_of

from canopen_control.rpc.messages.robot import Release
from canopen_control.view.panels.state_panels import BannerPanel, DrivesPanel, EventsPanel, JointsPanel

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


async def test_what_was_is_not_shown_as_what_is():
    context = FakeContext()
    async with visited(lambda: DrivesPanel(context)) as (user, panel):
        panel.show(context.content())
        before = html(user)
        panel.show(context.content(lost="it has died"))
        after = html(user)
    assert "enabled, follows commands" in before
    assert "enabled" not in after
    assert "No connection" in after


async def test_the_joints_are_reported_in_their_units_and_stay_when_the_robot_is_lost():
    context = FakeContext()
    async with visited(lambda: JointsPanel(context)) as (user, panel):
        panel.show(context.content())
        before = html(user)
        panel.show(context.content(state(joints={}), lost="it has died"))
        after = html(user)
    assert "2.50<wbr><small>velocity" in before
    assert "0.10<wbr><small>m<" in before
    assert before == after


async def test_an_event_is_shown_and_escaped():
    context = FakeContext()
    context.robot.events.add(event_of({"time": 1.0, "kind": "x", "level": "error", "text": "<img src=x onerror=1>"}))
    async with visited(lambda: EventsPanel(context)) as (user, panel):
        panel.show(context.content())
        assert "&lt;img" in html(user)


async def shown(new=None, lost="", press=False, refusal=None):
    """Return the HTML, the labels of the buttons that are there, and what the robot was asked for."""
    from nicegui import ui

    context = FakeContext()
    context.refusal = refusal

    async with visited(lambda: BannerPanel(context)) as (user, panel):
        panel.show(context.content(new, lost))
        labels = [button.text for button in seen(ui.button)]
        if press:
            user.find(kind=ui.button, content=labels[0]).click()
            await settle(lambda: context.asked)
            if refusal:
                await expect_seen(user, refusal)
        return html(user), labels, context.asked


async def test_a_latched_stop_has_its_remedy():
    text, labels, requested = await shown(state(latched=True, latched_by="view"), press=True)
    assert "STOP is latched" in text
    assert labels == ["Release STOP"]
    assert requested == [Release(source="view")]


async def test_a_fault_reports_its_cause_and_is_reset_from_here():
    new = drive_state({"cia402_state": "FAULT", "error": "too hot"})
    text, labels, _ = await shown(msgspec.structs.replace(new, state="fault"))
    assert "left_drive: too hot" in text
    assert labels == ["Reset fault"]


async def test_what_the_robot_refuses_is_reported():
    *_, requested = await shown(state(latched=True), press=True, refusal="somebody else has latched it")
    assert len(requested) == 1
