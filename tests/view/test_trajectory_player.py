"""The player with a robot that only answers; test_view_app has one that moves."""

import asyncio
import threading

import pytest

from canopen_control.errors import RemoteError
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.trajectory import (
    CancelTrajectory,
    SendTrajectory,
    TrajectoryEnd,
    TrajectoryHeartbeat,
    TrajectoryResult,
    TrajectoryVerdict,
)
from canopen_control.view.trajectory_player import (
    HERE_HZ,
    SILENT_S,
    LoadedTrajectory,
    TrajectoryOutcome,
    TrajectoryPlayer,
)

WAVE = LoadedTrajectory("wave", ["a"], [TrajectoryPoint(positions=[1.0], time_from_start=2.0)])
ACCEPTED = TrajectoryVerdict(accepted=True)


class Robot:
    """In the place of a connection: a goal ends when it is cancelled, when `finish` is set, or with the connection."""

    def __init__(self, verdict=ACCEPTED):
        self.verdict, self.sent, self.result = verdict, [], TrajectoryResult(state="succeeded", error_code=0, text="ok")
        self.asked_for_end, self.finish, self.closed = threading.Event(), threading.Event(), False
        self.before_verdict = lambda: None

    def __enter__(self):
        return self

    def __exit__(self, *_error):
        self.closed = True

    def send_points(self, points):
        return points

    def ask(self, request, timeout=None):
        self.sent.append(request)
        if isinstance(request, SendTrajectory):
            self.before_verdict()
            return self.verdict
        assert isinstance(request, TrajectoryEnd)
        self.asked_for_end.set()
        assert self.finish.wait(60)
        if self.closed:
            raise RemoteError("BusClosed", "the connection is closed")
        return self.result

    def notify(self, request):
        self.sent.append(request)
        if isinstance(request, TrajectoryHeartbeat):
            return
        self.result = TrajectoryResult(state="canceled", error_code=0, text=f"cancelled: {request.why}")
        self.finish.set()

    def close(self):
        self.closed = True
        self.finish.set()


class Play:
    def __init__(self, robot, may_play=lambda page: True):
        self.robot, self.now = robot, 0.0
        self.player = TrajectoryPlayer(may_play, lambda: robot, lambda: self.now)

    def run(self, act, page="page 1"):
        """Play, and when the robot is asked for the end do `act`; returns how it ended."""

        async def both():
            playing = asyncio.ensure_future(self.player.play(page, "arm", WAVE))
            while not self.robot.asked_for_end.is_set() and not playing.done():
                await asyncio.sleep(0)
            if not playing.done():
                act()
            return await playing

        return asyncio.run(both())

    def cancels(self):
        return [item for item in self.robot.sent if isinstance(item, CancelTrajectory)]


@pytest.fixture
def play():
    return Play(Robot())


def test_it_is_sent_as_a_goal_that_dies_with_its_connection_and_its_end_is_reported(play):
    assert play.run(play.robot.finish.set) == TrajectoryOutcome(True, "ok")
    goal = play.robot.sent[0]
    assert (goal.controller, goal.joints, goal.points, goal.source) == ("arm", ["a"], WAVE.points, "view")
    assert goal.dead_man
    assert play.robot.closed
    assert play.player.page is None


def test_a_robot_that_is_gone_is_a_sentence(play):
    def gone():
        raise RemoteError("BusClosed", "robot arm is not running")

    play.player._connect = gone
    assert play.run(print) == TrajectoryOutcome(False, "robot arm is not running")


def test_the_page_that_plays_cancels_and_no_other(play):
    def act():
        play.player.cancel("page 2")
        play.player.leave("page 2")
        assert play.cancels() == []
        play.player.cancel("page 1")
        play.player.cancel("page 1")

    assert play.run(act).text.startswith("cancelled")
    assert play.cancels() == [CancelTrajectory(controller="arm", own=True)]


def test_while_it_plays_each_tick_reports_the_robot_that_this_process_is_at_work(play):
    beats = []

    def act():
        play.player.tick()
        play.player.tick()
        beats.extend(item for item in play.robot.sent if isinstance(item, TrajectoryHeartbeat))
        play.robot.finish.set()

    assert play.run(act).reached
    assert len(beats) == 2
    assert play.robot.sent[0].heartbeat == 2.0
    play.player.tick()
    assert len([item for item in play.robot.sent if isinstance(item, TrajectoryHeartbeat)]) == 2  # it has ended


def test_a_silent_page_ends_it_and_one_that_is_there_does_not(play):
    def act():
        for _ in range(20):
            play.now += 1 / HERE_HZ
            play.player.here("page 1")
            play.player.tick()
        assert play.cancels() == []
        play.player.here("page 2")
        play.now += SILENT_S
        play.player.here("page 2")
        play.player.tick()

    assert play.run(act).text == "cancelled: the page that played the trajectory does not respond"


def test_the_end_of_the_view_hangs_up(play):
    assert play.run(play.player.end) == TrajectoryOutcome(False, "the connection is closed")
    assert play.robot.closed


def test_what_is_cancelled_while_it_is_sent_is_cancelled_when_it_is_accepted(play):
    play.robot.before_verdict = lambda: play.player.leave("page 1")
    assert not play.run(print).reached
    assert len(play.cancels()) == 1


def test_what_is_cancelled_before_it_is_sent_is_not_sent(play):
    def points(inputs):
        play.player.leave("page 1")
        return inputs

    play.robot.send_points = points
    assert play.run(print) == TrajectoryOutcome(
        False, "the trajectory was not sent: the page that played the trajectory was closed"
    )
    assert play.robot.sent == []


def test_one_plays_at_a_time(play):
    reports = []

    async def another():
        reports.append(await play.player.play("page 2", "arm", WAVE))
        play.robot.finish.set()

    def act():
        assert play.player.page == "page 1"
        play.tasks = asyncio.ensure_future(another())

    assert play.run(act).reached
    assert "already playing a trajectory" in reports[0].text
