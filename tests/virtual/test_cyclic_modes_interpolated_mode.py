"""Mode 7 with its buffer 0x60C4; without one it is tested with CSP in `test_cyclic_modes`."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.setpoints import STEP, StreamBench
from support.virtualbench import BIT_12, REACHED, T, entry, servo_od

from canopen_control.cia301.abort import AbortCode
from canopen_control.virtual.device_model import ELMO, GENERIC, DeviceModel, MissingSetPoint

BUFFER = ((1, T.UNSIGNED32, 8, "ro"), (2, T.UNSIGNED32, 8, "rw"), (3, T.UNSIGNED8, 0, "rw"),
          (4, T.UNSIGNED16, 0, "rw"), (5, T.UNSIGNED8, 4, "wo"), (6, T.UNSIGNED8, 0, "wo"))  # fmt: skip


def buffered_od(records=1, **changed):
    od = servo_od(5, **changed)
    for subindex, data_type, default, access in BUFFER:
        od.add(entry(0x60C4, subindex, data_type, default, access))
    od.add(entry(0x60C0, 0, T.INTEGER16, 0))
    for subindex in range(2, records + 1):
        od.add(entry(0x60C1, subindex, T.INTEGER32, 0, "rw", True))
    return od


def buffered(records=1, model=GENERIC, **changed):
    """A drive in mode 7 whose buffer of 8 records is open and interpolation enabled."""
    bench = StreamBench(mode=7, mapped=(0x60C10120, 0x60FF0020), od=buffered_od(records, **changed), model=model)
    bench.write(0x60C4, 1, 6)
    bench.control(0x1F)
    return bench


def place(bench):
    bench.drive.advance(bench.now)
    return bench.drive.mover.plant.position


def test_without_opening_it_a_record_counts_at_once():
    bench = StreamBench(mode=7, mapped=(0x60C10120, 0x60FF0020), od=buffered_od())
    bench.control(0x1F)
    for cycle in range(1, 20):
        bench.cycle(STEP * cycle)
    assert place(bench) == 19 * STEP
    assert bench.number(0x60C4, 4) == 0


def test_records_that_come_in_bunches_move_the_axis_evenly():
    bench = buffered()
    for first in range(1, 400, 4):
        if first == 41:
            bench.restart()
        for cycle in range(first, first + 4):
            bench.send(STEP * cycle)
            bench.sync()
        bench.on(0.04)
    assert bench.ripple == pytest.approx((0.0, 1.0, 1.0), abs=1e-6)
    assert (bench.quality.missed, bench.quality.doubled, bench.quality.taken) == (0, 0, 360)
    assert place(bench) == 400 * STEP


def test_it_starts_when_interpolation_is_enabled_and_keeps_what_waits_until_the_power_goes():
    bench = buffered()
    bench.control(0x0F)
    for cycle in range(1, 5):
        bench.write(0x60C1, STEP * cycle, 1)
    bench.on(0.1)
    assert (place(bench), bench.number(0x60C4, 4)) == (0, 4)
    assert not bench.statusword & BIT_12
    bench.control(0x1F)
    bench.on(0.015)
    assert (place(bench), bench.number(0x60C4, 4)) == (1.5 * STEP, 2)
    assert bench.statusword & (BIT_12 | REACHED) == BIT_12
    bench.control(0x0F)
    bench.on(0.1)
    assert bench.number(0x60C4, 4) == 2
    bench.control(0x06)
    assert bench.number(0x60C4, 4) == 0


def test_enabled_again_it_goes_on_at_once():
    bench = buffered(x6084=0)
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.013)
    bench.control(0x0F)
    bench.control(0x1F)
    assert bench.number(0x60C4, 4) == 1
    bench.on(0.01)
    assert place(bench) == 3 * STEP


def test_a_record_too_many_is_refused_and_those_that_wait_stay():
    bench = buffered()
    bench.control(0x0F)
    bench.write(0x60C4, 3, 2)
    codes = [bench.abort_of(0x60C1, STEP * cycle, 1) for cycle in range(1, 6)]
    assert codes == [None, None, None, AbortCode.OUT_OF_MEMORY, AbortCode.OUT_OF_MEMORY]
    refused = bench.node.pdos.refused
    bench.send(STEP * 9)
    bench.sync()
    assert bench.node.pdos.refused == refused + 1
    bench.control(0x1F)
    bench.on(0.1)
    assert place(bench) == 3 * STEP


def test_closing_clears_it():
    bench = buffered()
    bench.control(0x0F)
    bench.write(0x60C1, STEP, 1)
    bench.write(0x60C4, 0, 6)
    assert bench.number(0x60C4, 4) == 0


def test_what_it_does_not_have_is_refused():
    bench = buffered()
    assert bench.abort_of(0x60C4, 9, 2) == AbortCode.VALUE_TOO_HIGH
    assert bench.abort_of(0x60C4, 1, 3) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C4, 2, 6) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C0, -1) == AbortCode.INVALID_VALUE
    assert bench.abort_of(0x60C0, 0) is None


def test_a_record_of_two_counts_when_its_last_subindex_is_written():
    bench = buffered(records=2)
    bench.control(0x0F)
    bench.write(0x60C1, STEP, 1)
    assert bench.number(0x60C4, 4) == 0
    bench.write(0x60C1, 77, 2)
    assert bench.number(0x60C4, 4) == 1


@pytest.mark.parametrize("cycles", [0, 2])
def test_a_buffer_that_runs_dry_does_what_the_model_says_and_goes_on_with_the_next_record(cycles):
    bench = buffered(model=DeviceModel(missing=MissingSetPoint(cycles=cycles)))
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.2)
    assert place(bench) == (4 + cycles) * STEP
    bench.send(STEP * 10)
    bench.sync()
    bench.on(0.01)
    assert (place(bench), bench.quality.missed) == (10 * STEP, 16)


def test_elmo_faults_on_a_buffer_that_stays_dry():
    bench = buffered(model=ELMO)
    for cycle in range(1, 5):
        bench.send(STEP * cycle)
        bench.sync()
    bench.on(0.2)
    assert (bench.state, bench.number(0x603F)) == ("FAULT", 0xFF02)


@settings(max_examples=examples(30))
@given(steps=st.lists(st.sampled_from(("put", "wait", "off", "on", "clear")), max_size=60))
def test_whatever_is_done_it_moves_to_records_in_their_order_and_holds_no_more_than_it_may(steps):
    bench, sent = buffered(x6084=0), 0  # a stop without a ramp
    before = 0.0
    for step in steps:
        if step == "put":
            sent += 1
            bench.send(STEP * sent)
            bench.sync()
        elif step == "wait":
            bench.on(0.013)
        elif step == "clear":
            bench.write(0x60C4, 0, 6)
            bench.write(0x60C4, 1, 6)
        else:
            bench.control(0x1F if step == "on" else 0x0F)
        assert 0 <= bench.number(0x60C4, 4) <= 8
        assert before <= place(bench) <= STEP * sent
        before = place(bench)
    assert bench.state == "OPERATION_ENABLED"
