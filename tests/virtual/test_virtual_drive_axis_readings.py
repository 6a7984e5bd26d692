from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import Bench, T, entry, servo, servo_od

from canopen_control.virtual.axis_objects import wrap32
from canopen_control.virtual.device import make_device
from canopen_control.virtual.virtual_drive import SOURCES, clamp


@given(st.integers(-(2**40), 2**40))
def test_a_counter_wraps_and_a_number_is_cut(value):
    assert (wrap32(value) - value) % 2**32 == 0
    assert -(2**31) <= wrap32(value) < 2**31
    assert clamp(value, 16) == max(-32768, min(32767, value))


def test_everything_shown_is_made_at_the_moment_of_reading():
    bench = Bench(servo()).enable(3)
    bench.write(0x60FF, 1000)
    bench.node.clock.now = bench.now = bench.now + 50_000_000
    assert bench.velocity == 500
    assert bench.number(0x606B) == 500
    assert (bench.position, bench.number(0x6062), bench.number(0x6063), bench.number(0x60FC)) == (12, 12, 12, 12)


def test_a_source_keeps_to_the_type_of_the_file():
    od = servo_od()
    od.add(entry(0x606C, 0, T.INTEGER16, None, "ro", True))
    bench = Bench(make_device(od, 5)).enable(9)
    bench.write(0x60FF, 1_000_000)
    bench.on(0.1)
    assert bench.read(0x606C) == b"\xff\x7f"
    bench.node.pdos.configure(bench.now)
    bench.sync()


def test_each_source_gives_a_whole_number():
    readings = Bench(servo()).drive.readings
    assert all(isinstance(source(readings), int) for source in SOURCES.values())
