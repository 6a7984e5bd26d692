from __future__ import annotations

import math

from support.virtualbench import Bench, S, ready_tmcm, servo

from canopen_control.cia402.state import POWERED_STATES, State
from canopen_control.virtual.fault_table import FaultSwitches
from canopen_control.virtual.node_outbox import in_words

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


def test_a_motor_beyond_its_limit_may_only_return():
    bench = with_limits(-100, 100)
    bench.drive.mover.displace(300.0, bench.now)
    bench.write(0x60FF, 1000)
    bench.on(1)
    assert bench.position == 300
    bench.write(0x60FF, -1000)
    bench.on(1)
    assert bench.position == -100


def test_a_window_of_nothing_or_everything_is_not_a_following_error():
    bench = Bench(servo()).enable(3)
    for window in (0, 0xFFFFFFFF):
        bench.write(0x6065, window)
        bench.drive.check_following_error(1e6, bench.now)
        assert not bench.drive.limits.exceeded
    bench.write(0x6065, 10)
    bench.drive.check_following_error(11.0, bench.now)
    assert bench.drive.limits.exceeded


def test_the_motor_has_power_in_the_powered_states_only():
    bench = Bench(servo(x605A=6))
    bench.start()
    observed = set()
    for word in (6, 7, 15, 2, 15, 7, 15, 0, 6, 7, 15):
        bench.control(word)
        bench.on(0.01)
        assert bench.drive.mover.powered == (bench.drive.state in POWERED_STATES)
        observed.add(bench.drive.state)
    assert {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED} <= observed


def test_a_fault_during_a_slow_transition_ends_it():
    bench = Bench(servo())
    bench.start()
    bench.drive.power.transition_delay_ns.inject(S)
    bench.control(6)
    bench.on(0.5)
    bench.drive.fault(0x4310, bench.now)
    bench.on(5)
    assert bench.state == "FAULT"


def test_disable_voltage_does_not_wait_for_a_slow_transition():
    bench = Bench(servo()).enable(3)
    bench.write(0x60FF, 1000)
    bench.on(1)
    bench.drive.power.transition_delay_ns.inject(S)
    bench.control(0x07)
    bench.on(0.1)
    bench.control(0x00)
    assert (bench.state, bench.velocity) == ("SWITCH_ON_DISABLED", 0)
    bench.on(5)
    assert bench.state == "SWITCH_ON_DISABLED"


def test_a_newer_fault_shows_its_code():
    bench = Bench(servo())
    for code in (0x4310, 0x3210):
        bench.drive.fault(code, bench.now)
    assert bench.state == "FAULT"
    assert bench.number(0x603F) == 0x3210


def test_a_vendors_option_code_is_taken_for_the_default():
    bench = Bench(servo(x605A=-3)).enable(3)
    bench.write(0x60FF, 1000)
    bench.on(1)
    bench.control(0x02)
    assert bench.state == "QUICK_STOP_ACTIVE"
    bench.on(0.051)
    assert bench.state == "SWITCH_ON_DISABLED"


def ignored(bench):
    return [words for event in bench.events if (words := in_words(event)) is not None and "ignored" in words]


def test_what_is_not_obeyed_in_pre_operational_is_reported_once_and_what_to_do():
    bench = Bench(servo())
    bench.on(0.1)
    for word in (6, 7, 15, 15, 15):
        bench.write(0x6040, word)
    assert bench.state == "SWITCHED_ON"
    reported = "controlword 0x000F ignored: the node is PRE_OPERATIONAL; the drive can be enabled only in OPERATIONAL"
    assert ignored(bench) == [reported]
    bench.start()
    bench.write(0x6040, 15)
    assert bench.state == "OPERATION_ENABLED"
    assert ignored(bench) == [reported]


def test_a_drive_that_serves_it_is_enabled_and_moves_by_sdo_in_pre_operational():
    bench = Bench(servo())
    bench.on(0.1)
    FaultSwitches(bench.node).set("enabled_in_preop", True, bench.now)
    bench.write(0x6060, 3)
    for word in (6, 7, 15):
        bench.write(0x6040, word)
    bench.write(0x60FF, 1000)
    bench.on(2)
    assert (bench.state, bench.velocity) == ("OPERATION_ENABLED", 1000)
    assert ignored(bench) == []


def test_other_controlwords_that_do_nothing_are_reported_too():
    bench = Bench(servo())
    bench.start()
    bench.control(15)
    bench.control(6)
    bench.drive.power.voltage.inject(False)
    for word in (7, 15, 15):
        bench.control(word)
    bench.drive.power.hold_cause(0x4310)
    bench.drive.fault(0x4310, bench.now)
    bench.on(1)
    bench.control(0)
    bench.control(0x80)
    assert ignored(bench) == [
        "controlword 0x000F ignored: the drive is in SWITCH_ON_DISABLED; send controlword 0x0006 first",
        "controlword 0x000F ignored: the power stage has no supply",
        "controlword 0x0080 ignored: the cause of fault 0x4310 persists",
    ]


def test_the_greatest_velocity_follows_its_object():
    bench = Bench(servo(x607F=500))
    assert bench.drive.limits.velocity(900.0) == 500.0
    bench.write(0x607F, 700)
    assert bench.drive.limits.velocity(900.0) == 700.0
