"""All signals of a device by name, and any object by its address."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.virtualbench import T, entry, servo_od

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, ObjectDictionary
from canopen_control.profiles import (
    ERROR_OBJECTS,
    TYPES,
    Profile,
    SafeOutput,
    Signal,
    SignalScale,
    battery_signals,
    charger_signals,
    encoder_signals,
    factor_of_digits,
    factor_of_prefix,
    has_error_mode,
    inclinometer_signals,
    io_signals,
    measuring_signals,
    object_of,
    object_signal,
    profile_signals,
    retyped,
    safe_outputs,
    unit_of_code,
)


def dictionary(*entries):
    od = ObjectDictionary(node_id=5)
    for item in entries:
        od.add(entry(*item))
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


def test_a_turn_is_what_the_encoder_reports_it_is():
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
def test_an_angle_has_the_resolution_that_the_inclinometer_reports(resolution, degrees):
    od = dictionary((0x6000, 0, T.UNSIGNED16, 10), (0x6010, 0, T.INTEGER16), (0x6020, 0, T.INTEGER16))
    longitudinal, lateral = inclinometer_signals(od)
    assert (longitudinal.name, lateral.name) == ("longitudinal", "lateral")
    gain = lateral.gain({(0x6000, 0): resolution})
    assert lateral.value(-30, gain) == pytest.approx(math.radians(-30 * degrees))


def test_a_battery_is_reported_in_volts_degrees_and_percent():
    od = dictionary((0x6010, 0, T.INTEGER16), (0x6060, 0, T.UNSIGNED32), (0x6081, 0, T.UNSIGNED8))
    result = {signal.name: signal.value(1024, signal.gain({})) for signal in battery_signals(od)}
    assert result == {"battery_temperature": 128.0, "battery_voltage": 1.0, "battery_percentage": 1024.0}


def test_a_charger_reports_its_state_and_takes_what_a_battery_reports():
    od = dictionary(
        (0x6001, 0, T.UNSIGNED8, 0, "ro"),
        (0x6070, 0, T.UNSIGNED16, 0, "rww", True),
        (0x6010, 0, T.INTEGER16, 0, "rww", True),
    )
    result = {signal.name: signal for signal in charger_signals(od)}
    assert {name: each.output for name, each in result.items()} == {
        "charger_status": False,
        "charge_current_requested": True,
        "battery_temperature": True,
    }
    assert result["charge_current_requested"].raw(2.5, 1 / 16, whole=True) == 40
    assert result["battery_temperature"].raw(-10.0, 0.125, whole=True) == -80
    assert result["charge_current_requested"].safe == 0.0


def names(od):
    return {signal.name: signal for signal in io_signals(od)}


def test_lines_are_counted_through_all_objects_of_a_kind():
    result = names(read_eds(data_path("eds", "generic_cia401.eds"), 5).od)
    kinds = ("di", "do", "ai", "ao")
    assert [sum(name.startswith(kind) for name in result) for kind in kinds] == [16, 16, 4, 4]
    assert (result["di11"].address, result["di11"].bit, result["di11"].output) == ((0x6000, 2), 3, False)
    assert (result["do8"].address, result["do8"].bit, result["do8"].output) == ((0x6200, 2), 0, True)
    assert (result["ai3"].address, result["ai3"].bit) == ((0x6401, 4), None)


def test_lines_in_groups_of_16_are_those_where_there_are_none_of_8():
    od = ObjectDictionary()
    od.add(entry(0x6100, 2, T.UNSIGNED16))
    od.add(entry(0x6300, 1, T.UNSIGNED16))
    result = names(od)
    assert list(result)[:2] == ["di16", "di17"]
    assert result["do15"].bit == 15
    od.add(entry(0x6000, 1, T.UNSIGNED8))
    assert "di7" in names(od)
    assert "di16" not in names(od)


def test_the_number_of_subindices_is_not_a_line():
    od = ObjectDictionary()
    od.add(entry(0x6401, 0, T.UNSIGNED8, 1))
    assert names(od) == {}


MODULE = read_eds(data_path("eds", "generic_cia401.eds"), 5).od


def outputs(od=MODULE, **safe):
    signals = [replace(signal, safe=safe.get(signal.name, signal.safe)) for signal in io_signals(od)]
    return {item.output: item for item in safe_outputs(signals, od)}


def test_all_lines_are_switched_off_unless_another_value_is_safe():
    assert outputs()[0x6200, 1] == SafeOutput((0x6200, 1), (0x6206, 1), (0x6207, 1), 0xFF, 0)
    result = outputs(do1=1.0, do3=None, do9=True)
    assert (result[0x6200, 1].mode, result[0x6200, 1].value) == (0xF7, 0x02)
    assert (result[0x6200, 2].mode, result[0x6200, 2].value) == (0xFF, 0x02)


def test_an_analogue_output_has_a_value_in_raw_numbers_or_keeps():
    result = outputs(ao0=100.0, ao1=None)
    assert (result[0x6411, 1].mode, result[0x6411, 1].value) == (1, 100)
    assert result[0x6411, 2].mode == 0


def test_what_a_device_lacks_has_no_address():
    od = ObjectDictionary()
    od.add(entry(0x6200, 1, T.UNSIGNED8))
    result = outputs(od)[0x6200, 1]
    assert (result.mode_at, result.value_at) == (None, None)
    assert not any(has_error_mode(od, signal) for signal in io_signals(od))
    assert all(has_error_mode(MODULE, signal) for signal in io_signals(MODULE) if signal.output)
    assert 0x6000 not in ERROR_OBJECTS


def test_a_device_has_the_signals_of_its_profile_and_a_drive_none():
    assert "di0" in profile_signals(MODULE, Profile.IO)
    assert profile_signals(MODULE, Profile.DRIVE) == profile_signals(servo_od(), Profile.NONE) == {}


@pytest.mark.parametrize(
    ("name", "address", "bit", "output"),
    [
        ("0x6401:02", (0x6401, 2), None, False),
        ("0x6200:01.4", (0x6200, 1), 4, True),
        ("0x1001", (0x1001, 0), None, False),
    ],
)
def test_any_object_is_a_signal_by_its_address(name, address, bit, output):
    signal = object_signal(MODULE, name)
    assert (signal.address, signal.bit, signal.output) == (address, bit, output)
    assert signal.value(16, signal.gain({})) == (16.0 if bit is None else 1.0)


@pytest.mark.parametrize("name", ["0x6401:09", "0x1008", "di0", "6401:01", "0x", ""])
def test_what_is_not_a_number_of_the_device_is_none(name):
    assert object_signal(MODULE, name) is None


# One signal: raw numbers to values and back, bits, types taken for others, addresses as people write them.


@given(
    st.integers(-32768, 32767),
    st.floats(1e-6, 1e6).flatmap(lambda each: st.sampled_from((each, -each))),
    st.floats(-1e3, 1e3),
)
def test_a_value_goes_back_to_the_raw_number_it_came_of(raw, factor, offset):
    signal = Signal("x", 0x6401, 1, factor=factor, offset=offset)
    gain = signal.gain({})
    assert signal.raw(signal.value(raw, gain), gain, whole=False) == pytest.approx(raw, rel=1e-6, abs=1e-3)


def test_a_bit_is_0_or_1_and_an_invalid_number_is_none():
    signal = Signal("x", 0x6000, 1, bit=3)
    assert [signal.value(raw, 1.0) for raw in (0, 8, 0xF7, 0xFF)] == [0.0, 1.0, 0.0, 1.0]
    broken = Signal("x", 0x6401, 1, invalid=(-32768.0, 32767.0))
    assert math.isnan(broken.value(32767, 1.0))
    assert broken.value(32766, 1.0) == 32766.0


def test_the_devices_own_numbers_scale_a_signal_and_only_without_them_what_is_assumed():
    signal = Signal(
        "x", 0x7130, 1, factor=2.0, scales=(SignalScale((0x6132, 1), factor_of_digits, 1),), unwrap=(0x6002, 0)
    )
    assert signal.gain({(0x6132, 1): 3}) == pytest.approx(0.002)
    assert signal.gain({}) == pytest.approx(0.2)
    assert signal.needs == ((0x6132, 1), (0x6002, 0))
    assert (signal.where, Signal("b", 0x6000, 2, bit=7).where) == ("0x7130:01", "0x6000:02.7")


@pytest.mark.parametrize(
    ("text", "result"),
    [
        ("0x6401:01", (0x6401, 1, None)),
        ("6401:1", (0x6401, 1, None)),
        ("0x6004", (0x6004, 0, None)),
        (" 0x6000:0x02.7 ", (0x6000, 2, 7)),
        ("0x6000.63", (0x6000, 0, 63)),
        ("0x6000.64", None),
        ("640", None),
        ("0x64011:1", None),
        ("di0", None),
        ("", None),
    ],
)
def test_objects_are_read_as_people_write_them(text, result):
    assert object_of(text) == result


@given(st.text(max_size=12))
def test_no_text_breaks_the_reading_of_an_object(text):
    result = object_of(text)
    assert result is None or 0 <= result[0] <= 0xFFFF


def test_bits_are_taken_for_another_type_of_their_width():
    assert retyped(0xFFFF, DataType.UNSIGNED16, DataType.INTEGER16) == -1
    assert retyped(0x3F800000, DataType.UNSIGNED32, DataType.REAL32) == 1.0
    assert math.isnan(retyped(1, DataType.UNSIGNED8, DataType.UNSIGNED32))
    assert all(expected.bits for expected in TYPES.values())


@pytest.mark.parametrize(
    ("code", "unit", "factor"),
    [(0x002D0000, "degC", 1.0), (0xFD260000, "V", 0.001), (0x03010000, "m", 1000.0), (0, "", 1.0), (0xFF0000, "", 1.0)],
)
def test_units_are_coded_with_their_prefix(code, unit, factor):
    assert unit_of_code(code) == unit
    assert factor_of_prefix(code) == pytest.approx(factor)


def test_digits_that_are_none_count_as_none():
    assert [factor_of_digits(item) for item in (0, 2, 200, -1)] == [1.0, 0.01, 1.0, 1.0]
