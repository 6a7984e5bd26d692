"""The lines of I/O modules by name, in whichever group their objects show them."""

from support.virtualbench import T, entry

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import ObjectDictionary
from canopen_control.profiles.profile_tables import io_signals


def names(od):
    return {signal.name: signal for signal in io_signals(od)}


def test_lines_are_counted_through_all_objects_of_a_kind():
    found = names(read_eds(data_path("eds", "generic_cia401.eds"), 5).od)
    kinds = ("di", "do", "ai", "ao")
    assert [sum(name.startswith(kind) for name in found) for kind in kinds] == [16, 16, 4, 4]
    assert (found["di11"].address, found["di11"].bit, found["di11"].output) == ((0x6000, 2), 3, False)
    assert (found["do8"].address, found["do8"].bit, found["do8"].output) == ((0x6200, 2), 0, True)
    assert (found["ai3"].address, found["ai3"].bit) == ((0x6401, 4), None)


def test_lines_in_groups_of_16_are_those_where_there_are_none_of_8():
    od = ObjectDictionary()
    od.add(entry(0x6100, 2, T.UNSIGNED16))
    od.add(entry(0x6300, 1, T.UNSIGNED16))
    found = names(od)
    assert list(found)[:2] == ["di16", "di17"]
    assert found["do15"].bit == 15
    od.add(entry(0x6000, 1, T.UNSIGNED8))
    assert "di7" in names(od)
    assert "di16" not in names(od)


def test_the_number_of_subindices_is_no_line():
    od = ObjectDictionary()
    od.add(entry(0x6401, 0, T.UNSIGNED8, 1))
    assert names(od) == {}
