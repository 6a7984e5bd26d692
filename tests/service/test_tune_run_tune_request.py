import math

import pytest

from canopen_control.errors import ConfigError
from canopen_control.service.jog_motion import JogKind, JogLimits, JogScale, parse_quantity
from canopen_control.service.tune_run import TuneRequest, TuneTest

SCALE = JogScale(4096.0, told=True)
LIMITS = JogLimits(math.tau, 60.0, 200.0)


def request(test, seconds=None, **kwargs):
    return TuneRequest(test, seconds or test.seconds, 0.01, **kwargs)


STEP = request(TuneTest.STEP, speed=parse_quantity("30rpm", "velocity"))


def test_what_is_commanded_is_what_is_confirmed():
    assert STEP.kind is JogKind.VELOCITY
    assert STEP.excitation(SCALE).peak == pytest.approx(math.pi)
    assert STEP.words(SCALE) == "a step to 3.14 rad/s (30.0 rpm) for 2 s"
    identify = request(TuneTest.IDENTIFY, torque=160.0)
    assert identify.kind is JogKind.TORQUE
    assert identify.excitation(SCALE).peak == pytest.approx(100.0)  # and 60 of them to one side
    assert identify.words(SCALE) == "a torque of up to 16 % of the rated one, both ways, for 8 s"
    assert "as a sine from 0.5 to 38.3 Hz, for 8 s" in request(TuneTest.BODE).words(SCALE)
    assert "as a pseudo-random sequence" in request(TuneTest.BODE, signal="prbs").words(SCALE)


@pytest.mark.parametrize(
    ("asked", "why"),
    [
        (request(TuneTest.STEP, speed=parse_quantity("70rpm", "velocity")), "beyond the limit of 6.28 rad/s"),
        (request(TuneTest.IDENTIFY, torque=250.0), "beyond --max-current 200"),
        (request(TuneTest.BODE, 0.3), "too short for a frequency response"),
    ],
)
def test_what_is_beyond_the_limits_is_refused_before_it_begins(asked, why):
    with pytest.raises(ConfigError, match=why):
        asked.check(LIMITS, SCALE)


def test_what_is_within_them_is_not():
    for each in (STEP, request(TuneTest.BODE), request(TuneTest.IDENTIFY, torque=200.0)):
        each.check(LIMITS, SCALE)
