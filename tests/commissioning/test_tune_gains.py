import dataclasses
import math

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from support.parameter_node import session_with
from support.tuneplant import COULOMB, COUNTS, INERTIA, VISCOUS, loaded, pushed

from canopen_control.cia402.loop_gains import GainObject, LoopGain, gain_objects
from canopen_control.commissioning.jog_motion import JogEnd
from canopen_control.commissioning.tune_gains import (
    CascadeGains,
    PlantModel,
    design_velocity_loop,
    gain_values,
    identify_plant,
    parse_gain,
    phase_margin,
    revert_gains,
    set_gains,
    settable_gains,
)
from canopen_control.commissioning.tune_run import Prbs
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.eds import read_eds


@pytest.mark.parametrize("period", [0.001, 0.005, 0.01])
@pytest.mark.parametrize("delay", [0, 1, 2])
def test_hidden_inertia_and_friction_are_found_within_three_per_cent(period, delay):
    end, record = pushed(loaded(), Prbs(150.0, 0.05, 8.0), period, delay)
    result = identify_plant(
        [sample.command for sample in record.samples], [sample.velocity for sample in record.samples], period
    )
    assert end is JogEnd.OVER
    assert result.inertia == pytest.approx(INERTIA, rel=0.03)
    assert result.coulomb == pytest.approx(COULOMB, rel=0.03)
    assert result.viscous == pytest.approx(VISCOUS, rel=0.03)
    assert result.delay == pytest.approx((delay + 2) * period, abs=period / 2)
    assert result.fit > 0.99


@pytest.mark.parametrize(
    ("torque", "speed", "why"),
    [
        ([1.0] * 20, [1.0] * 20, "too few"),
        ([1.0] * 200, [0.0] * 200, "did not move"),
        ([1.0] * 200, [float(k) for k in range(200)], "in one direction only"),
        ([float(k % 7) for k in range(400)], [math.sin(k / 9) * 5 for k in range(400)], "does not explain the speed"),
    ],
)
def test_what_reports_nothing_is_reported(torque, speed, why):
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
    result = identify_plant(torques, speeds, 0.01)
    assert result.inertia == pytest.approx(20.0, rel=0.02)
    assert 0.0 <= result.viscous < 0.5
    assert 0.0 <= result.coulomb < 3.0


PLANT = PlantModel(2e-4, 1e-3, 0.02, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(
    ("hertz", "delay", "gain", "reset"),
    [(10, 0.5e-3, 0.0106, 25e-3), (50, 0.5e-3, 0.058, 7.9e-3), (20, 2e-3, 0.024, 25e-3), (5, 10e-3, 0.0059, 83e-3)],
)
def test_gains_of_a_plant_whose_answer_is_known(hertz, delay, gain, reset):
    result = design_velocity_loop(PLANT, hertz * math.tau, math.radians(60), delay)
    assert result.velocity_p == pytest.approx(gain, rel=0.05)
    assert result.reset == pytest.approx(reset, rel=0.1)


@pytest.mark.parametrize(("hertz", "delay"), [(50, 2e-3), (10, 10e-3)])
def test_a_crossover_beyond_the_dead_time_has_no_solution(hertz, delay):
    with pytest.raises(ConfigError, match="use a lower --crossover"):
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
    result = identify_plant(
        [sample.command for sample in record.samples], [sample.velocity for sample in record.samples], 0.01
    )
    gains = design_velocity_loop(result, 20 * math.tau, math.radians(60))
    true = PlantModel(INERTIA, VISCOUS, COULOMB, 0.0, 0.0, 1.0)
    crossover, margin = phase_margin(true, gains)
    assert math.degrees(margin) == pytest.approx(60.0, abs=3.0)
    assert crossover == pytest.approx(20 * math.tau, rel=0.03)
    assert gains.position_p == pytest.approx(20 * math.tau / 4)


OD = read_eds(data_path("eds", "generic_cia402.eds"), 5).od
PER_RAD = 65536 / math.tau
GAINS = CascadeGains(velocity_p=5000.0, reset=0.02, position_p=15.7, crossover=60.0, margin=1.0)
P, TI, KV, FF = (0x60F9, 1), (0x60F9, 2), (0x60FB, 1), (0x60FB, 2)


class Kept:
    """Keeps gains in memory."""

    def __init__(self):
        self.held = {}

    def read(self):
        return self.held

    def keep(self, _od, values):
        self.held = dict(values)

    def forget(self):
        self.held = {}


def values(**changed):
    return gain_values(OD, gain_objects(OD), GAINS, PER_RAD) | changed


def held(session):
    return [session.read_value(OD[address]) for address in (P, TI, KV, FF)]


def test_a_gain_at_the_shaft_is_one_of_the_drives_own_units():
    expected = values()
    assert expected[P] * 1e-5 * PER_RAD == pytest.approx(5000.0, rel=1e-4)
    assert expected[TI] == pytest.approx(expected[P] / 0.02, rel=1e-4)
    assert (expected[KV], expected[FF]) == (15_700, 1000)


@pytest.mark.parametrize("gain", [1e-12, 1e12])
def test_a_gain_that_the_object_cannot_hold_is_reported(gain):
    design = CascadeGains(gain, 0.02, 15.0, 60.0, 1.0)
    with pytest.raises(ConfigError, match=r"0x60F9:01 Velocity loop proportional gain would be .* outside of 1 to"):
        gain_values(OD, gain_objects(OD), design, PER_RAD)


def test_gains_are_set_and_taken_back():
    session, kept = session_with(OD), Kept()
    before = held(session)
    changes = set_gains(session, values(), kept)
    assert held(session) == list(values().values())
    assert [str(change) for change in changes][2] == "0x60FB:01 Position loop proportional gain: 20000 -> 15700"
    revert_gains(session, kept)
    assert held(session) == before
    with pytest.raises(DriveError, match="no gains of this drive were set from this computer"):
        revert_gains(session, kept)


def test_what_was_before_is_kept_before_anything_changes(monkeypatch):
    """A computer that dies in the middle leaves a drive whose gains can be taken back."""
    session, kept = session_with(OD), Kept()
    before = held(session)
    observed = []
    write = session.transfers.write

    def watched(*what):
        observed.append(bool(kept.held))
        write(*what)

    monkeypatch.setattr(session.transfers, "write", watched)
    set_gains(session, values(), kept)
    assert observed
    assert all(observed)
    revert_gains(session, kept)
    assert held(session) == before


def test_an_enabled_drive_takes_none(monkeypatch):
    session, kept = session_with(OD), Kept()
    before = held(session)
    monkeypatch.setattr(type(session), "powered_axes", lambda _self: [0])
    with pytest.raises(DriveError, match="is enabled; nothing was written"):
        set_gains(session, values(), kept)
    assert held(session) == before


def test_a_drive_that_refuses_one_is_as_it_was():
    session, kept = session_with(OD), Kept()
    before = held(session)
    with pytest.raises(DriveError, match="refused gains and is unchanged: 0x6060"):
        set_gains(session, {P: 500, (0x6060, 0): 77}, kept)
    assert held(session) == before


SERVO, TMCM = (read_eds(data_path("eds", f"{name}.eds"), 5).od for name in ("generic_cia402", "TMCM-1270"))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("velocity_p", "give the gain, its object"),
        ("speed=0x3210:01*1", "the gains are velocity_p, velocity_i, position_p, velocity_feed_forward"),
        ("velocity_p=0x3210:01*zero", "'zero' is not a scale"),
        ("velocity_p=0x3210:01*-1", "give a number above 0"),
        ("velocity_p=0x3210:01*nan", "give a number above 0"),
        ("velocity_p=0x3210:01*inf", "give a number above 0"),
    ],
)
def test_what_is_not_a_gain_is_reported(text, why):
    with pytest.raises(ConfigError, match=why):
        parse_gain(text)


def test_what_is_named_wins_and_is_worth_what_it_reports_at_the_shaft():
    per_rad = 4096 / math.tau
    objects = settable_gains(session_with(SERVO), 0, ["velocity_p=0x6081:00*0.5", "position_p=0x6083:00*0.1"], per_rad)
    assert objects[LoopGain.VELOCITY_P] == GainObject(0x6081, 0, 0.5 / per_rad)
    assert objects[LoopGain.POSITION_P] == GainObject(0x6083, 0, 0.1)
    assert objects[LoopGain.VELOCITY_I].index == 0x60F9


def test_an_object_that_is_not_there_is_reported():
    with pytest.raises(ConfigError, match="has no 0x3210:01 in its EDS"):
        settable_gains(session_with(SERVO), 0, ["velocity_p=0x3210:01*1"], 1.0)


def test_a_drive_with_unknown_gains_is_reported():
    with pytest.raises(ConfigError, match=r"the objects of velocity_p and velocity_i are unknown"):
        settable_gains(session_with(TMCM), 0, [], 1.0)


def test_the_objects_of_a_known_manufacturer_are_named_and_nothing_is_set_without_their_scale():
    entries = dict(SERVO.entries) | {(0x1018, 1): dataclasses.replace(SERVO[0x1018, 1], default=0xFB)}
    device = dataclasses.replace(SERVO.device, vendor_name="maxon motor ag")
    od = dataclasses.replace(SERVO, entries=entries, device=device)
    with pytest.raises(
        ConfigError, match=r"the manufacturer's gains are in 0x60F9:01 .*--gain velocity_p=0x60F9:01\*SCALE"
    ):
        settable_gains(session_with(od), 0, [], 1.0)
    named = ["velocity_p=0x60F9:01*0.5", "velocity_i=0x60F9:02*0.5"]
    assert len(settable_gains(session_with(od), 0, named, 1.0)) == 2
