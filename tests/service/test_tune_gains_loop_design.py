import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.tuneplant import COULOMB, INERTIA, VISCOUS, loaded, pushed

from canopen_control.errors import ConfigError
from canopen_control.service.tune_gains import PlantModel, design_velocity_loop, identify_plant, phase_margin
from canopen_control.service.tune_run import Prbs

PLANT = PlantModel(2e-4, 1e-3, 0.02, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("hertz", "delay", "gain", "reset"),
    [(10, 0.5e-3, 0.0106, 25e-3), (50, 0.5e-3, 0.058, 7.9e-3), (20, 2e-3, 0.024, 25e-3), (5, 10e-3, 0.0059, 83e-3)],
)
def test_gains_of_a_plant_whose_answer_is_known(hertz, delay, gain, reset):
    found = design_velocity_loop(PLANT, hertz * math.tau, math.radians(60), delay)
    assert found.velocity_p == pytest.approx(gain, rel=0.05)
    assert found.reset == pytest.approx(reset, rel=0.1)


@pytest.mark.parametrize(("hertz", "delay"), [(50, 2e-3), (10, 10e-3)])
def test_a_crossover_beyond_the_dead_time_has_no_solution(hertz, delay):
    with pytest.raises(ConfigError, match="take a lower --crossover"):
        design_velocity_loop(PLANT, hertz * math.tau, math.radians(60), delay)


@given(st.floats(1e-4, 10.0), st.floats(0.0, 5.0), st.floats(2.0, 300.0), st.floats(0.4, 1.4), st.floats(0.0, 0.002))
def test_what_was_designed_has_the_phase_margin_that_was_asked_for(inertia, viscous, crossover, margin, delay):
    plant = PlantModel(inertia, viscous, 0.0, 0.0, 0.0, 1.0)
    try:
        gains = design_velocity_loop(plant, crossover, margin, delay)
    except ConfigError:
        assume(False)
        raise
    reached = phase_margin(plant, gains, delay)
    assert reached == (pytest.approx(crossover, rel=1e-6), pytest.approx(margin, abs=1e-6))


def test_gains_of_an_identified_plant_reach_the_margin_on_the_true_one_within_three_degrees():
    _, record = pushed(loaded(), Prbs(150.0, 0.05, 8.0), 0.01, delay=1)
    found = identify_plant([each.command for each in record.samples], [each.velocity for each in record.samples], 0.01)
    gains = design_velocity_loop(found, 20 * math.tau, math.radians(60))
    true = PlantModel(INERTIA, VISCOUS, COULOMB, 0.0, 0.0, 1.0)
    crossover, margin = phase_margin(true, gains)
    assert math.degrees(margin) == pytest.approx(60.0, abs=3.0)
    assert crossover == pytest.approx(20 * math.tau, rel=0.03)
    assert gains.position_p == pytest.approx(20 * math.tau / 4)
