"""Virtual measuring devices and batteries: values in units, status, formats, charge."""

import pytest
from support.devices import put
from support.devices import virtual as bench

from canopen_control.errors import ConfigError


def told(device, name):
    return next(each for each in device.node.function.describe() if each.name == name)


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
    assert told(device, "ao0").value == pytest.approx(10.0)
    device.nmt(2)
    assert told(device, "ao0").value == pytest.approx(-1.0)


def test_a_battery_begins_charged_and_is_told_by_a_timer():
    device = bench(418)
    assert device.number(0x6010, signed=True) == 200  # 25 degrees
    assert device.number(0x6060) == round(25.6 * 1024)
    assert (device.number(0x6081), device.number(0x6000)) == (80, 1)
    device.start()
    device.on(3.05)
    assert sum(frame.can_id == 0x285 for _, frame in device.seen) == 4


@pytest.mark.rest
def test_a_current_takes_its_charge_and_lets_its_voltage_sag():
    device = bench(418)
    put(device, battery_current=-72.0)
    assert device.number(0x6060) == round((25.6 - 3.6) * 1024)
    device.on(1000.0)  # 20 Ah of 100
    assert device.number(0x6081) == 60
    device.on(5000.0)
    assert device.number(0x6081) == 0
    put(device, battery_current=0.0)
    assert device.node.function.next_deadline() is None


def test_what_is_no_input_is_refused():
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


def test_a_charger_tells_its_state_and_forgets_a_request_without_its_master():
    device = bench(419)
    device.start()
    put(device, charger_status=3, charger_percentage=55)
    assert (device.number(0x6001), device.number(0x6080)) == (3, 55)
    device.put(0x205, bytes.fromhex("2800015000600000"))  # 2.5 A, ready, 80 %, 24 V
    assert told(device, "charge_current_requested").value == 2.5
    assert told(device, "battery_voltage").value == 24.0
    with pytest.raises(ConfigError, match="charge_current_requested is an output"):
        put(device, charge_current_requested=1.0)
    device.nmt(2)
    assert told(device, "charge_current_requested").value == 0.0
    assert told(device, "battery_percentage").value == 80.0
