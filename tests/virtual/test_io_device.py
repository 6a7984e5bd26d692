"""A virtual I/O module on a bench: masks, gate, triggers, polarity and error values, by raw frames."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.devices import put
from support.devices import virtual as bench
from support.robots import dictionary_of
from support.virtualbench import MS, Bench

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.virtual.device import make_device
from canopen_control.virtual.io_device import JUMP, KINDS, NOISE, InputFaults


def collected(device, name):
    return next(item for item in device.node.function.describe() if item.name == name)


def test_a_temperature_is_shown_in_its_digits_in_every_format():
    device = bench(404)
    device.start()
    frames = put(device, ai0=21.54, ai1=-1.5)
    assert (device.number(0x7130, 1), device.number(0x9130, 1)) == (215, 215)
    assert device.number(0x7130, 2, signed=True) == -1500
    assert frames[-1].data == bytes.fromhex("d70000") + bytes.fromhex("24fa00")
    device.write(0x6132, 2, 1)
    assert device.number(0x7130, 1) == 2154


def test_what_its_object_cannot_hold_is_an_overload_and_a_broken_wire_is_invalid():
    device = bench(404)
    put(device, ai0=5000.0)
    assert (device.number(0x7130, 1), device.number(0x6150, 1)) == (32767, 2)
    put(device, ai0=-5000.0)
    assert device.number(0x6150, 1) == 4
    put(device, ai0=0.0, status0=1)
    assert device.number(0x6150, 1) == 1
    put(device, status0=0)
    assert device.number(0x6150, 1) == 0


def test_its_output_falls_to_the_fault_value():
    device = bench(404)
    device.write(0x7341, -100, 1)
    device.start()
    device.put(0x205, b"\xe8\x03")
    assert collected(device, "ao0").value == pytest.approx(10.0)
    device.nmt(2)
    assert collected(device, "ao0").value == pytest.approx(-1.0)


def test_a_battery_begins_charged_and_is_reported_by_a_timer():
    device = bench(418)
    assert device.number(0x6010, signed=True) == 200  # 25 degrees
    assert device.number(0x6060) == round(25.6 * 1024)
    assert (device.number(0x6081), device.number(0x6000)) == (80, 1)
    device.start()
    device.on(3.05)
    assert sum(frame.can_id == 0x285 for _, frame in device.seen) == 4


@pytest.mark.rest
def test_a_current_reduces_charge_and_voltage():
    device = bench(418)
    put(device, battery_current=-72.0)
    assert device.number(0x6060) == round((25.6 - 3.6) * 1024)
    device.on(1000.0)  # 20 Ah of 100
    assert device.number(0x6081) == 60
    device.on(5000.0)
    assert device.number(0x6081) == 0
    put(device, battery_current=0.0)
    assert device.node.function.next_deadline() is None


def test_what_is_not_an_input_is_refused():
    device = bench(404)
    with pytest.raises(ConfigError, match="ao0 is an output"):
        put(device, ao0=1.0)
    with pytest.raises(ConfigError, match="no signal 'ai9'"):
        put(device, ai9=1.0)


@pytest.mark.parametrize("kind", ["jump", "noise", "stuck"])
def test_faults_act_on_what_is_measured(kind):
    device = bench(404)
    put(device, ai0=10.0)
    device.node.function.break_inputs(kind, on=True, now=device.now)
    put(device, ai0=20.0)
    shown = {device.on(0.02).number(0x7130, 1) for _ in range(5)}
    assert {"jump": shown == {8392}, "noise": len(shown) > 2, "stuck": shown == {100}}[kind]
    device.node.function.break_inputs(kind, on=False, now=device.now)
    assert device.number(0x7130, 1) == 200


def test_a_charger_reports_its_state_and_clears_a_request_when_its_master_is_lost():
    device = bench(419)
    device.start()
    put(device, charger_status=3, charger_percentage=55)
    assert (device.number(0x6001), device.number(0x6080)) == (3, 55)
    device.put(0x205, bytes.fromhex("2800015000600000"))  # 2.5 A, ready, 80 %, 24 V
    assert collected(device, "charge_current_requested").value == 2.5
    assert collected(device, "battery_voltage").value == 24.0
    with pytest.raises(ConfigError, match="charge_current_requested is an output"):
        put(device, charge_current_requested=1.0)
    device.nmt(2)
    assert collected(device, "charge_current_requested").value == 0.0
    assert collected(device, "battery_percentage").value == 80.0


TPDO = 0x185


def sent_of_position_devices(device):
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
    before = len(sent_of_position_devices(device))
    put(device, position=1.0)
    assert len(sent_of_position_devices(device)) == before
    device.on(0.225)
    assert len(sent_of_position_devices(device)) == before + 4
    device.write(0x6200, 0)
    before = len(sent_of_position_devices(device))
    put(device, position=2.0)
    assert len(sent_of_position_devices(device)) == before + 1


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


def test_a_healthy_input_shows_what_is_there_and_never_wakes():
    faults = InputFaults()
    assert faults.value("a", 5.0, 100.0) == faults.line("a", 5.0) == 5.0
    assert (faults.next_deadline(), faults.due(10**12)) == (None, False)


def test_a_stuck_input_keeps_what_it_showed_first_until_it_is_repaired():
    faults = InputFaults()
    faults.switch("stuck", on=True, now=0)
    assert [faults.value("a", item, 100.0) for item in (1.0, 2.0)] == [1.0, 1.0]
    assert [faults.line("b", item) for item in (0.0, 1.0)] == [0.0, 0.0]
    faults.switch("stuck", on=False, now=0)
    assert faults.value("a", 2.0, 100.0) == 2.0


def test_noise_stays_within_its_share_changes_and_is_the_same_each_time():
    courses = []
    for _ in range(2):
        faults = InputFaults()
        faults.switch("noise", on=True, now=0)
        course = []
        for _step in range(50):
            now = faults.next_deadline()
            assert faults.due(now)
            assert not faults.due(now)
            course.append(faults.value("a", 0.0, 1000.0))
        courses.append(course)
    assert courses[0] == courses[1]
    assert max(map(abs, courses[0])) <= NOISE * 1000.0
    assert len(set(courses[0])) > 20


def test_a_jump_adds_a_quarter_and_lines_do_not_jump():
    faults = InputFaults()
    faults.switch("jump", on=True, now=0)
    assert faults.value("a", 1.0, 100.0) == 1.0 + JUMP * 100.0
    assert faults.line("a", 1.0) == 1.0


def test_a_fault_that_there_is_not_is_refused_with_those_there_are():
    with pytest.raises(ConfigError, match=", ".join(KINDS)):
        InputFaults().switch("wet", on=True, now=0)


EDS = data_path("eds", "generic_cia401.eds")
NODE = 5
DI, AI, DO, AO = 0x180 + NODE, 0x280 + NODE, 0x200 + NODE, 0x300 + NODE


@pytest.fixture
def io():
    return Bench(make_device(dictionary_of(EDS), NODE)).on(0.1)


def sent(bench, can_id):
    return [frame.data for _, frame in bench.seen if frame.can_id == can_id]


def put_of_whole(bench, **values):
    """Set inputs and return what is sent for it, by identifier."""
    before = len(bench.seen)
    bench.node.function.set_signals(values, bench.now)
    bench.node.send_changes(bench.now)
    bench.collect()
    return {frame.can_id: frame.data for _, frame in bench.seen[before:]}


def terminal(bench, name):
    return next(item.value for item in bench.node.function.describe() if item.name == name)


def test_digital_inputs_are_sent_on_start_and_when_they_change(io):
    put_of_whole(io, di1=1)
    io.start()
    assert sent(io, DI) == [b"\x02\x00"]
    assert put_of_whole(io, di9=1) == {DI: b"\x02\x02"}
    assert put_of_whole(io, di9=1) == {}
    assert io.number(0x6000, 2) == 2


def test_the_masks_report_which_edges_are_sent(io):
    io.start()
    io.write(0x6006, 0, 1)
    assert put_of_whole(io, di0=1) == {}
    io.write(0x6007, 1, 1)  # rising
    assert put_of_whole(io, di0=0) == {}
    assert put_of_whole(io, di0=1) == {DI: b"\x01\x00"}
    io.write(0x6008, 2, 1)  # falling, of another line
    assert put_of_whole(io, di1=1) == {}
    assert put_of_whole(io, di1=0) == {DI: b"\x01\x00"}
    io.write(0x6005, 0)
    assert put_of_whole(io, di0=0) == {}


def test_polarity_turns_lines_at_once(io):
    io.write(0x6002, 0x01, 1)
    assert io.number(0x6000, 1) == 1
    put_of_whole(io, di0=1)
    assert io.number(0x6000, 1) == 0
    io.start()
    io.write(0x6202, 0x80, 1)
    io.put(DO, b"\x80\x00")
    assert terminal(io, "do7") == 0.0


def test_analogue_inputs_are_silent_until_6423_is_set(io):
    io.start()
    assert sent(io, AI) == []
    assert put_of_whole(io, ai0=5000) == {}
    assert io.number(0x6401, 1) == 5000
    io.write(0x6423, 1)
    assert put_of_whole(io, ai0=5001) == {AI: bytes.fromhex("8913000000000000")}


def test_an_event_timer_sends_them_all_the_same(io):
    io.write(0x1801, 100, 5)
    io.start()
    io.on(0.35)
    assert len(sent(io, AI)) == 3


def test_the_least_change_counts_from_the_last_event(io):
    io.write(0x6423, 1)
    io.write(0x6426, 100, 1)
    io.start()
    assert put_of_whole(io, ai0=99) == {}
    assert AI in put_of_whole(io, ai0=100)
    assert put_of_whole(io, ai0=199) == {}
    assert AI in put_of_whole(io, ai0=200)
    assert AI in put_of_whole(io, ai0=100)


def test_limits_and_directions_are_triggers_of_their_own(io):
    io.write(0x6423, 1)
    io.start()
    io.write(0x6421, 0x01, 1)
    io.write(0x6424, 1000, 1)
    assert put_of_whole(io, ai0=999) == {}
    assert AI in put_of_whole(io, ai0=1000)
    assert put_of_whole(io, ai0=2000) == {}
    io.write(0x6421, 0x02, 1)
    io.write(0x6425, 500, 1)
    assert AI in put_of_whole(io, ai0=499)
    io.write(0x6421, 0x08, 1)
    io.write(0x6427, 50, 1)
    assert put_of_whole(io, ai0=600) == {}
    assert AI in put_of_whole(io, ai0=400)
    io.write(0x6421, 0x10, 1)
    io.write(0x6428, 50, 1)
    assert AI in put_of_whole(io, ai0=460)
    assert put_of_whole(io, ai0=300) == {}


def test_the_source_of_an_event_is_reported_until_it_is_read(io):
    io.write(0x6423, 1)
    io.start()
    put_of_whole(io, ai0=100, ai2=100)
    assert io.number(0x6422, 1) == 0b101
    assert io.number(0x6422, 1) == 0


def test_outputs_fall_to_their_error_values_where_their_modes_report_this(io):
    io.write(0x1016, 0x0001_0064, 1)
    io.write(0x6206, 0x0F, 1)
    io.write(0x6207, 0x01, 1)
    io.write(0x6443, 0, 2)
    io.write(0x6444, -5, 1)
    io.start()
    io.put(0x701, b"\x05")
    io.put(DO, b"\xfe\xff")
    io.put(AO, bytes.fromhex("6400c80000000000"))
    assert [terminal(io, name) for name in ("do0", "do1", "do7", "do8", "ao0", "ao1")] == [0, 1, 1, 1, 100, 200]
    io.on(0.2)
    assert [terminal(io, name) for name in ("do0", "do1", "do7", "do8", "ao0", "ao1")] == [1, 0, 1, 0, -5, 200]
    assert 0x8130 in io.node.emcy.active
    io.start()
    io.on(0.05)
    assert terminal(io, "do1") == 0.0  # until it is written
    io.put(DO, b"\x02\x00")
    assert terminal(io, "do1") == 1.0


@pytest.mark.parametrize("command", [NmtCommand.STOP, NmtCommand.RESET_COMMUNICATION, NmtCommand.RESET_NODE])
def test_a_stop_and_a_reset_switch_outputs_off_and_pre_operational_does_not(io, command):
    io.start()
    io.put(DO, b"\xff\x00")
    io.nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
    assert terminal(io, "do0") == 1.0
    io.nmt(command)
    io.on(0.1)
    assert terminal(io, "do0") == 0.0


def test_what_is_not_an_input_is_refused_and_nothing_is_set(io):
    with pytest.raises(ConfigError, match=r"no signal 'di77' \(did you mean"):
        put_of_whole(io, di0=1, di77=1)
    with pytest.raises(ConfigError, match="do0 is an output"):
        put_of_whole(io, di0=1, do0=1)
    assert io.number(0x6000, 1) == 0


def test_values_stay_within_what_the_object_holds(io):
    put_of_whole(io, ai0=1e9, ai1=-1e9)
    assert [io.number(0x6401, sub, signed=True) for sub in (1, 2)] == [32767, -32768]


def test_inputs_that_are_stuck_noisy_or_jump(io):
    function = io.node.function
    put_of_whole(io, ai0=1000, di0=1)
    function.break_inputs("stuck", on=True, now=io.now)
    put_of_whole(io, ai0=2000, di0=0)
    assert (io.number(0x6401, 1), io.number(0x6000, 1)) == (1000, 1)
    function.break_inputs("stuck", on=False, now=io.now)
    assert (io.number(0x6401, 1), io.number(0x6000, 1)) == (2000, 0)
    function.break_inputs("jump", on=True, now=io.now)
    assert io.number(0x6401, 1) == 2000 + round(32767 / 4)
    function.break_inputs("jump", on=False, now=io.now)
    function.break_inputs("noise", on=True, now=io.now)
    observed = {io.to(io.now + 20 * MS).number(0x6401, 1) for _ in range(10)}
    assert len(observed) > 3
