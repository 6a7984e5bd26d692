"""The witness: what it calls a stall, and which stalls of ours it does not explain."""

import os

import pytest
from canopen_control_bench.machine import may_be_realtime
from canopen_control_bench.stage import stage
from canopen_control_bench.witness import unwitnessed, watch


class Clock:
    """Sleeps take as long as they are told to, and what `late` has for the n-th of them."""

    def __init__(self, *late):
        self.time, self.late = 0, list(late)

    def now(self):
        return self.time

    def sleep(self, seconds):
        self.time += round(seconds * 1e9) + self.late.pop(0)

    def ended(self):
        return not self.late


def test_half_a_period_is_a_stall_and_what_comes_after_starts_anew():
    clock = Clock(0, 499, 500, 0, 3000, 0)
    assert watch(1000, clock.ended, clock.now, clock.sleep) == [(3000, 3500), (5500, 8500)]


def test_a_late_waking_is_made_good_by_a_shorter_sleep():
    clock = Clock(400, 400, 400)
    watch(1000, clock.ended, clock.now, clock.sleep)
    assert clock.time == 3400


@pytest.mark.parametrize(
    ("witnessed", "left"),
    [
        ([], [(10, 20)]),
        ([(0, 10)], [(10, 20)]),
        ([(20, 30)], [(10, 20)]),
        ([(0, 11)], []),
        ([(19, 30)], []),
        ([(12, 13)], []),
        ([(0, 9), (0, 100)], []),
    ],
)
def test_a_stall_is_explained_by_one_that_overlaps_it(witnessed, left):
    assert unwitnessed([(10, 20)], witnessed) == left


@pytest.mark.process
@pytest.mark.skipif(not may_be_realtime(), reason="this user may not use SCHED_FIFO")
def test_it_watches_until_it_is_told_to_end():
    with stage() as played:
        stalls = played.witness(min(os.sched_getaffinity(0)), 100_000).stalls()
    assert all(woke - edge >= 50_000 for edge, woke in stalls)
