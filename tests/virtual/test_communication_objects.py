from __future__ import annotations

import dataclasses

import pytest
from support.virtualbench import TMCM, Bench, ready_tmcm, servo

from canopen_control.bus.port import BusEventKind as Kind
from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import make_device


def spinning(**changed):
    b = Bench(servo(**changed)).enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    b.seen.clear()
    return b


def tell(b, kind):
    b.node.bus_event(kind, b.now)
    b.collect()


def emcys(b):
    return [frame.data[:3].hex() for _, frame in b.seen if frame.can_id == 0x085]


@pytest.mark.parametrize("kind", [Kind.BUS_OFF, Kind.DOWN, Kind.CLOSED])
@pytest.mark.parametrize(("option", "end"), [(1, "FAULT"), (2, "SWITCH_ON_DISABLED"), (3, "SWITCH_ON_DISABLED")])
def test_off_the_bus_the_axes_stop_as_0x6007_specifies(kind, option, end):
    b = spinning(x6007=option)
    tell(b, kind)
    b.on(1)
    assert (b.state, b.drive.mover.plant.velocity) == (end, 0)


def test_with_0x6007_of_0_the_motor_continues():
    b = spinning(x6007=0)
    tell(b, Kind.BUS_OFF)
    b.on(1)
    assert (b.state, b.drive.mover.plant.velocity) == ("OPERATION_ENABLED", 1000)


def test_back_on_the_bus_it_reports_that_once():
    b = spinning()
    tell(b, Kind.BUS_OFF)
    tell(b, Kind.BUS_OFF)
    b.on(1)
    tell(b, Kind.ERROR_ACTIVE)
    assert [code for code in emcys(b) if code[:4] == "4081"] == ["408111"]
    b.seen.clear()
    tell(b, Kind.ERROR_ACTIVE)
    assert emcys(b) == []


def test_error_passive_is_an_error_while_it_lasts_and_an_overrun_is_reported():
    b = Bench(servo())
    tell(b, Kind.ERROR_PASSIVE)
    assert b.number(0x1001) == 0x11
    tell(b, Kind.ERROR_ACTIVE)
    assert b.number(0x1001) == 0
    tell(b, Kind.OVERRUN)
    assert [code[:4] for code in emcys(b)] == ["2081", "0000", "1081", "0000"]


def test_the_tmcm_1270_does_what_0x1029_specifies():
    b = ready_tmcm()
    b.write(0x1029, 2, 1)
    b.write(0x60FF, 1600)
    b.on(1)
    tell(b, Kind.BUS_OFF)
    b.on(1)
    assert b.node.nmt.state == 4
    assert (b.state, b.drive.mover.plant.velocity) == ("FAULT", 0)


@pytest.mark.parametrize(
    ("index", "sub", "value", "code"),
    [
        (0x1005, 0, 0x40000080, 0x06090030),  # it produces no SYNC
        (0x1014, 0, 0x00000601, 0x06090030),  # a reserved identifier
        (0x1019, 0, 1, 0x06090030),
        (0x1019, 0, 241, 0x06090030),
        (0x1029, 1, 3, 0x06090030),
        (0x1010, 1, 1, 0x08000020),
        (0x1011, 1, 0x65766173, 0x08000020),
    ],
)
def test_what_the_standard_forbids_is_refused(index, sub, value, code):
    bench = Bench(servo())
    before = bench.read(index, sub)
    assert bench.abort_of(index, value, sub) == code
    assert bench.read(index, sub) == before


def test_a_sync_on_another_identifier_with_a_counter():
    bench = Bench(servo())
    bench.write(0x1005, 0x0A0)
    bench.write(0x1019, 4)
    bench.start()
    bench.seen.clear()
    bench.put(0x080, b"\x01")
    assert bench.seen == []
    bench.put(0x0A0, b"\x01")
    assert len(bench.seen) == 2


def test_the_ability_to_store_is_shown():
    bench = Bench(servo())
    assert [bench.number(0x1010, sub) for sub in (1, 2, 3)] == [1, 1, 1]


def test_a_heartbeat_time_of_zero_ends_the_heartbeat_and_enables_guarding():
    bench = Bench(servo())
    bench.write(0x1017, 100)
    bench.on(0.25)
    assert bench.put(0x705 | 0x40000000, b"\0") == []
    bench.write(0x1017, 0)
    bench.seen.clear()
    bench.on(1)
    assert bench.seen == []
    assert len(bench.put(0x705 | 0x40000000, b"\0")) == 1


def test_the_serial_number_may_be_given():
    assert Bench(make_device(TMCM, 3, serial=12345)).number(0x1018, 4) == 12345
    assert Bench(make_device("eds/generic_cia402.eds", 3, serial=12345)).number(0x1018, 4) == 12345


def test_a_default_of_a_serial_number_is_none_and_a_parameter_value_is_one():
    od = read_eds(data_path("eds", "generic_cia402.eds"), 3).od
    assert od[0x1018, 4].default == 1
    assert Bench(make_device(od, 3)).number(0x1018, 4) == 3
    od.entries[0x1018, 4] = dataclasses.replace(od[0x1018, 4], parameter_value=77)
    assert Bench(make_device(od, 3)).number(0x1018, 4) == 77
