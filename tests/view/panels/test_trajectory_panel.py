import contextlib
import json

import pytest

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")

import asyncio

from nicegui import ui
from nicegui.elements.upload_files import SmallFileUpload
from support.pages import FORWARD, FakeContext, html, seen, settle, visited

from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.view.elements.nicegui_elements import Feed, PresenceElement
from canopen_control.view.panels.trajectory_panel import TrajectoryPanel
from canopen_control.view.trajectory_player import MAX_BYTES, TrajectoryOutcome

ARM = FORWARD | {"name": "arm", "topic": None, "tells": "trajectory", "joints": ["lift"]}
ARM_2 = ARM | {"name": "arm_2"}
WAVE = {"joint_names": ["lift"], "points": [{"positions": [0.1], "time_from_start": 0.5},
                                            {"positions": [0.4], "time_from_start": 2.0}]}  # fmt: skip


class Player:
    """Ends on request."""

    def __init__(self):
        self.played, self.cancelled, self.there = [], [], 0
        self.ended = asyncio.Event()
        self.result = TrajectoryOutcome(True, "the goal was reached")

    async def play(self, page, controller, trajectory):
        self.played.append((controller, trajectory.name))
        await self.ended.wait()
        return self.result

    def cancel(self, page):
        self.cancelled.append(page)

    def here(self, page):
        self.there += 1


@contextlib.asynccontextmanager
async def played(controllers=(FORWARD, ARM), **how):
    context = FakeContext(controllers=controllers, **how)
    context.player = Player()
    context.ghosts = []

    def build():
        with ui.element("section") as context.frame:
            panel = TrajectoryPanel(context)
        panel._feed.send = lambda data: context.ghosts.append(data["ghost"])
        return panel

    async with visited(build, context) as (user, panel):
        yield user, panel, context


async def upload(user, data=None, name="wave.json"):
    inputs = json.dumps(WAVE).encode() if data is None else data
    await seen(ui.upload)[0].handle_uploads([SmallFileUpload(name, "", inputs)])
    await settle(lambda: "Preview" in html(user) or "Not loaded." in html(user))


@pytest.mark.rest
@pytest.mark.parametrize(("arm", "visible"), [("active", True), ("inactive", False)])
async def test_without_such_a_controller_the_panel_is_not_there(arm, visible):
    async with played(controllers=(FORWARD, ARM | {"state": arm})) as (_user, panel, context):
        assert context.frame.visible is visible
        context.robot.controllers = ()
        panel.show(context.content())
        assert not context.frame.visible


async def test_a_file_is_previewed_and_nothing_is_asked_of_the_robot():
    async with played() as (user, _panel, context):
        await upload(user)
        first = html(user)
        assert seen(ui.slider)[0].props["max"] == 1
        seen(ui.slider)[0].value = 1
        second = html(user)
    assert "wave.json. Preview, the robot does not move: point 1 of 2, at 0.50 s." in first
    assert "0.100<small>m</small></td><td>0.100" in first
    assert "point 2 of 2, at 2.00 s" in second
    assert "0.400<small>m</small></td><td>0.100" in second
    assert context.ghosts == [[1.0, 0.1], [1.0, 0.4]]
    assert (context.asked, context.player.played) == ([], [])


async def test_a_preview_that_is_closed_is_drawn_no_more():
    async with played() as (user, _panel, context):
        await upload(user)
        user.find("Close preview").click()
        await settle(lambda: context.ghosts[-1] is None)
        ghosts, visible = context.ghosts, seen(ui.slider)[0].parent_slot.parent.parent_slot.parent.visible
    assert ghosts[-1] is None
    assert not visible


@pytest.mark.parametrize(
    ("data", "words"), [(b"joint_name: [a]", "joint_name"), (b" " * (MAX_BYTES + 1), f"at most {MAX_BYTES} bytes")]
)
async def test_a_file_that_cannot_be_read_is_reported(data, words):
    async with played() as (user, _panel, context):
        await upload(user, data)
        await settle(lambda: words in html(user))
        text, ghosts = html(user), context.ghosts
    assert "cc-bad'>Not loaded." in text
    assert words in text
    assert ghosts == []


async def test_it_is_played_while_the_page_reports_that_it_is_there():
    async with played() as (user, panel, context):
        await upload(user)
        presence = user.find(kind=PresenceElement)
        (element,) = presence.elements
        off = element.props["on"]
        user.find("Play").click()
        await settle(lambda: context.player.played)
        on = element.props["on"]
        presence.trigger("here")
        sample = TrajectorySample(
            time=1.0, joints=("lift",), executing=True, holding=False, feedback=TrajectoryPoint(),
            reference=TrajectoryPoint(time_from_start=1.5), error=TrajectoryPoint(), output=TrajectoryPoint(),
        )  # fmt: skip
        context.robot.state.samples["arm"] = sample
        panel.show(context.content())
        during = html(user)
        assert not seen(ui.upload)
        assert context.ghosts[-1] is None
        context.player.ended.set()
        await settle(lambda: "goal was reached" in html(user))
        after, end = element.props["on"], html(user)
    assert (off, on, after) == (False, True, False)
    assert "Playing: 1.5 of 2.0 s." in during
    assert "cc-good'>the goal was reached" in end
    assert (context.player.played, context.player.there) == ([("arm", "wave.json")], 1)


async def test_what_is_refused_is_the_robots_sentence_and_stays():
    async with played() as (user, panel, context):
        context.player.result = TrajectoryOutcome(False, "joint <1> is disabled")
        context.player.ended.set()
        await upload(user)
        user.find("Play").click()
        await settle(lambda: "disabled" in html(user))
        panel.show(context.content())
        assert "cc-bad'>joint &lt;1&gt; is disabled" in html(user)


async def test_a_read_only_page_previews_and_does_not_play():
    async with played(teleop=False) as (user, _panel, _context):
        await upload(user)
        buttons, text = [item.text for item in seen(ui.button)], html(user)
    assert "Play" not in buttons
    assert "point 1 of 2" in text
    assert "view --teleop" in text


async def test_of_several_controllers_one_is_chosen():
    async with played(controllers=(ARM, ARM_2)) as (user, _panel, context):
        (choice,) = seen(ui.select)
        assert choice.options == ["arm", "arm_2"]
        choice.value = "arm_2"
        await upload(user)
        context.player.ended.set()
        user.find("Play").click()
        await settle(lambda: context.player.played)
        assert context.player.played == [("arm_2", "wave.json")]


async def test_the_end_of_the_controller_takes_the_panel_away_only_after_the_end_of_what_is_played():
    async with played() as (user, panel, context):
        await upload(user)
        user.find("Play").click()
        await settle(lambda: context.player.played)
        context.robot.controllers = ()
        panel.show(context.content())
        during = context.frame.visible
        context.player.ended.set()
        await settle(lambda: "reached" in html(user))
        panel.show(context.content())
        assert (during, context.frame.visible) == (True, False)


async def test_the_ghost_goes_through_a_feed_of_its_own():
    async with played() as (_user, panel, _context):
        assert isinstance(panel._feed, Feed)
