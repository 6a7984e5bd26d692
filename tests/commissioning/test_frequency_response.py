import cmath
import math

import pytest

from canopen_control.commissioning.frequency_response import (
    HIGHEST,
    Bode,
    BodePoint,
    bode_csv,
    bode_lines,
    frequency_response,
)
from canopen_control.commissioning.tune_run import Chirp, Prbs
from canopen_control.errors import DriveError

PERIOD = 0.01
POLE, LATE = 0.6, 2  # y[k+1] = POLE y[k] + (1 - POLE) u[k - LATE]


def through_a_lag(signal, seconds):
    inputs = [signal.at(k * PERIOD) for k in range(round(seconds / PERIOD))]
    outputs = [0.0]
    for k in range(len(inputs) - 1):
        late = inputs[k - LATE] if k >= LATE else 0.0
        outputs.append(POLE * outputs[-1] + (1 - POLE) * late)
    return inputs, outputs


@pytest.mark.parametrize(
    "signal",
    [Chirp(0.75, 1.5, 0.5, 1.15 * HIGHEST / PERIOD, 8.0), Prbs(0.75, PERIOD, 8.0, bias=1.5)],
    ids=["chirp", "prbs"],
)
def test_a_known_system_is_found_within_one_decibel_and_five_degrees_to_a_third_of_the_rate(signal):
    bode = frequency_response(*through_a_lag(signal, 8.0), PERIOD, low=0.8)
    assert bode.points[-1].frequency > 0.95 * HIGHEST / PERIOD
    for point in bode.points:
        z = cmath.exp(1j * math.tau * point.frequency * PERIOD)
        true = (1 - POLE) / (z - POLE) * z**-LATE
        assert point.gain == pytest.approx(20 * math.log10(abs(true)), abs=1.0)
        off = (point.phase - math.degrees(cmath.phase(true)) + 180) % 360 - 180
        assert abs(off) < 5.0


def test_the_bandwidth_is_where_three_decibels_are_lost():
    bode = frequency_response(*through_a_lag(Chirp(0.75, 1.5, 0.5, 33.0, 8.0), 8.0), PERIOD, low=0.8)
    bandwidth = bode.bandwidth()
    z = cmath.exp(1j * math.tau * bandwidth * PERIOD)
    assert 20 * math.log10(abs((1 - POLE) / (z - POLE))) == pytest.approx(-3.0, abs=0.4)


def test_noise_is_not_reported_as_a_response():
    noise = Prbs(1.0, PERIOD, 8.0, bits=11)
    inputs = [Chirp(1.0, 0.0, 1.0, 30.0, 8.0).at(k * PERIOD) for k in range(800)]
    with pytest.raises(DriveError, match="no point of the frequency response is reliable"):
        frequency_response(inputs, [noise.at(k * PERIOD) for k in range(800)], PERIOD, low=5.0)
    with pytest.raises(DriveError, match="too few"):
        frequency_response([1.0] * 20, [1.0] * 20, PERIOD)


def test_it_is_a_table_and_a_file():
    bode = frequency_response(*through_a_lag(Chirp(0.75, 1.5, 0.5, 33.0, 8.0), 8.0), PERIOD, low=0.8)
    lines = bode_lines(bode, 10)
    assert len(lines) <= 11
    assert lines[1].count("#") > lines[-1].count("#") == 1
    rows = bode_csv(bode).splitlines()
    assert rows[0] == "frequency_hz,gain_db,phase_deg,coherence"
    assert len(rows) == 1 + len(bode.points)


def test_the_noise_of_a_flat_response_is_not_a_picture():
    flat = Bode(tuple(BodePoint(float(hz), 0.01 * (hz % 3), 0.0, 1.0) for hz in range(1, 6)))
    assert {line.count("#") for line in bode_lines(flat)[1:]} == {40}
