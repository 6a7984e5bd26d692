"""The rhythm of SYNC that a drive recovers: in time, early and late, for an hour, and after a change."""

import random

import pytest

from canopen_control.virtual.node_outbox import SyncPll

MS = 1_000_000
T = 4 * MS


def heard(times):
    rhythm = SyncPll()
    for when in times:
        rhythm.receive_sync(when)
    return rhythm


def test_syncs_that_come_in_time_are_taken_as_they_are():
    rhythm = heard(range(7, 7 + 1000 * T, T))
    assert (rhythm.late_ns, rhythm.slack_ns, rhythm.period_ns) == (0.0, 0.0, T)
    assert rhythm.has_period(0.004)
    assert not rhythm.has_period(0.005)


def test_two_syncs_make_no_rhythm():
    assert not heard([T, T, T]).has_period(0.004), "two at once are none"
    assert not heard([T]).has_period(0.004)
    assert not heard([T, 2 * T]).has_period(0.004)
    assert heard([T, 2 * T, 3 * T]).has_period(0.004)


@pytest.mark.rest
@pytest.mark.parametrize("ppm", [200, -200])
def test_for_an_hour_at_200_ppm_with_two_ms_of_jitter_its_edges_keep_to_the_sender_and_none_is_lost(ppm):
    rhythm, chance = SyncPll(), random.Random(ppm)
    period, worst, uneven, before = 10 * MS * (1_000_000 + ppm) / 1_000_000, 0.0, 0.0, None
    for count in range(360_000):
        due = count * period
        when = round(due + chance.random() * 2 * MS)
        rhythm.receive_sync(when)
        edge = when - rhythm.late_ns
        if count > 1000:
            worst = max(worst, abs(edge - due - MS))
            uneven = max(uneven, abs(edge - before - period))
        before = edge
    assert worst < 0.3 * MS, "behind the mean of those that came"
    assert uneven < 0.02 * MS, "of jitter a hundredth is left from edge to edge"
    assert rhythm.period_ns == pytest.approx(period, rel=1e-4)
    assert 0.8 * MS < rhythm.slack_ns < 2 * MS


def test_a_sync_that_is_missing_costs_nothing_and_another_period_restarts():
    times = [count * T for count in range(200) if count not in (50, 51, 120)]
    rhythm = heard(times)
    assert (rhythm.late_ns, rhythm.period_ns) == (0.0, T)
    for count in range(10):
        rhythm.receive_sync(times[-1] + round((count + 1) * 2.6 * T))
    assert rhythm.has_period(2.6 * 0.004)
    assert rhythm.late_ns == pytest.approx(0.0, abs=2.0)


def test_a_sender_that_was_away_is_trusted_again():
    rhythm = heard([*range(0, 50 * T, T), 1000 * T + 77])
    assert rhythm.period_ns == 0.0
    assert not rhythm.has_period(0.004)
