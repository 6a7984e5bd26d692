"""Signals of sensors: which object is shown, and how the device says that it is scaled."""

import math

import pytest
from support.virtualbench import T, entry

from canopen_control.od.model import ObjectDictionary
from canopen_control.profiles.profile_tables import (
    battery_signals,
    charger_signals,
    encoder_signals,
    inclinometer_signals,
    measuring_signals,
)


def dictionary(*entries):
    od = ObjectDictionary(node_id=5)
    for each in entries:
        od.add(entry(*each))
    return od


def test_a_measured_value_has_digits_unit_and_status_of_its_channel():
    od = dictionary(
        (0x7130, 1, T.INTEGER16),
        (0x6131, 1, T.UNSIGNED32, 0x002D0000),
        (0x6132, 1, T.UNSIGNED8, 1),
        (0x6150, 1, T.UNSIGNED8),
        (0x7300, 1, T.INTEGER16),
    )
    value, status, output = measuring_signals(od)
    assert (status.name, status.address) == ("status0", (0x6150, 1))
    assert (value.name, value.unit, value.status) == ("ai0", "degC", (0x6150, 1))
    assert value.value(215, value.gain({(0x6132, 1): 1, (0x6131, 1): 0})) == pytest.approx(21.5)
    assert value.value(215, value.gain({(0x6132, 1): 2, (0x6131, 1): 0xFD260000})) == pytest.approx(0.00215)
    assert (output.name, output.output) == ("ao0", True)


def test_of_several_formats_the_mapped_one_is_shown():
    both = ((0x7130, 1, T.INTEGER16), (0x6130, 1, T.REAL32), (0x6132, 1, T.UNSIGNED8, 2))
    assert next(measuring_signals(dictionary(*both))).index == 0x7130
    mapped = dictionary(*both, (0x1A00, 1, T.UNSIGNED32, 0x61300120))
    signal = next(measuring_signals(mapped))
    assert signal.index == 0x6130
    assert signal.scales == ()  # a float has its digits


def test_a_turn_is_what_the_encoder_says_it_is():
    od = dictionary(
        (0x1000, 0, T.UNSIGNED32, 0x00020196),
        (0x6001, 0, T.UNSIGNED32, 4096),
        (0x6002, 0, T.UNSIGNED32, 1 << 24),
        (0x6004, 0, T.UNSIGNED32),
        (0x6030, 1, T.INTEGER16),
    )
    position, absolute, speed = encoder_signals(od)
    assert (position.name, position.unit, position.unwrap) == ("position", "rad", (0x6002, 0))
    assert position.value(2048, position.gain({(0x6001, 0): 4096})) == pytest.approx(math.pi)
    assert position.gain({(0x6001, 0): 0}) == pytest.approx(math.tau / 4096)
    assert (absolute.name, absolute.unwrap, speed.unit) == ("position_absolute", None, "")


def test_a_linear_encoder_measures_metres():
    od = dictionary((0x1000, 0, T.UNSIGNED32, 0x00080196), (0x6004, 0, T.INTEGER32), (0x6005, 1, T.UNSIGNED32, 5000))
    position = next(encoder_signals(od))
    assert position.unit == "m"
    assert position.value(1000, position.gain({(0x6005, 1): 5000})) == pytest.approx(0.005)


@pytest.mark.parametrize(("resolution", "degrees"), [(10, 0.01), (100, 0.1), (1000, 1.0)])
def test_an_angle_has_the_resolution_that_the_inclinometer_says(resolution, degrees):
    od = dictionary((0x6000, 0, T.UNSIGNED16, 10), (0x6010, 0, T.INTEGER16), (0x6020, 0, T.INTEGER16))
    longitudinal, lateral = inclinometer_signals(od)
    assert (longitudinal.name, lateral.name) == ("longitudinal", "lateral")
    gain = lateral.gain({(0x6000, 0): resolution})
    assert lateral.value(-30, gain) == pytest.approx(math.radians(-30 * degrees))


def test_a_battery_is_told_in_volts_degrees_and_percent():
    od = dictionary((0x6010, 0, T.INTEGER16), (0x6060, 0, T.UNSIGNED32), (0x6081, 0, T.UNSIGNED8))
    found = {each.name: each.value(1024, each.gain({})) for each in battery_signals(od)}
    assert found == {"battery_temperature": 128.0, "battery_voltage": 1.0, "battery_percentage": 1024.0}


def test_a_charger_tells_its_state_and_takes_what_a_battery_tells():
    od = dictionary(
        (0x6001, 0, T.UNSIGNED8, 0, "ro"),
        (0x6070, 0, T.UNSIGNED16, 0, "rww", True),
        (0x6010, 0, T.INTEGER16, 0, "rww", True),
    )
    found = {each.name: each for each in charger_signals(od)}
    assert {name: each.output for name, each in found.items()} == {
        "charger_status": False,
        "charge_current_requested": True,
        "battery_temperature": True,
    }
    assert found["charge_current_requested"].raw(2.5, 1 / 16, whole=True) == 40
    assert found["battery_temperature"].raw(-10.0, 0.125, whole=True) == -80
    assert found["charge_current_requested"].safe == 0.0
