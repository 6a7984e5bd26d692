from __future__ import annotations

import pytest
from support.virtualbench import Bench, servo, servo_od

from canopen_control.cia402.modes import OperationMode
from canopen_control.virtual.device import make_device
from canopen_control.virtual.drive_modes import MODES, possible_modes
from canopen_control.virtual.node_outbox import ModeChanged
from canopen_control.virtual.profile_modes import HomingMode


@pytest.mark.parametrize("mode", MODES)
def test_every_mode_is_taken_and_reported_once(mode):
    bench = Bench(servo(x6502=0xFFFFFFFF))
    bench.write(0x6060, mode)
    bench.write(0x6060, mode)
    bench.on(0)
    assert bench.number(0x6061) == mode == bench.drive.modes.number
    assert [event for event in bench.events if isinstance(event, ModeChanged)] == [ModeChanged(0, mode)]


def test_the_modes_of_a_file_without_0x6502_are_those_with_targets_in_it():
    everything = possible_modes(Bench(servo()).drive.objects)
    without = Bench(make_device(servo_od(5, without=(0x6071, 0x60FF)), 5)).drive.objects
    lost = {OperationMode.TQ, OperationMode.CST, OperationMode.PV, OperationMode.CSV}
    assert everything & ~possible_modes(without) == sum(1 << mode - 1 for mode in lost)


def test_a_mode_that_comes_late_comes_once():
    bench = Bench(servo())
    bench.drive.modes.delay_ns.inject(100_000_000)
    bench.write(0x6060, 3)
    bench.on(0.05)
    bench.write(0x6060, 9)
    assert bench.number(0x6061) == 0
    bench.on(0.051)
    assert bench.number(0x6061) == 9


def test_homing_is_the_mode_6():
    bench = Bench(servo())
    bench.write(0x6060, OperationMode.HM)
    assert isinstance(bench.drive.modes.homing, HomingMode)
    assert bench.drive.modes.active is bench.drive.modes.homing
