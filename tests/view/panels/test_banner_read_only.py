import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")
from support.pages import FakeContext, html, state, visited
from support.samples import event_of

from canopen_control.view.panels.banner import DrivesPanel, EventsPanel, JointsPanel


def test_what_was_is_not_shown_as_what_is():
    context = FakeContext()

    async def act(user, panel):
        panel.show(context.content())
        before = html(user)
        panel.show(context.content(lost="it has died"))
        return before, html(user)

    before, after = visited(lambda: DrivesPanel(context), act)
    assert "enabled, follows commands" in before
    assert "enabled" not in after
    assert "No connection" in after


def test_the_joints_are_told_in_their_units_and_stay_when_the_robot_is_lost():
    context = FakeContext()

    async def act(user, panel):
        panel.show(context.content())
        before = html(user)
        panel.show(context.content(state(joints={}), lost="it has died"))
        return before, html(user)

    before, after = visited(lambda: JointsPanel(context), act)
    assert "2.50<wbr><small>velocity" in before
    assert "0.10<wbr><small>m<" in before
    assert before == after


def test_an_event_is_shown_and_escaped():
    context = FakeContext()
    context.robot.events.add(event_of({"time": 1.0, "kind": "x", "level": "error", "text": "<img src=x onerror=1>"}))

    async def act(user, panel):
        panel.show(context.content())
        return html(user)

    assert "&lt;img" in visited(lambda: EventsPanel(context), act)
