"""What a node makes of its CAN controller; heartbeats and guarding are tested with the node."""

from __future__ import annotations

import pytest
from support.virtualbench import Bench, ready_tmcm, servo

from canopen_control.bus.port import BusEventKind as Kind


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
def test_off_the_bus_the_axes_stop_as_0x6007_says(kind, option, end):
    b = spinning(x6007=option)
    tell(b, kind)
    b.on(1)
    assert (b.state, b.drive.mover.plant.velocity) == (end, 0)


def test_with_0x6007_of_0_the_motor_goes_on():
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


def test_error_passive_is_an_error_while_it_lasts_and_an_overrun_is_told():
    b = Bench(servo())
    tell(b, Kind.ERROR_PASSIVE)
    assert b.number(0x1001) == 0x11
    tell(b, Kind.ERROR_ACTIVE)
    assert b.number(0x1001) == 0
    tell(b, Kind.OVERRUN)
    assert [code[:4] for code in emcys(b)] == ["2081", "0000", "1081", "0000"]


def test_the_tmcm_1270_does_what_0x1029_says():
    b = ready_tmcm()
    b.write(0x1029, 2, 1)
    b.write(0x60FF, 1600)
    b.on(1)
    tell(b, Kind.BUS_OFF)
    b.on(1)
    assert b.node.nmt.state == 4
    assert (b.state, b.drive.mover.plant.velocity) == ("FAULT", 0)
