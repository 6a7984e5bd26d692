from __future__ import annotations

import math

import pytest
from support.setpoints import StreamBench
from support.virtualbench import TMCM, Bench, T, entry, servo, servo_od

from canopen_control.od.eds import read_eds
from canopen_control.virtual.device import TMCM1270, device_model_of, make_device
from canopen_control.virtual.device_model import (
    ELMO,
    GENERIC,
    MAXON,
    VENDOR_MODELS,
    DeviceModel,
    MissingSetPoint,
    vendor_model,
)

STANDS = MissingSetPoint()


def test_a_generic_drive_jumps_where_its_ramps_are_not_set():
    assert math.isinf(GENERIC.unset_ramp)
    bench = Bench(servo(x6083=0, x6084=0)).enable(3)
    bench.write(0x60FF, 1000)
    bench.on(0.001)
    assert bench.velocity == 1000


def test_a_generic_drive_positions_without_a_profile_velocity_too():
    bench = Bench(servo(without=(0x6081, 0x6083, 0x6084))).enable(1)
    bench.write(0x607A, 1000)
    bench.control(0x1F)
    bench.on(0.011)
    assert bench.position == 1000


def test_a_delay_object_delays_its_transition():
    model = DeviceModel(delays={4: 0x6068})
    bench = Bench(make_device(servo_od(5, x6068=300), 5, model=model))
    bench.start()
    for word in (6, 7, 15):
        bench.control(word)
    bench.on(0.29)
    assert bench.state == "SWITCHED_ON"
    bench.on(0.02)
    assert bench.state == "OPERATION_ENABLED"


# -- vendors


def of_vendor(vendor):
    od = servo_od(5)
    od.add(entry(0x1018, 1, T.UNSIGNED32, vendor, "ro"))
    return od


@pytest.mark.parametrize(("vendor", "model"), [(0x9A, ELMO), (0xFB, MAXON), (0x99, GENERIC), (0x286, GENERIC)])
def test_the_vendor_decides_where_the_device_is_not_known(vendor, model):
    assert device_model_of(of_vendor(vendor)) is model


def test_a_known_device_is_more_than_its_vendor():
    assert device_model_of(read_eds(TMCM, 3).od) is TMCM1270


def test_a_dictionary_without_an_identity_has_no_vendor():
    od = of_vendor(None)
    assert vendor_model(od) is None


def test_what_each_does_without_a_set_point():
    assert {model.missing for model in (GENERIC, TMCM1270, MAXON)} == {STANDS}
    assert (ELMO.missing.cycles, ELMO.missing.fault) == (1, 0xFF02)
    assert set(VENDOR_MODELS) == {0x9A, 0xFB}


@pytest.mark.parametrize("cycles", [0, 1, 4])
def test_how_long_elmo_continues_is_in_its_object(cycles):
    od = of_vendor(0x9A)
    od.add(entry(0x2F75, 0, T.UNSIGNED16, cycles))
    bench = StreamBench(model=ELMO, od=od).ramp(50)
    bench.on(1)
    assert bench.drive.mover.plant.position == pytest.approx((49 + cycles) * 1000)
    assert (bench.state == "FAULT") is bool(cycles)


def test_a_maxon_drive_whose_interpolation_time_is_0_takes_each_set_point_at_once():
    bench = StreamBench(0, model=MAXON)
    for cycle in range(1, 10):
        bench.send(1000 * cycle)
        bench.sync()
        assert bench.position == 1000 * cycle
        bench.on(0.01)
        assert bench.velocity == 0
