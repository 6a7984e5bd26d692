from __future__ import annotations

import math

from support.virtualbench import Bench, ready_tmcm, servo

LOWEST, HIGHEST = -0x7FFFFFFF, 0x7FFFFFFF


def with_limits(low, high, mode=3):
    bench = Bench(servo())
    bench.write(0x607D, low, 1)
    bench.write(0x607D, high, 2)
    return bench.enable(mode)


def test_software_limits_count_only_in_the_right_order_and_inside_the_type():
    assert with_limits(0, 0).drive.limits.bounds() == (-math.inf, math.inf)
    assert with_limits(10, -10).drive.limits.bounds() == (-math.inf, math.inf)
    assert with_limits(LOWEST, HIGHEST).drive.limits.bounds() == (-math.inf, math.inf)
    assert with_limits(-5, 5).drive.limits.bounds() == (-5.0, 5.0)
    assert with_limits(LOWEST, 5).drive.limits.bounds() == (-math.inf, 5.0)


def test_they_move_with_the_zero_of_the_user():
    bench = with_limits(-5, 5)
    bench.drive.objects.units.zero = 100.0
    assert bench.drive.limits.bounds() == (95.0, 105.0)


def test_velocity_and_torque_have_theirs():
    bench = Bench(servo(x607F=500, x6072=300))
    assert [bench.drive.limits.velocity(v) for v in (-900.0, 100.0, 900.0)] == [-500.0, 100.0, 500.0]
    assert [bench.drive.limits.torque(v) for v in (-900.0, 100.0, 900.0)] == [-300.0, 100.0, 300.0]


def test_the_tmcm_1270_reports_the_side_of_its_software_limit_once():
    bench = ready_tmcm()
    bench.write(0x607D, -500, 1)
    bench.write(0x607D, 500, 2)
    bench.seen.clear()
    bench.write(0x60FF, 1600)
    bench.on(3)
    bench.write(0x60FF, -1600)
    bench.on(3)
    messages = [frame.data[:4].hex() for _, frame in bench.seen if frame.can_id == 0x083]
    assert messages == ["01ff8102", "00000000", "01ff8101", "00000000"]
    assert bench.position == -500


def test_a_motor_beyond_its_limit_may_only_come_back():
    bench = with_limits(-100, 100)
    bench.drive.mover.displace(300.0, bench.now)
    bench.write(0x60FF, 1000)
    bench.on(1)
    assert bench.position == 300
    bench.write(0x60FF, -1000)
    bench.on(1)
    assert bench.position == -100


def test_a_window_of_nothing_or_everything_is_no_following_error():
    bench = Bench(servo()).enable(3)
    for window in (0, 0xFFFFFFFF):
        bench.write(0x6065, window)
        bench.drive.judge_following_error(1e6, bench.now)
        assert not bench.drive.limits.exceeded
    bench.write(0x6065, 10)
    bench.drive.judge_following_error(11.0, bench.now)
    assert bench.drive.limits.exceeded
