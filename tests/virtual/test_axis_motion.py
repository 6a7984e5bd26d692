from __future__ import annotations

import math

from canopen_control.virtual import trajectory
from canopen_control.virtual.axis_motion import SAMPLE_NS, AxisMotion
from canopen_control.virtual.plant import IdealPlant, LagPlant

S = 1_000_000_000


class Owner:
    """Records its calls."""

    def __init__(self, samples=False):
        self.collected = []
        self.samples = samples

    def arrived(self, now):
        self.collected.append(("arrived", now))

    def limit_switch_hit(self, side, now):
        self.collected.append(("limit switch", side, now))

    def check_following_error(self, error, now):
        self.collected.append(("behind", round(error), now))

    def on_sample(self):
        self.collected.append("sampled")

    def wants_samples(self):
        return self.samples

    def next_index(self, demand, now):
        return self.index(demand, now)

    def index_passed(self, place):
        self.collected.append(("index", place))

    def index(self, demand, now):
        return None


def powered(plant=None, **kwargs):
    owner = Owner(**kwargs)
    mover = AxisMotion(plant or IdealPlant(), owner)
    mover.advance(0)
    mover.power(True, 0)
    return mover, owner


def test_timers_are_served_in_order_each_at_its_own_time():
    mover, _ = powered()
    served = []
    for name, due in (("b", 20), ("a", 10), ("c", 30)):
        mover.at(name, due, lambda now, name=name: served.append((name, now, mover.now)))
    mover.cancel("nothing")
    mover.advance(25)
    assert served == [("a", 10, 10), ("b", 20, 20)]
    assert mover.next_deadline() == 30
    mover.cancel("c")
    assert mover.next_deadline() is None


def test_a_timer_of_the_same_name_gives_way_and_may_set_itself_again():
    mover, _ = powered()
    served = []

    def again(now):
        served.append(now)
        if now < 50:
            mover.at("x", now + 10, again)

    mover.at("x", 5, lambda now: served.append("old"))
    mover.at("x", 10, again)
    mover.advance(100)
    assert served == [10, 20, 30, 40, 50]


def test_the_end_of_a_demand_is_reported_once():
    mover, owner = powered()
    mover.run(trajectory.ramp_to(0, 0.0, 0.0, 100.0, 100.0, 100.0), 0)
    mover.advance(5 * S)
    assert owner.collected == [("arrived", S)]
    assert (mover.plant.position, mover.plant.velocity) == (450.0, 100.0)
    mover.run(trajectory.hold(5 * S, 450.0), 5 * S)
    assert owner.collected[1:] == [("arrived", 5 * S)]


def test_without_power_the_plant_is_released_and_the_demand_is_where_it_is():
    mover, _ = powered(LagPlant())
    mover.run(trajectory.cruise(0, 0.0, 100.0), 0)
    mover.advance(S)
    mover.power(False, S)
    mover.advance(10 * S)
    assert mover.at_standstill
    assert mover.state(10 * S) == (mover.plant.position, mover.plant.velocity)


def test_a_plant_that_lags_is_compared_until_both_stand():
    mover, owner = powered(LagPlant(time_constant=0.05))
    mover.run(trajectory.move_to(0, 0.0, 0.0, 100.0, 1000.0, 1000.0, 1000.0), 0)
    mover.advance(5 * S)
    errors = [item[1] for item in owner.collected if item[0] == "behind"]
    assert max(errors) > 5
    assert errors[-1] == 0
    assert mover.next_deadline() is None


def test_wired_switches_are_touched_where_they_are():
    mover, owner = powered()
    mover.switches.wired, mover.switches.positive = True, 50.0
    mover.run(trajectory.cruise(0, 0.0, 100.0), 0)
    mover.advance(S)
    assert ("limit switch", 1, S // 2) in owner.collected


def test_moving_values_are_sampled_only_for_subscribers():
    for value in (False, True):
        mover, owner = powered(samples=value)
        mover.run(trajectory.move_to(0, 0.0, 0.0, 100.0, 1000.0, 1000.0, 1000.0), 0)
        mover.advance(5 * S)
        end = mover.demand.end_ns
        assert owner.collected.count("sampled") == (end // SAMPLE_NS + 1 if value else 0)
        assert mover.next_deadline() is None


def test_a_shaft_moved_by_force_continues_from_there():
    mover, _ = powered()
    mover.run(trajectory.cruise(0, 0.0, 100.0), 0)
    mover.advance(S)
    mover.displace(-30.0, S)
    mover.advance(2 * S)
    assert mover.plant.position == 170.0


def test_a_torque_pushes_the_plant_and_its_ramp_has_an_end():
    mover, owner = powered()
    mover.apply_torque(trajectory.ramp_to(0, 0.0, 0.0, 100.0, 200.0, 200.0), 0)
    mover.advance(S)
    assert owner.collected == [("arrived", S // 2)]
    assert mover.plant.velocity > 0
    assert mover.state(S) == (mover.plant.position, mover.plant.velocity)


class Coupled(LagPlant):
    """A plant that is judged every 4 ms, and notes who leads it."""

    rated_torque, follow_ns = 1.0, 4_000_000

    def set_owner(self, owner):
        self.owner = owner


class Judge(Owner):
    def check_load(self, torque, now):
        self.collected.append(("load", torque, now))


def test_a_coupled_plant_follows_its_leader_and_is_evaluated_at_its_times_without_a_timer():
    plant, owner = Coupled(), Judge()
    mover = AxisMotion(plant, owner)
    assert plant.owner is mover
    assert mover.torque_limit == math.inf
    mover.advance(1_500_000)
    mover.power(True, 1_500_000)
    mover.run(trajectory.hold(1_500_000, 0.0), 1_500_000)
    owner.collected.clear()
    assert mover.next_deadline() is None
    assert mover.next_event() == 4_000_000
    mover.advance(9_000_000)
    assert owner.collected == [
        ("behind", 0, 4_000_000), ("load", 0.0, 4_000_000), ("behind", 0, 8_000_000), ("load", 0.0, 8_000_000),
    ]  # fmt: skip


def test_a_pushed_one_is_judged_by_its_load_alone_and_none_without_power():
    plant, owner = Coupled(), Judge()
    mover = AxisMotion(plant, owner)
    mover.advance(0)
    mover.power(True, 0)
    mover.apply_torque(trajectory.hold(0, 0.0), 0)
    mover.advance(5_000_000)
    assert [reported[0] for reported in owner.collected if reported[0] != "arrived"] == ["load"]
    mover.power(False, 5_000_000)
    mover.advance(20_000_000)
    assert mover.next_event() is None
