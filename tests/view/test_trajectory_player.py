"""The player with a robot that only answers; test_view_app has one that moves."""

import asyncio
import json
import threading

import pytest

from canopen_control.errors import ConfigError, RemoteError
from canopen_control.rpc.messages.samples import TrajectoryPoint, TrajectorySample
from canopen_control.rpc.messages.state import ControllerReading
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
    active_trajectory_controllers,
    load,
    preview_table,
    progress_of,
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


# -- loaded trajectory


POINTS = [TrajectoryPoint(positions=[0.5, 0.25], time_from_start=1.0), TrajectoryPoint(time_from_start=2.5)]
LOADED = LoadedTrajectory("wave.json", ["left", "<lift>"], POINTS)


def file(points):
    return json.dumps({"joint_names": ["left"], "points": points}).encode()


def sample(at, **how):
    empty = TrajectoryPoint()
    return TrajectorySample(
        time=1.0, joints=("left",), holding=False, reference=TrajectoryPoint(time_from_start=at), feedback=empty,
        error=empty, output=empty, **({"executing": True} | how),
    )  # fmt: skip


def test_a_file_is_read_as_the_shell_reads_it():
    loaded = load(file([{"positions": [1.0], "time_from_start": {"sec": 2}}]), "wave.json")
    assert (loaded.name, loaded.joints, loaded.duration) == ("wave.json", ["left"], 2.0)
    assert loaded.positions(0) == {"left": 1.0}


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (file([{"position": [1.0]}]), "did you mean 'positions'"),
        (file([]), "wave.json: the trajectory has no points"),
        (b"joint_names:\n- \xff", "wave.json:2: the file is not UTF-8"),
        (b"\0", "wave.json:1:1"),
    ],
)
def test_what_cannot_be_read_is_reported_with_its_name(data, text):
    with pytest.raises(ConfigError) as refused:
        load(data, "wave.json")
    assert text in str(refused.value)


def test_a_point_that_places_no_joint_or_too_few_places_none():
    assert LOADED.positions(0) == {"left": 0.5, "<lift>": 0.25}
    assert LOADED.positions(1) == {}
    assert LoadedTrajectory("x", ["left", "lift"], [TrajectoryPoint(positions=[1.0])]).positions(0) == {}


def test_the_table_has_what_is_previewed_alongside_what_is():
    table = preview_table(LOADED, 0, {"left": 0.125}, frozenset({"<lift>"}))
    assert "<td>0.500<small>rad</small></td><td>0.125</td>" in table
    assert "&lt;lift&gt;</b></td><td>0.250<small>m</small></td><td>not a joint of this robot" in table
    assert "<td>-</td>" in preview_table(LOADED, 0, {"left": None}, frozenset())
    assert "no positions" in preview_table(LOADED, 1, {}, frozenset())


@pytest.mark.parametrize(
    ("reported", "duration", "done", "words"),
    [
        (None, 2.0, 0.0, "Playing."),
        (sample(1.0, executing=False), 2.0, 0.0, "Playing."),
        (sample(0.5), 2.0, 0.25, "Playing: 0.5 of 2.0 s."),
        (sample(9.0), 2.0, 1.0, "Playing: 2.0 of 2.0 s."),
        (sample(-1.0), 2.0, 0.0, "Playing: 0.0 of 2.0 s."),
        (sample(0.0), 0.0, 1.0, "Playing: 0.0 of 0.0 s."),
        (sample(1.0, speed_scaling_factor=0.1), 2.0, 0.5, "Playing: 1.0 of 2.0 s, at 10 % of its speed."),
    ],
)
def test_progress_is_what_the_controller_reports(reported, duration, done, words):
    assert progress_of(reported, duration) == (done, words)


def test_only_active_controllers_of_trajectories_take_them():
    def reading(name, state, tells):
        return ControllerReading(name=name, type="", state=state, tells=tells)

    result = [
        reading("a", "active", "trajectory"),
        reading("b", "inactive", "trajectory"),
        reading("c", "active", None),
    ]
    assert active_trajectory_controllers(result) == ["a"]
