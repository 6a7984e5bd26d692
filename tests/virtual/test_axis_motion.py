from __future__ import annotations

import math

import pytest
from support.virtualbench import Bench, generic, servo

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


# User units and polarity, seen through the objects of a drive that has them all.


# encoder 4096 inc/rev, gear 10:1, 360 units per revolution of the shaft: 113.77 counts for each unit
FACTORS = {(0x608F, 1): 4096, (0x608F, 2): 1, (0x6091, 1): 10, (0x6091, 2): 1, (0x6092, 1): 360, (0x6092, 2): 1}
COUNTS = 4096 * 10 / 360


def bench(mode, polarity=0, factors=FACTORS):
    b = Bench(generic())
    for (index, sub), value in factors.items():
        b.write(index, value, sub)
    b.write(0x607E, polarity)
    for index, value in ((0x6081, 1000), (0x6083, 10_000), (0x6084, 10_000), (0x6085, 10_000)):
        b.write(index, value)
    return b.enable(mode)


@pytest.mark.parametrize(("polarity", "turned"), [(0, 1), (0x80, -1), (0x40, 1), (0xC0, -1)])
def test_pp_goes_to_the_users_position_with_the_users_speed(polarity, turned):
    b = bench(1, polarity)
    b.write(0x607A, 900)
    b.control(0x1F)
    b.on(0.5)
    assert b.drive.mover.plant.velocity == pytest.approx(turned * 1000 * COUNTS)
    b.on(1.0)
    assert b.position == 900
    assert b.drive.mover.plant.position == pytest.approx(turned * 900 * COUNTS)
    assert b.number(0x6063, signed=True) == round(turned * 900 * COUNTS)
    assert b.number(0x6062, signed=True) == 900
    assert b.statusword & 0x0400


@pytest.mark.parametrize(("polarity", "turned"), [(0, 1), (0x80, 1), (0x40, -1)])
@pytest.mark.parametrize("mode", [3, 9])
def test_velocities_are_the_users_and_turned_by_bit_6(mode, polarity, turned):
    b = bench(mode, polarity)
    b.write(0x60FF, 500)
    b.on(0.5)
    assert b.velocity == 500
    assert b.drive.mover.plant.velocity == pytest.approx(turned * 500 * COUNTS)
    b.control(0x02)
    b.on(0.025)
    assert b.velocity == 250


def test_ramps_are_the_users():
    b = bench(3)
    b.write(0x60FF, 500)
    b.on(0.025)
    assert b.velocity == 250


def test_csp_is_the_users():
    b = bench(8, 0x80)
    b.write(0x607A, 50)
    b.on(1)
    assert (b.position, b.drive.mover.plant.position) == (50, pytest.approx(-50 * COUNTS))


def test_software_limits_are_the_users_also_turned_round():
    b = bench(1, 0x80)
    b.write(0x607D, -100, 1)
    b.write(0x607D, 300, 2)
    for target, end in ((900, 300), (-900, -100)):
        b.write(0x607A, target)
        b.control(0x1F)
        b.control(0x0F)
        b.on(3)
        assert b.position == end
        assert b.statusword & 0x0800


def test_homing_offset_and_vl_rpm_follow_the_polarity():
    b = bench(6, 0x80)
    b.write(0x6098, 37)
    b.write(0x607C, 123)
    b.control(0x1F)
    b.on(0.1)
    assert b.position == 123
    b = bench(2, 0x40)
    for index, sub, value in ((0x6046, 2, 10_000), (0x6048, 1, 600), (0x6048, 2, 1), (0x6049, 1, 600), (0x6049, 2, 1)):
        b.write(index, value, sub)
    b.write(0x6042, 60)
    b.control(0x7F)
    b.on(1)
    assert b.number(0x6044, signed=True) == 60
    assert b.drive.mover.plant.velocity == pytest.approx(-4096)


def test_a_change_of_polarity_turns_what_is_shown_and_moves_nothing():
    b = bench(1)
    b.write(0x607A, 90)
    b.control(0x1F)
    b.on(3)
    before = b.drive.mover.plant.position
    b.write(0x607E, 0x80)
    b.on(1)
    assert (b.position, b.drive.mover.plant.position) == (-90, before)


def test_zeros_divide_nothing_and_without_a_feed_constant_a_unit_is_a_count():
    b = bench(3, factors=dict.fromkeys(FACTORS, 0))
    b.write(0x60FF, 500)
    b.on(0.5)
    assert b.velocity == 500
    assert Bench(servo()).drive.objects.units.length == 1.0  # which has 0x608F alone


@pytest.mark.parametrize(("unit", "of_one_rpm"), [(0x00B44700, 1.0), (0xFFB44700, 0.1), (0x00000000, 0.0)])
def test_velocities_are_in_the_rpm_that_0x60a9_names(unit, of_one_rpm):
    from support.virtualbench import servo_od  # the unit is not an object of every servo

    from canopen_control.od.model import DataType, Entry
    from canopen_control.virtual.device import make_device

    od = servo_od()
    od.add(Entry(0x60A9, 0, "SI unit velocity", DataType.UNSIGNED32, "ro", default=unit))
    b = Bench(make_device(od, 5))
    b.enable(3)
    b.write(0x60FF, 60)
    b.on(0.5)
    counts_per_s = 60 * of_one_rpm * 6000 / 60 if of_one_rpm else 60
    assert b.drive.mover.plant.velocity == pytest.approx(counts_per_s)
    assert b.velocity == 60
