"""The family `motion`: what would fall short is seen, and what is judged is good."""

import itertools
import time

import pytest
from canopen_control_bench import motion
from canopen_control_bench.runner import Options

from canopen_control.controllers.trajectory.follower import Follower
from canopen_control.controllers.trajectory.packed import PackedPoints


@pytest.fixture
def place(tmp_path):
    return (tmp_path / str(number) for number in itertools.count()).__next__


def burn(ms):
    end = time.thread_time_ns() + ms * motion.MS
    while time.thread_time_ns() < end:
        pass


def test_cycles_on_a_trajectory_are_timed_beside_commanded_ones(place, monkeypatch):
    figure = motion.follow_in_turns(place, 3, 20)
    assert 1.0 < figure.ratio < 2.0
    sample = Follower.sample
    monkeypatch.setattr(Follower, "sample", lambda *args: (burn(1), sample(*args))[1])
    assert motion.follow_in_turns(place, 1, 10).ratio > 2.0


def test_a_request_that_keeps_the_loop_is_seen(place, monkeypatch):
    request, cycle = motion.accept_goals(place(), 1)
    assert request.ours > 20.0
    assert request.absolutes["requests"] > 5, "it comes in pieces"
    assert cycle.ours > request.absolutes["a usual cycle us"] / 2
    add = PackedPoints.add
    monkeypatch.setattr(PackedPoints, "add", lambda *args: (burn(3), add(*args))[1])
    assert motion.accept_goals(place(), 1)[0].ours > 3000.0


@pytest.mark.parametrize("who", motion.Sync)
def test_a_late_host_behind_a_slow_adapter_loses_none_at_250_hz(place, who):
    ripple, lost = motion.by_default(place, 250, 0.6, who)
    assert ripple.good
    assert ripple.limit == motion.RIPPLE_LIMIT
    assert (lost.ours, lost.limit) == (0, 0.0)


def test_what_is_lost_is_counted(place, monkeypatch):
    monkeypatch.setattr(motion, "MOST_LATE_NS", 6 * motion.MS)
    ripple, lost = motion.by_default(place, 250, 0.6, motion.Sync.KERNEL)
    assert not lost.good
    assert not ripple.good


def test_the_ways_beside_it_are_told_and_not_judged(place):
    node, host, wake_up = motion.beside(place, 100)
    assert node.limit is host.limit is wake_up.limit is None
    assert node.ratio < 1.1
    assert min(host.ratio, wake_up.ratio) > 5.0


def test_a_quick_run_has_all_figures(monkeypatch):
    seen = []
    monkeypatch.setattr(
        motion, "by_default", lambda _place, hertz, seconds, who: seen.append((hertz, seconds, who)) or []
    )
    monkeypatch.setattr(motion, "beside", lambda _place, hertz: [hertz])
    monkeypatch.setattr(motion, "follow_in_turns", lambda _place, rounds, cycles: (rounds, cycles))
    monkeypatch.setattr(motion, "accept_goals", lambda _place, rounds: [rounds])
    assert motion.measure(Options(quick=True)) == [(5, 40), 5, 100, 250]
    assert seen == [(hertz, 1.2, who) for hertz in (100, 250) for who in motion.Sync]
    seen.clear()
    motion.measure(Options())
    assert {seconds for _, seconds, _ in seen} == {600.0}
