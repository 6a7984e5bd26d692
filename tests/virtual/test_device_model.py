from __future__ import annotations

import math

from support.virtualbench import Bench, servo, servo_od

from canopen_control.virtual.device import make_device
from canopen_control.virtual.device_model import GENERIC, DeviceModel


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
