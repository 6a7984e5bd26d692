from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import MS, Bench, S, T, entry, generic, ready_tmcm, servo, servo_od, tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.cia402.state import State, decode_statusword
from canopen_control.data_files import data_path
from canopen_control.virtual.axis_motion import wrap32
from canopen_control.virtual.device import make_device
from canopen_control.virtual.node_outbox import DriveStateChanged
from canopen_control.virtual.plant import LagPlant, LoadedPlant
from canopen_control.virtual.virtual_drive import SOURCES, OverloadGuard, clamp

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


MS_OF_OVERLOAD = 1_000_000


def tripped(torque, seconds, guard=None, every=10):
    """Return after how many seconds of a torque it is too hot, None: not at all."""
    guard = guard or OverloadGuard()
    for now in range(0, round(seconds * 1000) + 1, every):
        if guard.exceeded(torque, 1000 * MS_OF_OVERLOAD + now * MS_OF_OVERLOAD):
            return now / 1000
    return None


@pytest.mark.parametrize(("torque", "after"), [(2000.0, 2.0), (-3000.0, 0.75), (1500.0, 4.8)])
def test_more_than_the_rated_torque_is_taken_for_a_time(torque, after):
    assert tripped(torque, 10.0) == pytest.approx(after, abs=0.03)


@given(st.floats(-1000.0, 1000.0))
def test_the_rated_torque_is_taken_for_ever(torque):
    assert tripped(torque, 100.0, every=50) is None


def test_it_cools_down():
    guard = OverloadGuard()
    assert tripped(2000.0, 1.8, guard) is None
    hot = guard.heat
    for now in range(0, 3000, 10):
        guard.exceeded(0.0, 10_000 * MS_OF_OVERLOAD + now * MS_OF_OVERLOAD)
    assert guard.heat < hot - 2.5


def test_a_pause_without_power_counts_as_rest_whatever_the_torque_was_before():
    guard = OverloadGuard()
    tripped(2000.0, 1.8, guard)
    assert not guard.exceeded(2000.0, 60_000 * MS_OF_OVERLOAD)
    assert guard.heat == 0.0


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


GENERIC_EDS = data_path("eds", "generic_cia402.eds")


def states(bench):
    return [event.state.name for event in bench.events if isinstance(event, DriveStateChanged)]


def test_it_starts_in_switch_on_disabled_with_voltage_and_remote():
    bench = Bench(servo())
    assert bench.state == "SWITCH_ON_DISABLED"
    assert bench.number(0x6041) & 0x0210 == 0x0210
    assert decode_statusword(bench.number(0x6041)) is State.SWITCH_ON_DISABLED


UP = {"SWITCH_ON_DISABLED": [], "READY_TO_SWITCH_ON": [6], "SWITCHED_ON": [6, 7], "OPERATION_ENABLED": [6, 7, 15]}


@pytest.mark.parametrize(
    ("start", "word", "end"),
    [
        ("SWITCH_ON_DISABLED", 0x06, "READY_TO_SWITCH_ON"),  # 2
        ("READY_TO_SWITCH_ON", 0x07, "SWITCHED_ON"),  # 3
        ("SWITCHED_ON", 0x0F, "OPERATION_ENABLED"),  # 4
        ("OPERATION_ENABLED", 0x07, "SWITCHED_ON"),  # 5
        ("SWITCHED_ON", 0x06, "READY_TO_SWITCH_ON"),  # 6
        ("READY_TO_SWITCH_ON", 0x00, "SWITCH_ON_DISABLED"),  # 7
        ("READY_TO_SWITCH_ON", 0x02, "SWITCH_ON_DISABLED"),  # 7
        ("OPERATION_ENABLED", 0x06, "READY_TO_SWITCH_ON"),  # 8
        ("OPERATION_ENABLED", 0x00, "SWITCH_ON_DISABLED"),  # 9
        ("SWITCHED_ON", 0x00, "SWITCH_ON_DISABLED"),  # 10
        ("SWITCHED_ON", 0x02, "SWITCH_ON_DISABLED"),  # 10
        ("OPERATION_ENABLED", 0x02, "SWITCH_ON_DISABLED"),  # 11, and 12 by itself
        ("READY_TO_SWITCH_ON", 0x0F, "OPERATION_ENABLED"),  # 3 and 4 in one write
        ("SWITCH_ON_DISABLED", 0x0F, "SWITCH_ON_DISABLED"),  # needs 0x06 first
        ("SWITCH_ON_DISABLED", 0x07, "SWITCH_ON_DISABLED"),
        ("SWITCHED_ON", 0x80, "SWITCHED_ON"),  # a fault reset without a fault
    ],
)
def test_the_controlword_moves_the_states_as_the_table_reports(start, word, end):
    bench = Bench(servo())
    bench.start()
    for step in UP[start]:
        bench.control(step)
    assert bench.state == start
    bench.control(word)
    bench.on(0.1)
    assert bench.state == end


def test_a_held_enable_does_not_lead_out_of_switch_on_disabled():
    bench = Bench(servo())
    bench.start()
    bench.control(0x0F)
    bench.on(1)
    bench.control(0x0F)
    assert bench.state == "SWITCH_ON_DISABLED"


def test_operation_is_enabled_only_while_the_node_is_operational():
    bench = Bench(servo())
    for word in (6, 7, 15):
        bench.control(word)
    assert bench.state == "SWITCHED_ON"
    bench.start()
    assert bench.state == "SWITCHED_ON"  # going OPERATIONAL enables nothing by itself
    bench.control(15)
    assert bench.state == "OPERATION_ENABLED"


def spinning(**changed):
    bench = Bench(servo(**changed)).enable(3)
    bench.write(0x60FF, 1000)
    bench.on(1)
    assert bench.velocity == 1000
    return bench


def seconds_to_stop(bench):
    start = bench.now
    while abs(bench.velocity) > 0:
        bench.on(0.001)
    return (bench.now - start) / S


@pytest.mark.parametrize(
    ("code", "seconds", "end"),
    [
        (0, 0.0, "SWITCH_ON_DISABLED"),
        (1, 0.2, "SWITCH_ON_DISABLED"),
        (2, 0.05, "SWITCH_ON_DISABLED"),
        (3, 0.0, "SWITCH_ON_DISABLED"),
        (5, 0.2, "QUICK_STOP_ACTIVE"),
        (6, 0.05, "QUICK_STOP_ACTIVE"),
        (7, 0.0, "QUICK_STOP_ACTIVE"),
    ],
)
def test_a_quick_stop_takes_the_ramp_and_the_state_of_its_option_code(code, seconds, end):
    bench = spinning(x605A=code)
    bench.control(0x02)
    if seconds:
        assert bench.state == "QUICK_STOP_ACTIVE"
    assert seconds_to_stop(bench) == pytest.approx(seconds, abs=0.0021)
    assert bench.state == end


def test_a_quick_stop_that_stays_can_be_enabled_again_and_one_that_leaves_cannot():
    bench = spinning(x605A=6)
    bench.control(0x02)
    bench.on(1)
    bench.control(0x0F)
    assert bench.state == "OPERATION_ENABLED"
    bench.on(1)
    assert bench.velocity == 1000
    bench.write(0x605A, 2)
    bench.control(0x02)
    bench.on(0.01)
    bench.control(0x0F)
    assert bench.state == "QUICK_STOP_ACTIVE"


@pytest.mark.parametrize(
    ("changed", "word", "seconds", "end"),
    [
        ({"x605B": 0}, 0x06, 0.0, "READY_TO_SWITCH_ON"),
        ({"x605B": 1}, 0x06, 0.2, "READY_TO_SWITCH_ON"),
        ({"x605C": 0}, 0x07, 0.0, "SWITCHED_ON"),
        ({"x605C": 1}, 0x07, 0.2, "SWITCHED_ON"),
        ({}, 0x00, 0.0, "SWITCH_ON_DISABLED"),
    ],
)
def test_leaving_operation_follows_its_option_code(changed, word, seconds, end):
    bench = spinning(**changed)
    bench.control(word)
    assert bench.state == ("OPERATION_ENABLED" if seconds else end)
    assert seconds_to_stop(bench) == pytest.approx(seconds, abs=0.0021)
    bench.on(0.002)
    assert bench.state == end


def test_enabling_again_on_the_ramp_down_continues():
    bench = spinning()
    bench.control(0x07)
    bench.on(0.1)
    assert bench.velocity == 500
    bench.control(0x0F)
    bench.on(1)
    assert (bench.state, bench.velocity) == ("OPERATION_ENABLED", 1000)


@pytest.mark.parametrize(("code", "seconds"), [(1, 0.2), (2, 0.05), (3, 0.0)])
def test_halt_stops_within_operation_and_ends_with_its_bit(code, seconds):
    bench = spinning(x605D=code)
    bench.control(0x010F)
    assert seconds_to_stop(bench) == pytest.approx(seconds, abs=0.0021)
    assert bench.state == "OPERATION_ENABLED"
    assert bench.statusword & 0x0400
    bench.control(0x0F)
    bench.on(1)
    assert bench.velocity == 1000


def test_an_enable_with_halt_does_not_move():
    bench = Bench(servo())
    bench.start()
    bench.write(0x6060, 3)
    bench.write(0x60FF, 1000)
    for word in (6, 7, 0x010F):
        bench.control(word)
    bench.on(1)
    assert (bench.state, bench.velocity, bench.position) == ("OPERATION_ENABLED", 0, 0)
    bench.control(0x0F)
    bench.on(1)
    assert bench.velocity == 1000


@pytest.mark.parametrize(("code", "seconds"), [(0, 0.0), (1, 0.2), (2, 0.05), (3, 0.0)])
def test_a_fault_stops_according_to_its_option_code_and_then_shows_fault(code, seconds):
    bench = spinning(x605E=code)
    bench.drive.fault(0x4310, bench.now, register=8)
    bench.collect()
    assert bench.state == ("FAULT_REACTION_ACTIVE" if seconds else "FAULT")
    assert seconds_to_stop(bench) == pytest.approx(seconds, abs=0.0021)
    bench.on(0.002)
    assert bench.state == "FAULT"
    assert bench.number(0x603F) == 0x4310
    assert bench.number(0x1001) == 0x09
    emcy = [frame for _, frame in bench.seen if frame.can_id == 0x085]
    assert [frame.data[:3].hex() for frame in emcy] == ["104309"]


def test_a_fault_is_reset_by_the_edge_and_only_when_its_cause_is_gone():
    bench = Bench(servo()).enable(3)
    bench.drive.power.causes.add(0x4310)
    bench.drive.fault(0x4310, bench.now, register=8)
    bench.control(0x80)
    assert bench.state == "FAULT"
    bench.drive.power.causes.clear()
    bench.control(0x80)  # the level is not an edge
    assert bench.state == "FAULT"
    bench.control(0x00)
    bench.control(0x8F)  # the edge, with an enable behind it that does not count
    assert bench.state == "SWITCH_ON_DISABLED"
    bench.on(1)
    assert bench.state == "SWITCH_ON_DISABLED"
    assert bench.number(0x603F) == 0
    assert bench.number(0x1001) == 0
    assert bench.seen[-4:]
    assert any(frame.can_id == 0x085 and frame.data == bytes(8) for _, frame in bench.seen)


def test_losing_the_supply_falls_to_switch_on_disabled_without_a_fault():
    bench = spinning()
    bench.drive.power.lose_voltage(bench.now)
    bench.on(0)
    assert bench.state == "SWITCH_ON_DISABLED"
    assert not bench.statusword & 0x10
    for word in (6, 7, 15):
        bench.control(word)
    assert bench.state == "SWITCHED_ON"  # no power, no operation
    bench.drive.power.voltage.clear()
    bench.control(15)
    assert bench.state == "OPERATION_ENABLED"


@pytest.mark.parametrize(
    ("option", "end", "moves"),
    [
        (0, "OPERATION_ENABLED", True),
        (1, "FAULT", False),
        (2, "SWITCH_ON_DISABLED", False),
        (3, "SWITCH_ON_DISABLED", False),
    ],
)
def test_a_lost_connection_does_what_0x6007_specifies(option, end, moves):
    bench = spinning(x6007=option)
    bench.drive.connection_lost(bench.now)
    bench.on(0.5)
    assert bench.state == end
    assert (bench.drive.mover.plant.velocity != 0) == moves


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.RESET_COMMUNICATION])
def test_nmt_stopped_and_a_reset_of_communication_in_operation_are_a_fault(command):
    bench = spinning()
    bench.nmt(command)
    assert bench.state == "FAULT_REACTION_ACTIVE"
    bench.on(0.06)
    assert bench.state == "FAULT"


def test_in_pre_operational_the_motor_keeps_turning_but_takes_no_set_points():
    bench = spinning()
    bench.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    bench.write(0x60FF, -1000)
    bench.on(1)
    assert bench.velocity == 1000
    bench.control(0x0B)  # a quick stop does count
    bench.on(1)
    assert (bench.velocity, bench.state) == (0, "SWITCH_ON_DISABLED")


def test_a_reset_of_the_node_takes_the_power_away_and_counts_from_zero():
    bench = spinning()
    assert bench.position > 900
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.1)
    assert (bench.state, bench.position, bench.velocity) == ("SWITCH_ON_DISABLED", 0, 0)
    assert bench.number(0x60FF) == 0


def test_the_mode_display_follows_at_once_and_unlisted_modes_are_refused():
    bench = Bench(servo(x6502=0xA5))
    for mode in (1, 3, 6, 8, 0):
        bench.write(0x6060, mode)
        assert bench.number(0x6061, signed=True) == mode
    for mode in (2, 4, 7, 9, 10, 5, -1):
        assert bench.abort_of(0x6060, mode) == 0x06090030
        assert bench.number(0x6061, signed=True) == 0


def test_without_0x6502_every_mode_is_taken():
    bench = Bench(servo(without=(0x6502,)))
    assert all(bench.abort_of(0x6060, mode) is None for mode in (1, 2, 3, 4, 6, 7, 8, 9, 10))


@pytest.mark.parametrize("mode", [1, 2, 3, 4, 6, 7, 8, 9, 10])
def test_operation_is_reached_in_every_mode_and_nothing_moves_by_itself(mode):
    bench = Bench(servo()).enable(mode)
    bench.on(1)
    assert bench.state == "OPERATION_ENABLED"
    assert (bench.position, bench.velocity) == (0, 0)


def test_a_change_of_mode_in_operation_takes_the_motor_along_its_ramp():
    bench = spinning()
    bench.write(0x6060, 1)
    bench.on(0.1)
    assert bench.velocity == 500
    bench.on(0.2)
    assert (bench.velocity, bench.number(0x6061)) == (0, 1)


def test_reserved_option_codes_are_refused():
    bench = Bench(servo())
    assert bench.abort_of(0x605A, 9) == 0x06090030
    assert bench.abort_of(0x605A, -1) is None  # the manufacturer's


def test_axes_of_one_device_are_independent():
    bench = Bench(servo(axes=2))
    bench.enable(3, axis=1)
    bench.write(0x68FF, 1000)
    bench.on(1)
    assert [drive.state.name for drive in bench.node.drives.values()] == ["SWITCH_ON_DISABLED", "OPERATION_ENABLED"]
    assert bench.number(0x686C, signed=True) == 1000
    assert bench.number(0x606C, signed=True) == 0


def test_an_idle_drive_has_no_deadline_and_an_enabled_one_that_stands_neither():
    bench = Bench(tmcm())
    assert bench.node.next_deadline() is None
    bench.enable(3)
    assert bench.node.next_deadline() is None


def test_the_result_does_not_depend_on_how_often_it_is_looked_at():
    seldom, often = ready_tmcm(), ready_tmcm()
    for bench in (seldom, often):
        bench.write(0x60FF, 2546)
    seldom.node.tick(seldom.now + S)
    for step in range(1, 1000):
        often.node.tick(often.now + step * MS)
    often.node.tick(often.now + S)
    assert often.drive.mover.plant.position == pytest.approx(seldom.drive.mover.plant.position, abs=1e-6)


def test_state_changes_are_reported():
    bench = Bench(servo()).enable(3)
    assert states(bench) == ["SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON", "SWITCHED_ON", "OPERATION_ENABLED"]


def tuned(plant=None, **gains):
    """A servo of the bundled EDS, enabled in PV, with gains."""
    bench = Bench(make_device(GENERIC_EDS, 5, plant=lambda _axis: plant or LoadedPlant(friction=0.0)))
    for index in (0x6083, 0x6084, 0x6085):
        bench.write(index, 100_000)
    for (index, sub), value in {(0x60F9, 1): gains.get("p", 0), (0x60F9, 2): gains.get("i", 0)}.items():
        bench.write(index, value, sub)
    return bench.enable(3)


def test_gains_of_its_objects_make_its_loops_harder_or_softer():
    overshoots = []
    for p, i in ((0, 0), (5_000, 300_000)):
        bench = tuned(p=p, i=i)
        bench.write(0x60FF, 20_000)
        overshoots.append(max(bench.on(0.005).velocity for _ in range(200)) / 20_000)
    assert overshoots[0] == pytest.approx(1.0, abs=0.01)
    assert overshoots[1] > 1.05


def test_gains_may_change_while_it_moves_and_go_with_a_reset():
    bench = tuned(p=50_000, i=500_000)
    bench.write(0x60FF, 20_000)
    bench.on(1.0)
    bench.write(0x60F9, 0, 1)
    before = bench.velocity
    assert bench.on(0.05).velocity == pytest.approx(before, rel=0.02)
    bench.write(0x60F9, 50_000, 1)
    assert bench.on(0.5).velocity == pytest.approx(20_000, rel=0.02)
    bench.nmt(NmtCommand.RESET_NODE)
    bench.on(0.1)
    assert bench.number(0x60F9, 1) == 0


def test_a_velocity_mode_continues_from_where_the_shaft_is():
    """What the velocity loop did not make up for is not a jump for the position mode that comes after it."""
    plant = LoadedPlant(friction=0.0)
    bench = tuned(plant, p=50_000, i=500_000)
    plant.stalled = True
    bench.write(0x60FF, 2_000)
    bench.on(0.5)
    bench.write(0x60FF, 0)
    plant.stalled = False
    bench.on(1.0)
    place = bench.position
    assert abs(place) < 400
    bench.write(0x6060, 8)
    bench.write(0x607A, place)
    assert bench.on(0.5).position == pytest.approx(place, abs=20)


def test_a_soft_position_loop_is_a_following_error():
    bench = tuned(p=50_000, i=0)
    bench.write(0x6065, 100)
    bench.write(0x60FB, 1_000, 1)
    bench.write(0x60FB, 0, 2)
    bench.write(0x6060, 1)
    bench.write(0x6081, 20_000)
    bench.write(0x607A, 50_000)
    bench.control(0x1F)
    bench.on(0.5)
    assert bench.state == "FAULT"
    assert bench.number(0x603F) == 0x8611
