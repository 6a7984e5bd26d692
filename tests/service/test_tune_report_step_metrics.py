import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.errors import DriveError
from canopen_control.service.tune_report import step_metrics

TIMES = [k / 1000 for k in range(-50, 2000)]


def second_order(damping, omega, height=1.0):
    """The closed form of a second-order system's response."""
    damped = omega * math.sqrt(1 - damping**2)
    angle = math.acos(damping)
    return [
        0.0
        if t < 0
        else height * (1 - math.exp(-damping * omega * t) / math.sqrt(1 - damping**2) * math.sin(damped * t + angle))
        for t in TIMES
    ]


@given(st.floats(0.3, 0.8), st.floats(20.0, 60.0), st.floats(-5.0, 5.0).filter(lambda height: abs(height) > 0.1))
def test_a_second_order_system_is_measured_as_its_formulas_say(damping, omega, height):
    found = step_metrics(TIMES, second_order(damping, omega, height), height)
    assert found.overshoot == pytest.approx(math.exp(-math.pi * damping / math.sqrt(1 - damping**2)), abs=0.002)
    assert found.final == pytest.approx(height, rel=1e-3)
    assert found.settling is not None
    assert found.settling <= 1.4 * -math.log(0.02 * math.sqrt(1 - damping**2)) / (damping * omega)
    assert 0.0 < found.delay < found.rise < 2.5 / omega * 1.6


def test_a_first_order_lag_rises_in_2_2_time_constants_after_its_dead_time():
    values = [0.0 if t < 0.02 else 2.0 * (1 - math.exp(-(t - 0.02) / 0.1)) for t in TIMES]
    found = step_metrics(TIMES, values, 2.5)
    assert found.rise == pytest.approx(0.1 * math.log(9), abs=0.001)
    assert found.delay == pytest.approx(0.02 + 0.1 * -math.log(0.95), abs=0.001)
    assert found.error == pytest.approx(0.5, abs=1e-4)
    assert found.overshoot == pytest.approx(0.0, abs=1e-3)


def test_what_goes_on_swinging_never_settles():
    values = [0.0 if t < 0 else 1.0 + 0.2 * math.sin(30 * t) for t in TIMES]
    assert step_metrics(TIMES, values, 1.0).settling is None


@pytest.mark.parametrize(
    ("values", "why"), [([0.01] * 2050, "did not follow"), ([-1.0 if t > 0 else 0.0 for t in TIMES], "did not follow")]
)
def test_a_drive_that_does_not_follow_is_told(values, why):
    with pytest.raises(DriveError, match=why):
        step_metrics(TIMES, values, 1.0)


def test_too_few_samples_are_told():
    with pytest.raises(DriveError, match="too few"):
        step_metrics([0.0, 0.1], [0.0, 1.0], 1.0)
