import math

import pytest

from canopen_control.service.jog_motion import JogEnd, JogKind, JogLimits
from canopen_control.service.tune_run import STEERED, Prbs, Step, TuneMotion, TuneRecord, TuneSample

S = 1_000_000_000
LIMITS = JogLimits(speed=6.0, travel=10.0, current=500.0)


def motion(kind=JogKind.VELOCITY, excitation=None, **kwargs):
    return TuneMotion(kind, excitation or Step(3.0, 2.0), LIMITS, now=0, **kwargs)


def test_it_commands_its_excitation_and_is_over_with_it():
    run = motion()
    run.tick(S)
    assert (run.command, run.ended) == (3.0, JogEnd.NONE)
    run.tick(2 * S)
    assert (run.command, run.ended) == (0.0, JogEnd.OVER)


@pytest.mark.parametrize(
    ("seen", "why"),
    [
        ((0.0, 6.1, 0.0), JogEnd.SPEED),
        ((0.0, -6.1, None), JogEnd.SPEED),
        ((10.5, 0.0, 0.0), JogEnd.TRAVEL),
        ((None, None, None), JogEnd.NONE),
        ((math.nan, math.nan, 0.0), JogEnd.NONE),
    ],
)
def test_a_limit_ends_it_and_nothing_is_commanded_any_more(seen, why):
    run = motion()
    run.see(0.0, 0.0, 0.0, enabled=True)
    run.tick(S)
    run.see(*seen, enabled=True)
    assert run.ended is why
    assert run.command == (3.0 if why is JogEnd.NONE else 0.0)


def test_a_current_that_stays_too_high_ends_it_and_a_peak_does_not():
    run = motion()
    for ms, current, why in (
        (0, 600.0, JogEnd.NONE),
        (90, -600.0, JogEnd.NONE),
        (110, 400.0, JogEnd.NONE),
        (120, 501.0, JogEnd.NONE),
        (220, 501.0, JogEnd.NONE),
        (221, 501.0, JogEnd.CURRENT),
    ):
        run.tick(ms * S // 1000)
        run.see(0.0, 0.0, current, enabled=True)
        assert run.ended is why, ms


def test_a_drive_that_is_not_enabled_any_more_ends_it():
    run = motion()
    run.see(0.0, 0.0, 0.0, enabled=False)
    assert run.ended is JogEnd.STATE
    assert run.ended.failed


def test_it_ends_while_what_is_left_of_the_travel_is_enough_to_stop():
    run = motion(deceleration=2.0)
    run.see(0.0, 0.0, 0.0, enabled=True)
    run.see(6.0, 3.9, 0.0, enabled=True)  # 3.8 rad to stop, 4 are left
    assert run.ended is JogEnd.NONE
    run.see(6.0, -5.0, 0.0, enabled=True)  # it comes back
    assert run.ended is JogEnd.NONE
    run.see(6.3, 3.9, 0.0, enabled=True)
    assert run.ended is JogEnd.TRAVEL


def test_a_torque_pushes_both_ways_and_back_from_half_of_its_limits_on():
    run = motion(JogKind.TORQUE, Prbs(100.0, 0.05, 8.0))
    bias = 100.0 * STEERED

    def pushed(seconds, way, speed):
        run.tick(round(seconds * S))
        run.see(way, speed, 0.0, enabled=True)
        return run.command - Prbs(100.0, 0.05, 8.0).at(seconds)

    assert pushed(1.0, 0.0, 0.0) == bias
    assert pushed(3.0, 0.0, 0.0) == -bias
    assert pushed(7.0, 0.0, 0.0) == bias
    assert pushed(1.0, 0.0, 3.1) == -bias
    assert pushed(1.0, 5.1, -1.0) == -bias
    assert pushed(3.0, -5.1, 0.0) == bias


def test_a_record_counts_the_cycles_that_are_missing():
    record = TuneRecord(0.01)
    for cycle in (7, 8, 8, 10, 13):
        record.put(TuneSample(cycle, 1.0))
    assert [sample.cycle for sample in record.samples] == [7, 8, 10, 13]
    assert record.lost == 3
    assert record.seconds(record.samples[-1]) == pytest.approx(0.06)
