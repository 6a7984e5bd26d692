"""The process of the view without a browser: on the reactor's own thread, against a robot on mock hardware."""

import contextlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from support.host import eventually
from support.mockrobot import running

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.view.app import SEEN_HZ, UNSEEN_HZ, ViewApp
from canopen_control.view.teleop import joint_motion

FORWARD = "robby_forward_controller"
NS = 1_000_000_000


@pytest.fixture
def robot(private_folders):
    with running() as robot:
        yield robot


@pytest.fixture
def make(private_folders):
    with contextlib.ExitStack() as stack:

        def make(**how):
            said = []
            app = ViewApp("mock", "127.0.0.1", 0, **({"teleop": True, "say": said.append} | how))
            stack.callback(app.close)
            app.said = said
            app.start()
            return app

        yield make


def until(app, condition, seconds=5.0):
    assert app.reactor.run_until(condition, round(seconds * NS)), f"not within the time; said: {app.said}"


def command(robot):
    return robot.status()["joints"]["left_wheel_joint"]["command"]


def test_without_a_robot_it_does_not_begin(private_folders):
    with pytest.raises(ConfigError, match="no robot"):
        ViewApp(None, "127.0.0.1", 0, teleop=False, say=print)


def test_every_thread_of_the_process_goes_after_the_robot(robot):
    view = subprocess.Popen(
        [sys.executable, "-m", "canopen_control", "view", "--name", "mock", "--port", "0"],
        stdout=subprocess.PIPE,
        env=os.environ | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"},
        text=True,
    )
    try:
        assert view.stdout.readline().startswith("view: http://127.0.0.1:")
        tasks = [int(task.name) for task in Path(f"/proc/{view.pid}/task").iterdir()]
        assert len(tasks) > 1
        mine = os.getpriority(os.PRIO_PROCESS, 0)
        assert min(os.getpriority(os.PRIO_PROCESS, task) for task in tasks[1:]) == min(19, mine + 5)
        assert os.getpriority(os.PRIO_PROCESS, view.pid) == min(19, mine + 5)
    finally:
        view.terminate()
        view.communicate(timeout=10)


def test_it_says_where_the_page_is_and_shows_the_robot(robot, make):
    app = make()
    until(app, lambda: app._page is not None)
    assert app.said == [f"view: http://127.0.0.1:{app.door.port}/"]
    assert app.server.scene.get_handle_by_name("/world/robot/base_footprint") is not None


def test_started_by_run_it_tells_through_the_robot(robot, make, monkeypatch):
    app = make()
    until(app, lambda: app._link is not None)
    app._lifeline = 0  # as a child of run has one
    app._announce(app._link)
    until(app, lambda: any(event["kind"] == "view" for event in robot.status()["events"]))


def test_samples_come_fast_while_somebody_looks(robot, make, monkeypatch):
    rates = []
    monkeypatch.setattr("canopen_control.view.link.Link.subscribe", lambda self, rate: rates.append(rate))
    app = make()
    until(app, lambda: app._page is not None)
    app._page_opened(1)
    app._page_closed(1)
    assert rates == [UNSEEN_HZ, SEEN_HZ, UNSEEN_HZ]


def test_stop_goes_out_from_any_thread_and_is_an_error_where_it_cannot(robot, make):
    app = make()
    with pytest.raises(RemoteError, match="not connected"):
        app.stop()
    assert "not connected" in app.ask("release", {})
    until(app, lambda: app._link is not None)
    app.stop()
    until(app, lambda: robot.status()["latched"])
    until(app, lambda: "Latched by view" in app._page._alarm._html or app._page_opened(1))
    assert app.ask("release", {}) is None


def test_a_held_button_drives_until_it_is_silent(robot, make):
    app = make()
    until(app, lambda: app._link is not None)
    app._page_opened(1)
    motion = joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0])
    app.hold(1, motion, app.said.append)
    until(app, lambda: command(robot) == 3.0)
    begin = app.reactor.now()
    until(app, lambda: command(robot) == 0.0)
    assert app.reactor.now() - begin < 0.4 * NS
    assert app._letting_go is None


def test_a_closed_page_ends_its_motion_at_once(robot, make):
    app = make()
    until(app, lambda: app._link is not None)
    app._page_opened(1)
    app._hold(1, joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0]), app.said.append)
    app._page_closed(1)
    assert app._dead_man.driver is None
    app._hold(1, joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0]), app.said.append)  # was on its way
    assert app._dead_man.driver is None
    until(app, lambda: command(robot) == 0.0)


def test_who_comes_second_is_told(robot, make):
    app = make()
    until(app, lambda: app._link is not None)
    app._page_opened(1)
    app._page_opened(2)
    motion = joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0])
    told = []
    app._hold(1, motion, told.append)
    app._hold(2, motion, told.append)
    assert told == ["another page drives; it has to let go first"]


def test_the_end_of_the_view_ends_what_it_drives(robot, make):
    app = make()
    until(app, lambda: app._link is not None)
    app._page_opened(1)
    app._hold(1, joint_motion(FORWARD, [3.0, 3.0], [0.0, 0.0]), app.said.append)
    until(app, lambda: command(robot) == 3.0)
    app.close()
    assert eventually(lambda: command(robot) == 0.0)


def test_it_waits_for_a_robot_that_comes_back_and_keeps_its_page(private_folders, make):
    with running():
        app = make()
        until(app, lambda: app._page is not None)
        page = app._page
    until(app, lambda: app._link is None)
    assert "No connection" in page._alarm._html
    with running():
        until(app, lambda: app._link is not None)
        assert app._page is page


def test_as_a_child_it_ends_with_its_robot(private_folders, make, monkeypatch):
    with running():
        app = make()
        until(app, lambda: app._page is not None)
        app._lifeline = 0
    stopped = []
    monkeypatch.setattr(app.reactor, "stop", lambda: stopped.append(True))
    app._on_readable()
    assert stopped


def test_a_page_that_cannot_be_drawn_takes_nothing_with_it(robot, make, monkeypatch):
    app = make()
    until(app, lambda: app._page is not None)
    monkeypatch.setattr(app._page, "state", lambda *_args, **_how: 1 / 0)
    until(app, lambda: any("ZeroDivisionError" in text for text in app.said))
    app.stop()
    until(app, lambda: robot.status()["latched"])
