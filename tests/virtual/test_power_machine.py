from __future__ import annotations

from support.virtualbench import Bench, S, servo

from canopen_control.cia402.state import POWERED_STATES, State


def test_the_motor_has_power_in_the_powered_states_only():
    bench = Bench(servo(x605A=6))
    bench.start()
    seen = set()
    for word in (6, 7, 15, 2, 15, 7, 15, 0, 6, 7, 15):
        bench.control(word)
        bench.on(0.01)
        assert bench.drive.mover.powered == (bench.drive.state in POWERED_STATES)
        seen.add(bench.drive.state)
    assert {State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.SWITCH_ON_DISABLED} <= seen


def test_a_fault_during_a_slow_transition_ends_it():
    bench = Bench(servo())
    bench.start()
    bench.drive.power.transition_delay_ns.break_with(S)
    bench.control(6)
    bench.on(0.5)
    bench.drive.fault(0x4310, bench.now)
    bench.on(5)
    assert bench.state == "FAULT"


def test_disable_voltage_does_not_wait_for_a_slow_transition():
    bench = Bench(servo()).enable(3)
    bench.write(0x60FF, 1000)
    bench.on(1)
    bench.drive.power.transition_delay_ns.break_with(S)
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
