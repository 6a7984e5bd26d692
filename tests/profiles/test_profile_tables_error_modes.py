"""What outputs are to be without their master, as error modes and error values."""

from dataclasses import replace

from support.virtualbench import T, entry

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import ObjectDictionary
from canopen_control.profiles.profile_tables import ERROR_OBJECTS, SafeOutput, has_error_mode, io_signals, safe_outputs

MODULE = read_eds(data_path("eds", "generic_cia401.eds"), 5).od


def outputs(od=MODULE, **safe):
    signals = [replace(each, safe=safe.get(each.name, each.safe)) for each in io_signals(od)]
    return {each.output: each for each in safe_outputs(signals, od)}


def test_all_lines_are_switched_off_unless_another_value_is_safe():
    assert outputs()[0x6200, 1] == SafeOutput((0x6200, 1), (0x6206, 1), (0x6207, 1), 0xFF, 0)
    found = outputs(do1=1.0, do3=None, do9=True)
    assert (found[0x6200, 1].mode, found[0x6200, 1].value) == (0xF7, 0x02)
    assert (found[0x6200, 2].mode, found[0x6200, 2].value) == (0xFF, 0x02)


def test_an_analogue_output_has_a_value_in_raw_numbers_or_keeps():
    found = outputs(ao0=100.0, ao1=None)
    assert (found[0x6411, 1].mode, found[0x6411, 1].value) == (1, 100)
    assert found[0x6411, 2].mode == 0


def test_what_a_device_lacks_has_no_address():
    od = ObjectDictionary()
    od.add(entry(0x6200, 1, T.UNSIGNED8))
    found = outputs(od)[0x6200, 1]
    assert (found.mode_at, found.value_at) == (None, None)
    assert not any(has_error_mode(od, each) for each in io_signals(od))
    assert all(has_error_mode(MODULE, each) for each in io_signals(MODULE) if each.output)
    assert 0x6000 not in ERROR_OBJECTS
