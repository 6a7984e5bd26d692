import math

import pytest
from support.tuneplant import COULOMB, COUNTS, INERTIA, VISCOUS, loaded, pushed

from canopen_control.errors import DriveError
from canopen_control.service.jog_motion import JogEnd
from canopen_control.service.tune_gains import PlantModel, identify_plant
from canopen_control.service.tune_run import Prbs


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_hidden_inertia_and_friction_are_found_within_three_per_cent(period, delay):
    end, record = pushed(loaded(), Prbs(150.0, 0.05, 8.0), period, delay)
    found = identify_plant(
        [each.command for each in record.samples], [each.velocity for each in record.samples], period
    )
    assert end is JogEnd.OVER
    assert found.inertia == pytest.approx(INERTIA, rel=0.03)
    assert found.coulomb == pytest.approx(COULOMB, rel=0.03)
    assert found.viscous == pytest.approx(VISCOUS, rel=0.03)
    assert found.delay == pytest.approx((delay + 2) * period, abs=period / 2)
    assert found.fit > 0.99


def test_a_constant_load_is_no_friction():
    _, record = pushed(loaded(external=-25.0), Prbs(150.0, 0.05, 8.0), 0.005)
    found = identify_plant([each.command for each in record.samples], [each.velocity for each in record.samples], 0.005)
    assert found.load == pytest.approx(-25.0, rel=0.03)
    assert found.coulomb == pytest.approx(COULOMB, rel=0.03)


@pytest.mark.parametrize(
    ("torque", "speed", "why"),
    [
        ([1.0] * 20, [1.0] * 20, "too few"),
        ([1.0] * 200, [0.0] * 200, "did not move"),
        ([1.0] * 200, [float(k) for k in range(200)], "one way only"),
        ([float(k % 7) for k in range(400)], [math.sin(k / 9) * 5 for k in range(400)], "does not follow the torque"),
    ],
)
def test_what_tells_nothing_is_told(torque, speed, why):
    with pytest.raises(DriveError, match=why):
        identify_plant(torque, speed, 0.01)


def test_a_model_in_another_unit_is_the_same_motor():
    plant = PlantModel(2.0, 0.5, 40.0, 3.0, 0.01, 1.0)
    assert plant.scaled(0.001).inertia == 0.002
    assert plant.scaled(0.001).time_constant == plant.time_constant == 4.0
    assert PlantModel(1.0, 0.0, 0.0, 0.0, 0.0, 1.0).time_constant == math.inf
    assert COUNTS > 0


@pytest.mark.parametrize("seed", range(6))
def test_an_ideal_axis_has_no_friction_below_zero(seed):
    """A mass alone, with the rounding of a coarse encoder: noise would make friction of either sign."""
    speed, speeds, torques = 0.0, [], []
    excitation = Prbs(150.0, 0.05, 8.0)
    for cycle in range(800):
        torque = excitation.at(cycle * 0.01 + seed * 0.003)
        torques.append(torque)
        speeds.append(round(speed * 50 + seed / 7) / 50)
        speed += 0.01 * torque / 20.0
    found = identify_plant(torques, speeds, 0.01)
    assert found.inertia == pytest.approx(20.0, rel=0.02)
    assert 0.0 <= found.viscous < 0.5
    assert 0.0 <= found.coulomb < 3.0


def test_what_is_no_friction_is_fitted_without_it():
    """A drive that helps the motion, as none does: the friction is 0 and the inertia is what fits best then."""
    speed, speeds, torques = 0.0, [], []
    excitation = Prbs(150.0, 0.05, 8.0)
    for cycle in range(800):
        torques.append(torque := excitation.at(cycle * 0.01))
        speeds.append(speed)
        speed += 0.01 * (torque + 3.0 * math.copysign(1.0, speed)) / 20.0
    found = identify_plant(torques, speeds, 0.01)
    assert found.coulomb == 0.0
    assert found.viscous >= 0.0
