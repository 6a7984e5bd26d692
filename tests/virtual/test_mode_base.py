from __future__ import annotations

from support.virtualbench import Bench, servo

from canopen_control.virtual.mode_base import REACHED, Mode


def test_a_drive_without_a_mode_stands_and_reports_this():
    bench = Bench(servo()).enable()
    assert type(bench.drive.modes.active) is Mode
    assert bench.statusword & REACHED
    bench.write(0x60FF, 1000)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(1)
    assert (bench.position, bench.velocity) == (0, 0)


def test_its_slow_down_ramp_is_0x6084():
    bench = Bench(servo(x6084=1234))
    assert bench.drive.modes.active.deceleration() == 1234.0
