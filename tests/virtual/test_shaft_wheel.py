from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.virtual import trajectory
from canopen_control.virtual.plant import IdealPlant, LagPlant, LoadedPlant
from canopen_control.virtual.shaft import GRID_NS, WheelPlant

MS, S = 1_000_000, 1_000_000_000


class Floor:
    def __init__(self):
        self.points = []

    def report(self, wheel, points):
        assert wheel == 1
        self.points += points


def wheel(inner=None, metres=0.001, **kwargs):
    floor = Floor()
    return WheelPlant(inner or IdealPlant(), floor, 1, metres, **kwargs), floor


def test_it_moves_as_its_inner_plant_and_reports_the_way_on_a_grid():
    plant, floor = wheel()
    demand = trajectory.ramp_to(0, 0.0, 0.0, 1000.0, 2000.0, 2000.0)
    plant.follow(demand, 0, S)
    assert (plant.position, plant.velocity) == demand.at(S)
    plant.publish()
    assert [when for when, _ in floor.points] == list(range(GRID_NS, S + 1, GRID_NS))
    assert floor.points[-1][1] == pytest.approx(demand.at(S)[0] * 0.001)


@pytest.mark.parametrize("inner", [IdealPlant, LagPlant, LoadedPlant])
@given(st.lists(st.integers(1, 60 * MS), min_size=1, max_size=20))
def test_its_reports_do_not_depend_on_the_times_of_reading(inner, steps):
    demand = trajectory.move_to(0, 0.0, 0.0, 500.0, 3000.0, 9000.0, 9000.0)
    (often, first), (once, second) = wheel(inner()), wheel(inner())
    clock = 0
    for step in steps:
        often.follow(demand, clock, clock + step)
        clock += step
    once.follow(demand, 0, clock)
    often.publish()
    once.publish()
    assert [when for when, _ in first.points] == [when for when, _ in second.points]
    ways = [way for _, way in second.points]
    assert [way for _, way in first.points] == pytest.approx(ways, abs=1e-9)


def test_at_rest_a_long_time_is_one_point():
    plant, floor = wheel()
    plant.follow(trajectory.hold(0, 0.0), 0, 3600 * S)
    plant.release(3600 * S, 7200 * S)
    plant.publish()
    assert floor.points == [(3600 * S, 0.0), (7200 * S, 0.0)]


def test_a_reversed_wheel_goes_backwards_and_a_displaced_one_is_lifted():
    plant, floor = wheel(metres=-0.001)
    plant.position = 500.0
    plant.follow(trajectory.linear_to(0, 500.0, 600.0, 0.1), 0, S // 10)
    plant.publish()
    assert floor.points[-1][1] == pytest.approx(-0.1)


def test_a_torque_moves_it_too():
    plant, floor = wheel()
    plant.apply_torque(trajectory.ramp_to(0, 0.0, 0.0, 500.0, 1000.0, 1000.0), 0, S)
    plant.publish()
    assert floor.points[-1][1] == pytest.approx(plant.position * 0.001)
    plant.velocity = plant.torque = 0.0
    plant.stiff = False
    assert not plant.stiff


def test_slip_is_the_same_for_a_seed_however_it_is_looked_at():
    demand = trajectory.cruise(0, 0.0, 1000.0)
    ways = []
    for step in (20 * MS, 7 * MS):
        plant, floor = wheel(slip=0.05, seed=3)
        for clock in range(0, 140 * MS, step):
            plant.follow(demand, clock, clock + step)
        plant.publish()
        ways.append([way for _, way in floor.points])
    assert ways[0] == pytest.approx(ways[1])
    assert ways[0][-1] != pytest.approx(0.14, abs=1e-6)


def test_what_is_fed_forward_reaches_the_motor():
    moving, _floor = wheel(LagPlant())
    moving.feed_forward(100.0, 0.0)
    assert moving.velocity == moving.inner.velocity == 100.0
