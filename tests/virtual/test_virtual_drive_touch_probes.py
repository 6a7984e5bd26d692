from __future__ import annotations

import pytest
from support.virtualbench import Bench, generic

from canopen_control.virtual.plant import LagPlant

INPUT_1, INPUT_2 = 1 << 16, 1 << 17


def turning(speed=1000, **kwargs):
    b = Bench(generic(**kwargs))
    for index in (0x6083, 0x6084):
        b.write(index, 100_000)
    b.enable(3)
    b.write(0x60FF, speed)
    b.on(1)
    return b


def inputs(b, bits):
    b.drive.set_inputs(bits, b.now)
    b.on(0)


def status(b):
    return b.number(0x60B9)


def caught(b, index):
    return b.number(index, signed=True)


def test_a_single_probe_catches_the_first_rising_edge_after_it_is_armed():
    b = turning()
    inputs(b, INPUT_1)
    assert status(b) == 0
    inputs(b, 0)
    b.write(0x60B8, 0x0011)
    assert status(b) == 0x0001
    b.on(0.1)
    here = b.position
    inputs(b, INPUT_1)
    assert (status(b), caught(b, 0x60BA)) == (0x0003, here)
    b.on(0.1)
    inputs(b, 0)
    inputs(b, INPUT_1)
    assert caught(b, 0x60BA) == here
    b.write(0x60B8, 0)
    assert status(b) == 0
    b.write(0x60B8, 0x0011)
    assert status(b) == 0x0001


def test_a_continuous_probe_catches_both_edges_every_time():
    b = turning()
    b.write(0x60B8, 0x0033)
    for bits, index, bit in ((INPUT_1, 0x60BA, 2), (0, 0x60BB, 4), (INPUT_1, 0x60BA, 2)):
        b.on(0.1)
        here = b.position
        inputs(b, bits)
        assert caught(b, index) == here
        assert status(b) & bit


def test_the_second_probe_is_apart_from_the_first():
    b = turning()
    b.write(0x60B8, 0x3111)
    b.on(0.1)
    here = b.position
    inputs(b, INPUT_2)
    assert (status(b), caught(b, 0x60BC)) == (0x0301, here)
    b.write(0x60B8, 0x3011 ^ 0x3000)
    assert status(b) == 0x0001  # switching off the second forgot it, and only it


@pytest.mark.rest
@pytest.mark.parametrize("plant", [None, lambda axis: LagPlant()])
@pytest.mark.parametrize("speed", [1000, -1000])
def test_the_index_pulse_is_caught_where_it_is(plant, speed):
    b = turning(speed, plant=plant)
    period = int(b.drive.mover.switches.index_period)
    b.write(0x60B8, 0x0015)
    assert status(b) == 0x0001
    b.on(6)
    assert status(b) == 0x0003
    assert caught(b, 0x60BA) == (period if speed > 0 else -period)
    before = caught(b, 0x60BA)
    b.on(10)
    assert caught(b, 0x60BA) == before


def test_a_continuous_index_probe_catches_every_one():
    b = turning()
    b.write(0x60B8, 0x0017)
    b.on(14)
    assert caught(b, 0x60BA) == 3 * 4096


def test_a_standing_motor_passes_no_index_and_costs_no_deadline():
    b = Bench(generic()).enable(3)
    b.write(0x60B8, 0x0017)
    b.on(10)
    assert status(b) == 0x0001
    assert b.node.next_deadline() is None


def test_power_on_disarms():
    b = turning()
    b.write(0x60B8, 0x0011)
    b.node.power_on(b.now)
    b.on(0.1)
    inputs(b, INPUT_1)
    assert (b.number(0x60B8), status(b)) == (0, 0)
