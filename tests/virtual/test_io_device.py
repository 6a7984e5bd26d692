"""A virtual I/O module on a bench: masks, gate, triggers, polarity and error values, by raw frames."""

import pytest
from support.robots import dictionary_of
from support.virtualbench import MS, Bench

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.data_files import data_path
from canopen_control.errors import ConfigError
from canopen_control.virtual.device import make_device

EDS = data_path("eds", "generic_cia401.eds")
NODE = 5
DI, AI, DO, AO = 0x180 + NODE, 0x280 + NODE, 0x200 + NODE, 0x300 + NODE


@pytest.fixture
def io():
    return Bench(make_device(dictionary_of(EDS), NODE)).on(0.1)


def sent(bench, can_id):
    return [frame.data for _, frame in bench.seen if frame.can_id == can_id]


def put(bench, **values):
    """Set inputs and return what is sent for it, by identifier."""
    before = len(bench.seen)
    bench.node.function.set_signals(values, bench.now)
    bench.node.follow(bench.now)
    bench.collect()
    return {frame.can_id: frame.data for _, frame in bench.seen[before:]}


def terminal(bench, name):
    return next(each.value for each in bench.node.function.describe() if each.name == name)


def test_digital_inputs_are_sent_on_start_and_when_they_change(io):
    put(io, di1=1)
    io.start()
    assert sent(io, DI) == [b"\x02\x00"]
    assert put(io, di9=1) == {DI: b"\x02\x02"}
    assert put(io, di9=1) == {}
    assert io.number(0x6000, 2) == 2


def test_the_masks_say_which_edges_are_sent(io):
    io.start()
    io.write(0x6006, 0, 1)
    assert put(io, di0=1) == {}
    io.write(0x6007, 1, 1)  # rising
    assert put(io, di0=0) == {}
    assert put(io, di0=1) == {DI: b"\x01\x00"}
    io.write(0x6008, 2, 1)  # falling, of another line
    assert put(io, di1=1) == {}
    assert put(io, di1=0) == {DI: b"\x01\x00"}
    io.write(0x6005, 0)
    assert put(io, di0=0) == {}


def test_polarity_turns_lines_at_once(io):
    io.write(0x6002, 0x01, 1)
    assert io.number(0x6000, 1) == 1
    put(io, di0=1)
    assert io.number(0x6000, 1) == 0
    io.start()
    io.write(0x6202, 0x80, 1)
    io.put(DO, b"\x80\x00")
    assert terminal(io, "do7") == 0.0


def test_analogue_inputs_are_silent_until_6423_is_set(io):
    io.start()
    assert sent(io, AI) == []
    assert put(io, ai0=5000) == {}
    assert io.number(0x6401, 1) == 5000
    io.write(0x6423, 1)
    assert put(io, ai0=5001) == {AI: bytes.fromhex("8913000000000000")}


def test_an_event_timer_sends_them_all_the_same(io):
    io.write(0x1801, 100, 5)
    io.start()
    io.on(0.35)
    assert len(sent(io, AI)) == 3


def test_the_least_change_counts_from_the_last_event(io):
    io.write(0x6423, 1)
    io.write(0x6426, 100, 1)
    io.start()
    assert put(io, ai0=99) == {}
    assert AI in put(io, ai0=100)
    assert put(io, ai0=199) == {}
    assert AI in put(io, ai0=200)
    assert AI in put(io, ai0=100)


def test_limits_and_directions_are_triggers_of_their_own(io):
    io.write(0x6423, 1)
    io.start()
    io.write(0x6421, 0x01, 1)
    io.write(0x6424, 1000, 1)
    assert put(io, ai0=999) == {}
    assert AI in put(io, ai0=1000)
    assert put(io, ai0=2000) == {}
    io.write(0x6421, 0x02, 1)
    io.write(0x6425, 500, 1)
    assert AI in put(io, ai0=499)
    io.write(0x6421, 0x08, 1)
    io.write(0x6427, 50, 1)
    assert put(io, ai0=600) == {}
    assert AI in put(io, ai0=400)
    io.write(0x6421, 0x10, 1)
    io.write(0x6428, 50, 1)
    assert AI in put(io, ai0=460)
    assert put(io, ai0=300) == {}


def test_the_source_of_an_event_is_told_until_it_is_read(io):
    io.write(0x6423, 1)
    io.start()
    put(io, ai0=100, ai2=100)
    assert io.number(0x6422, 1) == 0b101
    assert io.number(0x6422, 1) == 0


def test_outputs_fall_to_their_error_values_where_their_modes_say_so(io):
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
    assert terminal(io, "do1") == 0.0  # until somebody writes it
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


def test_what_is_no_input_is_refused_and_nothing_is_set(io):
    with pytest.raises(ConfigError, match="no signal 'di77', did you mean"):
        put(io, di0=1, di77=1)
    with pytest.raises(ConfigError, match="do0 is an output"):
        put(io, di0=1, do0=1)
    assert io.number(0x6000, 1) == 0


def test_values_stay_within_what_the_object_holds(io):
    put(io, ai0=1e9, ai1=-1e9)
    assert [io.number(0x6401, sub, signed=True) for sub in (1, 2)] == [32767, -32768]


def test_inputs_that_are_stuck_noisy_or_jump(io):
    function = io.node.function
    put(io, ai0=1000, di0=1)
    function.break_inputs("stuck", on=True, now=io.now)
    put(io, ai0=2000, di0=0)
    assert (io.number(0x6401, 1), io.number(0x6000, 1)) == (1000, 1)
    function.break_inputs("stuck", on=False, now=io.now)
    assert (io.number(0x6401, 1), io.number(0x6000, 1)) == (2000, 0)
    function.break_inputs("jump", on=True, now=io.now)
    assert io.number(0x6401, 1) == 2000 + round(32767 / 4)
    function.break_inputs("jump", on=False, now=io.now)
    function.break_inputs("noise", on=True, now=io.now)
    seen = {io.to(io.now + 20 * MS).number(0x6401, 1) for _ in range(10)}
    assert len(seen) > 3
