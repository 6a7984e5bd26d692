"""Virtual encoders and inclinometers: range, scaling, preset, direction, timer, resolution."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.devices import put
from support.devices import virtual as bench

TPDO = 0x185


def sent(device):
    return [frame.data for _, frame in device.seen if frame.can_id == TPDO]


@given(st.floats(-1e5, 1e5))
def test_a_position_begins_again_at_the_total_range(angle):
    device = bench(406)
    device.write(0x6002, 10000)
    put(device, position=angle)
    assert device.number(0x6004) == round(angle / math.tau * 4096) % 10000


def test_scaling_direction_and_preset():
    device = bench(406)
    put(device, position=math.tau / 4)
    assert device.number(0x6004) == 1024
    device.write(0x6001, 360)
    assert device.number(0x6004) == 90
    device.write(0x6000, 0)  # no scaling: the steps of the disc
    assert device.number(0x6004) == 2048
    device.write(0x6000, 5)
    assert device.number(0x6004) == (1 << 24) - 90
    device.write(0x6003, 1000)
    assert device.number(0x6004) == 1000
    put(device, position=math.tau / 2)
    assert device.number(0x6004) == 910


def test_a_timer_sends_and_changes_alone_do_not():
    device = bench(406)
    device.write(0x6200, 50)
    assert device.number(0x1800, 5) == 50
    device.start()
    before = len(sent(device))
    put(device, position=1.0)
    assert len(sent(device)) == before
    device.on(0.225)
    assert len(sent(device)) == before + 4
    device.write(0x6200, 0)
    before = len(sent(device))
    put(device, position=2.0)
    assert len(sent(device)) == before + 1


def test_a_velocity_turns_it_on():
    device = bench(406)
    put(device, velocity=math.tau)
    device.on(1.0)
    assert device.number(0x6004) == pytest.approx(4096, abs=60)
    put(device, velocity=0.0)
    stands = device.number(0x6004)
    assert device.on(1.0).number(0x6004) == stands


def test_a_jump_is_a_quarter_of_a_turn():
    device = bench(406)
    device.node.function.break_inputs("jump", on=True, now=device.now)
    assert device.number(0x6004) == 1024


def test_an_angle_is_rescaled_at_once_and_in_both_formats():
    device = bench(410)
    put(device, longitudinal=math.radians(10), lateral=math.radians(-20))
    assert (device.number(0x6010, signed=True), device.number(0x6120, signed=True)) == (1000, -2000)
    device.write(0x6000, 100)
    assert (device.number(0x6010, signed=True), device.number(0x6020, signed=True)) == (100, -200)


def test_an_angle_is_inverted_and_preset():
    device = bench(410)
    put(device, longitudinal=math.radians(10))
    device.write(0x6011, 1)
    assert device.number(0x6010, signed=True) == -1000
    device.write(0x6011, 3)
    device.write(0x6012, 0)
    assert (device.number(0x6010, signed=True), device.number(0x6013, signed=True)) == (0, 1000)
    device.write(0x6014, 5)
    assert device.number(0x6010, signed=True) == 5
