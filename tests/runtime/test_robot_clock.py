"""The clock of a simulated robot: on the grid, never back, and as many cycles as were asked for."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.host.reactor import Reactor
from canopen_control.host.timer import ManualClock
from canopen_control.runtime.robot_clock import RobotClock, WallClock, step_words

PERIOD = 20_000_000


class Made:
    """A clock under a clock that is moved by hand; `cycle` is one of this computer's, `times` are the robot's."""

    def __init__(self):
        self.manual = ManualClock(1_000_000_000)
        self.reactor = Reactor(self.manual)
        self.clock = RobotClock(self.reactor, PERIOD, simulated=True)
        self.times, self.answers = [], []

    def settle(self, error):
        self.answers.append(error)

    def cycle(self, count=1, steps=3):
        for _ in range(count):
            self.manual.now_ns += PERIOD
            if self.clock.take(self.manual.now_ns):
                self.times.append(self.clock.edge)
                for _ in range(steps - 1):
                    if self.clock.paused and self.clock.take_step(self.manual.now_ns):
                        self.times.append(self.clock.edge)
            if self.clock.paused:
                self.clock.report_steps()


@pytest.fixture
def robot():
    robot = Made()
    yield robot
    robot.reactor.close()


def test_without_a_pause_it_is_this_computers(robot):
    robot.cycle(2)
    assert robot.times == [1_000_000_000 + PERIOD, 1_000_000_000 + 2 * PERIOD]
    assert robot.clock.now() == robot.reactor.now()
    assert robot.clock.hint is None


def test_a_pause_takes_no_time(robot):
    robot.cycle(2)
    robot.clock.pause()
    robot.cycle(100)
    assert robot.clock.now() == robot.times[-1]
    assert "world play" in robot.clock.hint
    robot.clock.resume()
    assert robot.clock.now() == robot.times[-1]
    robot.cycle(2)
    assert [later - sooner for sooner, later in zip(robot.times, robot.times[1:], strict=False)] == [PERIOD] * 3
    assert robot.clock.now() == robot.times[-1]


def test_the_client_of_steps_is_notified_once_when_they_are_done_or_abandoned(robot):
    robot.cycle()
    robot.clock.pause()
    robot.clock.step(5, robot)
    robot.cycle()
    assert robot.answers == []
    robot.cycle(3)
    assert robot.answers == [None]
    robot.clock.step(500, robot)
    robot.clock.step(1, robot)
    assert robot.answers == [None, "the steps were replaced by another request"]
    robot.clock.resume()
    assert "remaining steps were cancelled" in robot.answers[-1]
    robot.clock.pause()
    robot.clock.step(3, robot)
    robot.clock.end()
    assert robot.answers[-1] == "the robot has stopped"


ACTS = st.lists(st.one_of(st.sampled_from(["pause", "resume", "cycle"]), st.integers(1, 9)), max_size=40)


@given(ACTS)
def test_whatever_is_asked_for_each_cycle_is_one_period_after_the_one_before(acts):
    robot = Made()
    expected = 0
    for act in acts:
        if isinstance(act, int):
            if robot.clock.paused:
                robot.clock.step(act, robot)
                robot.cycle(act)
                expected += act
        elif act == "cycle":
            robot.cycle()
            expected += not robot.clock.paused
        else:
            getattr(robot.clock, act)()
    assert len(robot.times) == expected
    assert all(later - sooner == PERIOD for sooner, later in zip(robot.times, robot.times[1:], strict=False))
    robot.reactor.close()


SECOND = 1_000_000_000


class Walls:
    """Monotonic and Unix time, moved by hand; a stamp is what Unix time was."""

    def __init__(self, **options):
        self.now, self.unix = 5 * SECOND, 1_700_000_000 * SECOND
        self.wall = WallClock(lambda: self.now, follows=True, unix=lambda: self.unix)

    def passes(self, ns, step=0):
        self.now += ns
        self.unix += ns + step


@pytest.mark.parametrize("step", [-2, 3600, -3600, 0.06])
def test_a_clock_that_is_set_is_followed_and_reported_once(step):
    walls = Walls()
    step_ns = round(step * SECOND)
    walls.passes(SECOND, step_ns)
    assert walls.wall.follow_if_due(walls.now) == step_ns
    assert walls.wall.follow_if_due(walls.now) == 0
    walls.passes(SECOND)
    assert walls.wall.follow_if_due(walls.now) == 0
    assert walls.wall.made_at(walls.unix - SECOND // 10) == walls.now - SECOND // 10


def test_a_clock_that_is_slewed_is_followed_in_silence():
    walls = Walls()
    for _ in range(100):
        walls.passes(SECOND, 500_000)  # 500 ppm, the most that NTP slews
        assert walls.wall.follow_if_due(walls.now) == 0
    assert walls.now + walls.wall.offset_ns == walls.unix


def test_a_stamp_of_before_a_step_back_is_as_old_as_it_is():
    walls = Walls()
    stamp, robot = walls.unix, walls.now
    walls.passes(SECOND, -2 * SECOND)
    walls.wall.follow()
    assert walls.wall.made_at(stamp) == robot  # it lies in the future of the new time
    assert walls.wall.made_at(walls.unix) == walls.now
    walls.passes(3 * SECOND)
    walls.wall.follow()
    assert walls.wall.made_at(walls.unix) == walls.now
    assert walls.wall.made_at(walls.unix + SECOND) == walls.now + SECOND


def test_virtual_time_has_no_wall_to_follow():
    walls = Walls()
    walls.wall.fix(0)
    walls.passes(SECOND, 7 * SECOND)
    assert walls.wall.follow_if_due(walls.now) == walls.wall.follow() == walls.wall.offset_ns == 0


def test_the_words_report_which_way():
    assert "set back by 2.000 s" in step_words(-2 * SECOND)
    assert "set forward by 3600.000 s" in step_words(3600 * SECOND)
