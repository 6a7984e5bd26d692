"""The process of the view without a browser: on its own loop, against a robot on mock hardware."""

import asyncio
import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from nicegui import ui
from support.arm6 import ENDS, JOINTS, copy_arm, planned
from support.host import eventually
from support.mockrobot import running
from support.pages import FakeContext, at_rest, expect_seen, html, seen, settle, state, visited

from canopen_control import Robot
from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.robot import Release
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.view import view_app
from canopen_control.view.elements.nicegui_elements import Feed
from canopen_control.view.page_address import page_addresses
from canopen_control.view.robot_connection import RobotConnection, joint_motion
from canopen_control.view.trajectory_player import LoadedTrajectory
from canopen_control.view.view_app import SEEN_HZ, STILL_HZ, UNSEEN_HZ, Page, ViewApp, build_waiting, stop_html

pytest.importorskip("nicegui", reason="NiceGUI is not installed: pip install canopen-control[view]")


def made(context):
    return visited(lambda: Page(context), context)


async def test_everything_is_on_the_page_and_stop_is_before_it():
    context = FakeContext()
    async with made(context) as (user, _page):
        await expect_seen(user, "Disable")
        text, body = html(user), user._client.body_html
    for words in ("pair", "running", "enabled, follows commands", "2.50<wbr><small>velocity", "No events yet"):
        assert words in text
    assert 'id="cc-stop-button"' in body


def test_stop_needs_only_its_own_server():
    whole = stop_html()
    assert "http" not in whole
    assert "import" not in whole.split("<script>")[1]
    for word in ("nicegui", "socket", "Vue", "THREE"):
        assert word not in whole.split("<script>")[1]


async def test_only_news_are_reported():
    context = FakeContext()
    async with made(context) as (_user, page):
        first = page.changes(context.content())
        same = page.changes(context.content())
        lost = page.changes(context.content(state(latched=True), lost="gone"))

    assert first == {"titles": {"left": "left velocity, rad/s", "error": "Tracking error, rad/s"},
                     "lost": False, "latched": False}  # fmt: skip
    assert same == {}
    assert lost == {"lost": True, "latched": True}


@pytest.mark.rest
async def test_what_is_sent_goes_through_the_feed(monkeypatch):
    sent = []
    monkeypatch.setattr(Feed, "send", lambda self, data: sent.append(data))
    async with made(FakeContext()) as (_user, page):
        page.send({"scene": {}})
    assert sent == [{"scene": {}}]


async def test_a_robot_that_was_never_there_has_a_page_with_stop_and_the_reason():
    async with visited(lambda: build_waiting("<robby>", "no robot '<robby>' is running")) as (user, _made):
        text, body, buttons = html(user), user._client.body_html, seen(ui.button)
    assert "&lt;robby&gt;" in text
    assert "not connected" in text
    assert 'id="cc-stop-button"' in body
    assert buttons == []


FORWARD = "robby_forward_controller"
MOTION = joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0])


class Server:
    """In the place of the one that listens: `serve` lasts until `stop`."""

    def __init__(self, listener, rules, title, build, stop):
        listener.close()
        self.ended = asyncio.Event()

    async def serve(self, ready):
        ready()
        await self.ended.wait()

    def stop(self):
        self.ended.set()


class WholePage:
    """What a browser would have; `client` is itself."""

    def __init__(self, name="page 1"):
        self.client, self.id, self.shown, self.sent, self.loads = self, name, [], [], 0
        self.left = 0

    def show(self, content):
        self.shown.append(content)

    def changes(self, content):
        return {}

    def send(self, data):
        self.sent.append(data)

    def reload(self):
        self.loads += 1

    def leave(self):
        self.left += 1


@pytest.fixture
def robot(private_folders):
    with running(real_time=True) as robot:
        yield robot


@pytest.fixture
def play(private_folders, monkeypatch):
    """Run the view, and beside it what a test does with it."""
    monkeypatch.setattr(view_app, "PageServer", Server)
    monkeypatch.setattr(view_app, "select_robot", lambda name: name)  # it may come later

    @contextlib.asynccontextmanager
    async def play(**how):
        messages = []
        app = ViewApp("mock", "127.0.0.1", 0, **({"teleop": True, "report": messages.append} | how))
        app.said = messages
        running = asyncio.ensure_future(app.run())
        try:
            yield app
        finally:
            app.server.stop()
            await running

    return play


async def connected(app):
    await settle(lambda: app._connection is not None)


def command(robot):
    return robot.status().joints["left_wheel_joint"].command


@pytest.mark.process
def test_every_thread_of_the_process_goes_after_the_robot(robot):
    view = subprocess.Popen(
        [sys.executable, "-m", "canopen_control", "view", "--name", "mock", "--port", "0"],
        stdout=subprocess.PIPE,
        env=os.environ | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        text=True,
    )
    try:
        assert view.stdout.readline().startswith("view: http://127.0.0.1:")
        mine, priorities = os.getpriority(os.PRIO_PROCESS, 0), set()
        for task in Path(f"/proc/{view.pid}/task").iterdir():
            with contextlib.suppress(ProcessLookupError):  # a thread may have ended since
                priorities.add(os.getpriority(os.PRIO_PROCESS, int(task.name)))
        assert min(priorities) == min(19, mine + 5)
    finally:
        view.terminate()
        assert view.wait(60) == 0
        view.stdout.close()


async def test_it_reports_the_address_of_the_page_and_shows_the_robot(robot, play):
    async with play() as app:
        await connected(app)
        assert app.said == [f"view: http://127.0.0.1:{app.rules.port}/{app.rules.token}/"]
        assert page_addresses("mock") == {app.rules.place: app.rules.url}
        assert app.robot.info.joints == ("left_wheel_joint", "right_wheel_joint")
        await settle(lambda: app.robot.controllers)


async def test_controllers_are_asked_for_until_they_are_reported(robot, play, monkeypatch):
    real, tried = RobotConnection.controllers, []

    def busy(self):
        tried.append(1)
        if len(tried) < 3:
            raise RemoteError("Timeout", "it has not answered")
        return real(self)

    monkeypatch.setattr(RobotConnection, "controllers", busy)
    monkeypatch.setattr(view_app, "_RETRY_S", 0.02)
    async with play() as app:
        await connected(app)
        await settle(lambda: app.robot.controllers)
    assert len(tried) == 3


async def test_started_by_run_it_reports_through_the_robot(robot, play):
    async with play() as app:
        await connected(app)
        app._lifeline = 0  # as a child of run has one
        app.said.clear()
        app._announce(app._connection)
        await settle(lambda: any(event.kind == "view" for event in robot.status().events))
        (reported,) = [event.text for event in robot.status().events if event.kind == "view"]
        assert [reported, *app.said] == [f"view: {app.rules.place}"] * 2  # the token is in no event and in no log
        app._lifeline = None


async def test_samples_are_fast_while_a_page_is_open(robot, play, monkeypatch):
    rates = []
    monkeypatch.setattr(RobotConnection, "subscribe", lambda self, rate: rates.append(rate))
    async with play() as app:
        await connected(app)
        app._page_opened(WholePage())
        app._page_closed("page 1")
    assert rates == [UNSEEN_HZ, SEEN_HZ, UNSEEN_HZ]


async def test_samples_come_slower_while_the_robot_stands(robot, play, monkeypatch):
    rates, still = [], [False, True, True, False]
    async with play() as app:
        await connected(app)
        app._pages["page 1"] = WholePage()
        monkeypatch.setattr(app._stillness, "take", lambda _state: still.pop(0) if still else False, raising=False)
        monkeypatch.setattr(RobotConnection, "subscribe", lambda self, rate: rates.append(rate))
        await settle(lambda: not still)
    assert rates[:2] == [STILL_HZ, SEEN_HZ]


async def test_a_page_is_reported_what_was_then_what_is(robot, play):
    page = WholePage()
    async with play() as app:
        await connected(app)
        await settle(lambda: len(app.robot.history.rows()) > 3)
        app._page_opened(page)
        await settle(lambda: len(page.shown) > 2)
    assert page.sent[0]["plots"]["replace"]
    assert len(page.sent[0]["plots"]["rows"]) > 3
    assert "angles" in page.sent[1]["scene"]
    assert page.shown[-1].banner.words == "running"


async def test_stop_latches_and_reports_when_it_does_not_reach(robot, play):
    async with play() as app:
        assert "not connected" in app.stop()
        assert "not connected" in await app.ask(Release())
        await connected(app)
        assert app.stop() is None
        await settle(lambda: robot.status().latched)
        await settle(lambda: app.robot.state.latched)
        assert await app.ask(Release()) is None


def sending(app, monkeypatch):
    """Return a list that gets each command that the page sends."""
    sent, send = [], app._connection.send
    monkeypatch.setattr(app._connection, "send", lambda each: (sent.append(each), send(each)))
    return sent


async def test_a_held_button_drives_until_it_is_silent(robot, play, monkeypatch):
    async with play() as app:
        await connected(app)
        app._page_opened(WholePage())
        sent = sending(app, monkeypatch)
        app.hold("page 1", MOTION, app.said.append)
        await settle(lambda: command(robot) == 3.0)
        await settle(lambda: len(sent) == 2)
        assert sent == [MOTION.moving, MOTION.resting], "the page ends it, not the controller's own timeout"
        await settle(lambda: command(robot) == 0.0)
        await settle(lambda: app._hold_timer is None)


async def test_letting_go_or_closing_the_page_ends_its_motion_at_once(robot, play):
    async with play() as app:
        await connected(app)
        page = WholePage()
        app._page_opened(page)
        app.hold("page 1", MOTION, app.said.append)
        app.release("page 1")
        assert app._dead_man.driver is None
        app.hold("page 1", MOTION, app.said.append)
        app._page_closed("page 1")
        assert app._dead_man.driver is None
        assert page.left == 1  # and what its tabs read
        app.hold("page 1", MOTION, app.said.append)  # was on its way
        assert app._dead_man.driver is None
        await settle(lambda: command(robot) == 0.0)


async def test_nothing_is_sent_after_stop(robot, play, monkeypatch):
    async with play() as app:
        await connected(app)
        app._page_opened(WholePage())
        app.hold("page 1", MOTION, app.said.append)
        sent = sending(app, monkeypatch)
        app.stop()
        await settle(lambda: app._hold_timer is None)  # the hold would end now, by a command
        assert sent == []


async def test_without_teleop_no_client_drives_and_a_second_one_is_reported(robot, play):
    reports = []
    async with play(teleop=False) as app:
        await connected(app)
        app._page_opened(WholePage())
        app.hold("page 1", MOTION, reports.append)
        assert app._dead_man.driver is None
    async with play() as app:
        await connected(app)
        for name in ("page 1", "page 2"):
            app._page_opened(WholePage(name))
            app.hold(name, MOTION, reports.append)
    assert reports == ["another page is driving; release the button there first"]


async def test_the_end_of_the_view_ends_what_it_drives(robot, play):
    async with play() as app:
        await connected(app)
        app._page_opened(WholePage())
        app.hold("page 1", MOTION, app.said.append)
        await settle(lambda: command(robot) == 3.0)
    assert eventually(lambda: command(robot) == 0.0)


@pytest.mark.rest
async def test_it_waits_for_a_robot_that_returns_and_keeps_its_pages(private_folders, play):
    page = WholePage()
    async with play() as app:
        with running(real_time=True):
            await connected(app)
            app._page_opened(page)
        await settle(lambda: app._connection is None)
        await settle(lambda: page.shown and page.shown[-1].banner.words == "not connected")
        with running(real_time=True):
            await connected(app)
            await settle(lambda: page.shown[-1].banner.words == "running")
    assert page.loads == 0


async def test_another_robot_of_the_same_name_makes_pages_again(robot, play):
    page = WholePage()
    async with play() as app:
        await connected(app)
        app._page_opened(page)
        app._robot.resume = lambda _welcome: False
        app._drop("it was another one")
        await settle(lambda: page.loads)
    assert page.loads == 1


async def test_a_silent_robot_is_lost_until_it_sends_again(robot, play, monkeypatch):
    monkeypatch.setattr(view_app, "_SILENT_S", 0.5)
    async with play() as app:
        await connected(app)
        page = WholePage()
        app._page_opened(page)
        await settle(lambda: page.shown)
        loop = asyncio.get_running_loop()
        loop.remove_reader(app._connection.fileno())  # as if it were stopped
        await settle(lambda: page.shown[-1].banner.words == "not connected")
        assert "has sent nothing for" in page.shown[-1].banner.cause
        assert "does not answer" in app.stop()
        loop.add_reader(app._connection.fileno(), app._on_readable)
        await settle(lambda: page.shown[-1].banner.words != "not connected")


async def test_as_a_child_it_ends_with_its_robot(private_folders, play):
    async with play() as app:
        with running(real_time=True):
            await connected(app)
            app._lifeline = 0
            assert not app.server.ended.is_set()
        await settle(lambda: app.server.ended.is_set())
        app._lifeline = None


async def test_a_page_that_cannot_be_drawn_takes_nothing_with_it(robot, play):
    class Broken(WholePage):
        def show(self, content):
            raise ZeroDivisionError

    async with play() as app:
        await connected(app)
        other = WholePage("page 2")
        app._page_opened(Broken())
        app._page_opened(other)
        await settle(lambda: any("ZeroDivisionError" in text for text in app.said))
        await settle(lambda: other.shown)  # the others go on
        assert app.stop() is None
        await settle(lambda: robot.status().latched)


async def test_an_unknown_combination_is_not_a_robot(private_folders, play):
    async with play() as app:
        with pytest.raises(RemoteError, match="not connected"):
            _ = app.robot
        await at_rest()


# -- trajectories


@pytest.fixture
def arm(private_folders, tmp_path):
    robot = Robot.from_config(copy_arm(tmp_path), mock=True, name="mock")
    robot.start()
    yield robot
    robot.shutdown()


def wave(seconds, joints=JOINTS):
    points = [
        TrajectoryPoint(positions=point.positions, velocities=point.velocities, time_from_start=point.time / 1e9)
        for point in planned([0.0] * 6, ENDS, seconds).points
    ]
    return LoadedTrajectory("wave", list(joints), points)


def positions(robot):
    joints = robot.status().joints
    return [joints[joint].position for joint in JOINTS]


async def begun(app, seconds=30.0):
    """Begin to play on a page; returns what ends with it."""
    await connected(app)
    app._page_opened(WholePage())
    playing = asyncio.ensure_future(app.player.play("page 1", "arm_controller", wave(seconds)))
    await settle(lambda: any(item.executing for item in app.robot.state.samples_of(TrajectorySample).values()))
    return playing


@pytest.mark.rest
async def test_a_trajectory_is_played_to_its_end(arm, play):
    async with play() as app:
        playing = await begun(app, 1.5)
        await settle(lambda: app.player.here("page 1") or playing.done())
        played = await playing
    assert (played.reached, played.text) == (True, "the goal was reached")
    assert positions(arm) == pytest.approx(ENDS, abs=1e-3)


@pytest.mark.parametrize(
    ("end", "words"),
    [
        (lambda app: app._page_closed("page 1"), "the page that played the trajectory was closed"),
        (lambda app: None, "the page that played the trajectory does not respond"),
        (lambda app: app.player.cancel("page 1"), "cancelled"),
        (lambda app: app.stop(), "stop"),
    ],
)
async def test_a_closed_and_a_silent_page_cancel_and_stop_end_what_is_played(arm, play, end, words):
    async with play() as app:
        playing = await begun(app)
        end(app)
        played = await asyncio.wait_for(playing, 5.0)
    assert not played.reached
    assert words in played.text
    assert positions(arm) != pytest.approx(ENDS, abs=0.1)
    assert eventually(lambda: all(abs(joint.velocity) < 1e-6 for joint in arm.status().joints.values()))


async def test_what_the_robot_refuses_of_a_trajectory_is_its_sentence(arm, play):
    async with play() as app:
        await connected(app)
        app._page_opened(WholePage())
        outcome = await app.player.play("page 1", "arm_controller", wave(1.0, [*JOINTS[:5], "elbow"]))
    assert "'elbow', which is not a joint of this controller" in outcome.text


async def test_a_read_only_page_plays_nothing(arm, play):
    async with play(teleop=False) as app:
        await connected(app)
        app._page_opened(WholePage())
        assert (await app.player.play("page 1", "arm_controller", wave(1.0))).text == "this page may not move the robot"


async def test_the_end_of_the_view_ends_what_it_plays(arm, play):
    async with play() as app:
        app.tasks = await begun(app)
    assert eventually(lambda: all(abs(joint.velocity) < 1e-6 for joint in arm.status().joints.values()))
    assert positions(arm) != pytest.approx(ENDS, abs=0.1)
