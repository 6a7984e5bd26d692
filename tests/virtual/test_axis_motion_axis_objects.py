"""User units and polarity, seen through the objects of a drive that has them all."""

from __future__ import annotations

import pytest
from support.virtualbench import Bench, generic, servo

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
