import math

import pytest

from canopen_control.service.tune_run import LEAD_S, Chirp, Prbs, Step


def test_a_step_is_nothing_then_its_height_then_nothing():
    step = Step(3.0, 2.0)
    assert [step.at(t) for t in (0.0, LEAD_S - 1e-6, LEAD_S, 1.999, 2.0)] == [0.0, 0.0, 3.0, 3.0, 0.0]
    assert step.peak == 3.0


@pytest.mark.parametrize("signal", [Chirp(0.5, 1.0, 0.5, 30.0, 4.0), Prbs(0.5, 0.05, 4.0, bias=1.0)])
def test_a_signal_fades_in_and_out_and_stays_within_its_peak(signal):
    values = [signal.at(t / 1000) for t in range(4001)]
    assert values[0] == 0.0
    assert signal.at(4.0) == pytest.approx(0.0, abs=1e-9)
    assert signal.at(9.0) == 0.0
    assert max(map(abs, values)) <= signal.peak == 1.5


def test_a_chirp_ends_with_its_highest_frequency():
    chirp = Chirp(1.0, 0.0, 1.0, 20.0, 10.0)
    crossings = [t / 1e4 for t in range(90_000, 98_000) if chirp.at(t / 1e4) < 0.0 <= chirp.at((t + 1) / 1e4)]
    assert 1.0 / (crossings[-1] - crossings[-2]) == pytest.approx(20.0, rel=0.03)


def test_a_prbs_is_as_long_as_a_register_allows_and_even_but_for_one():
    prbs = Prbs(1.0, 1.0, 1e6, bits=9)
    period = [prbs.at(100.5 + k) for k in range(511)]
    assert abs(sum(period)) == 1.0
    assert period == [prbs.at(100.5 + 511 + k) for k in range(511)]
    shifted = sum(a * b for a, b in zip(period, period[7:] + period[:7], strict=True))
    assert shifted == -1.0  # white: as much alike as one of them is odd
    assert math.isclose(prbs.peak, 1.0)
