from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.rpc.messages.drive import WorldState
from canopen_control.virtual import trajectory
from canopen_control.virtual.plant import IdealPlant, IndependentPlants, LagPlant, LoadedPlant

MS, S = 1_000_000, 1_000_000_000


def test_an_ideal_plant_is_where_the_demand_is_and_stands_without_power():
    plant = IdealPlant()
    demand = trajectory.ramp_to(0, 0.0, 0.0, 100.0, 200.0, 200.0)
    plant.follow(demand, 0, S)
    assert (plant.position, plant.velocity) == demand.at(S)
    plant.release(S, 2 * S)
    assert plant.velocity == 0.0


def test_a_lagging_plant_is_the_closed_form_of_a_step():
    plant = LagPlant(time_constant=0.1)
    step = trajectory.cruise(0, 0.0, 100.0)
    plant.follow(step, 0, S // 10)
    assert plant.velocity == pytest.approx(100 * (1 - math.exp(-1)))
    assert plant.position == pytest.approx(100 * 0.1 - 0.1 * 100 * (1 - math.exp(-1)))


def test_a_lagging_plant_follows_a_ramp_one_time_constant_behind():
    plant = LagPlant(time_constant=0.02)
    ramp = trajectory.ramp_to(0, 0.0, 0.0, 1000.0, 500.0, 500.0)
    plant.follow(ramp, 0, S)
    assert plant.velocity == pytest.approx(500 * (1 - 0.02), abs=1e-6)
    plant.follow(ramp, S, 4 * S)
    assert ramp.at(4 * S)[0] - plant.position == pytest.approx(0.02 * 1000)


@given(st.lists(st.integers(1, 400 * MS), min_size=1, max_size=12))
def test_a_lagging_plant_looked_at_often_is_the_one_looked_at_once(steps):
    demand = trajectory.move_to(0, 0.0, 0.0, 500.0, 300.0, 900.0, 400.0)
    often, once = LagPlant(), LagPlant()
    clock = 0
    for step in steps:
        often.follow(demand, clock, clock + step)
        clock += step
    once.follow(demand, 0, clock)
    assert often.position == pytest.approx(once.position, abs=1e-6)
    assert often.velocity == pytest.approx(once.velocity, abs=1e-6)


def test_without_power_a_lagging_plant_coasts():
    plant = LagPlant(velocity=100.0, coast_time_constant=0.5)
    plant.release(0, S // 2)
    assert plant.velocity == pytest.approx(100 * math.exp(-1))
    assert plant.position == pytest.approx(50 * (1 - math.exp(-1)))


@pytest.mark.parametrize("plant", [IdealPlant(), LagPlant()])
def test_torque_ends_in_the_velocity_that_belongs_to_it(plant):
    plant.apply_torque(trajectory.ramp_to(0, 0.0, 0.0, 500.0, 1000.0, 1000.0), 0, 10 * S)
    assert plant.velocity == pytest.approx(plant.rated_velocity / 2, rel=1e-6)
    assert plant.torque == 500.0


def run_loaded(plant, demand, seconds, step=MS):
    for clock in range(0, round(seconds * S), step):
        plant.follow(demand, clock, clock + step)
    return plant


def test_a_loaded_plant_follows_a_gentle_move_and_stands_at_its_end():
    demand = trajectory.move_to(0, 0.0, 0.0, 5000.0, 10_000.0, 50_000.0, 50_000.0)
    plant = run_loaded(LoadedPlant(), demand, 2.0)
    assert plant.position == pytest.approx(5000, abs=2)
    assert abs(plant.velocity) < 5


def test_a_loaded_plant_does_not_depend_on_the_times_of_reading():
    demand = trajectory.move_to(0, 0.0, 0.0, 5000.0, 10_000.0, 50_000.0, 50_000.0)
    assert (
        run_loaded(LoadedPlant(), demand, 0.6).position
        == run_loaded(LoadedPlant(), demand, 0.6, 7 * MS // 7 * 3).position
    )


def test_a_torque_limit_and_an_inertia_leave_it_behind():
    demand = trajectory.ramp_to(0, 0.0, 0.0, 100_000.0, 2_000_000.0, 2_000_000.0)
    strong = run_loaded(LoadedPlant(torque_limit=3000.0), demand, 0.05)
    weak = run_loaded(LoadedPlant(torque_limit=500.0, inertia=1.0), demand, 0.05)
    assert weak.velocity < strong.velocity / 4
    assert abs(weak.torque) <= 500.0


def test_a_motor_that_is_weak_for_its_load_comes_to_rest_at_the_velocity_it_was_asked_for():
    demand = trajectory.ramp_to(0, 0.0, 0.0, 32_750.0, math.inf, math.inf)
    weak = run_loaded(LoadedPlant(inertia=2.0, friction=30.0), demand, 0.16)
    assert weak.velocity == pytest.approx(32_750.0, rel=0.01)
    assert abs(weak.torque) < 100.0


def test_gravity_moves_it_without_power_and_friction_holds_it():
    falling, held = LoadedPlant(external=-300.0), LoadedPlant(external=-10.0, friction=20.0)
    for plant in (falling, held):
        plant.release(0, S // 10)
    assert falling.position < -1000
    assert held.position == 0.0


def test_a_stalled_shaft_does_not_move_and_backlash_leaves_the_load_behind():
    stalled = run_loaded(LoadedPlant(stalled=True), trajectory.cruise(0, 0.0, 1000.0), 0.1)
    assert stalled.position == 0.0
    assert abs(stalled.torque) > 0.0
    loose = run_loaded(LoadedPlant(backlash=100.0), trajectory.cruise(0, 0.0, 1000.0), 0.5)
    assert loose.position - loose.load_position == pytest.approx(50.0)


def test_torque_accelerates_a_loaded_plant_until_friction_and_viscosity_balance_it():
    plant = LoadedPlant(viscosity=0.01)
    plant.apply_torque(trajectory.DemandCurve(0, 0.0, (), 100.0), 0, 20 * S)
    assert plant.velocity == pytest.approx((100 - plant.friction) / 0.01, rel=0.01)


def test_a_plain_world_gives_every_axis_a_plant_of_its_own():
    world = IndependentPlants()
    first, second = world.plant(3, 0), world.plant(3, 1)
    assert isinstance(first, IdealPlant)
    assert first is not second
    assert (world.describe(), world.period_ns) == (WorldState(), None)
    world.close()


def settled(plant, seconds=3):
    """The error of a plant that follows 100 counts/s, once it has settled."""
    demand = trajectory.cruise(0, 0.0, 100.0)
    for step in range(seconds * 10):
        plant.follow(demand, step * 100 * MS, (step + 1) * 100 * MS)
    return demand.at(seconds * S)[0] - plant.position


@pytest.mark.parametrize(("fed", "error"), [(0.0, 10.0), (60.0, 4.0), (100.0, 0.0), (150.0, -5.0)])
def test_what_is_fed_forward_goes_past_the_position_loop_of_a_lagging_plant(fed, error):
    plant = LagPlant(time_constant=0.1)
    plant.feed_forward(fed, 0.0)
    assert settled(plant) == pytest.approx(error, abs=0.01)
    assert plant.velocity == pytest.approx(100.0)


def test_a_loaded_plant_lags_without_feed_forward():
    parts = {"friction": 0.0, "viscosity": 0.0, "position_gain": 20.0}
    blind, knowing = (LoadedPlant(velocity_feed_forward=share, **parts) for share in (0.0, 1.0))
    assert settled(blind) == pytest.approx(100 / 20.0, rel=0.02)
    assert settled(knowing) == pytest.approx(0.0, abs=0.1)
    loaded_plant = LoadedPlant(velocity_feed_forward=0.0, **parts)
    loaded_plant.feed_forward(100.0, 0.0)
    assert settled(loaded_plant) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("plant", [IdealPlant(), LagPlant(), LoadedPlant()])
def test_without_power_nothing_is_fed_forward(plant):
    plant.feed_forward(100.0, 50.0)
    plant.release(0, 5 * S)
    assert abs(plant.velocity) < 1.0
    before = plant.velocity
    plant.feed_forward(0.0, 0.0)
    assert plant.velocity == before
