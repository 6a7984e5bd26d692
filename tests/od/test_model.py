"""The object dictionary as data."""

import pytest

from canopen_control.od.model import DataType, Entry, ObjectCode, ObjectDictionary, ObjectInfo


def entry(index=0x2000, subindex=0, name="Thing", data_type=DataType.UNSIGNED32, access="rw", **more):
    return Entry(index, subindex, name, data_type, access, **more)


@pytest.mark.parametrize(
    ("data_type", "bits", "low", "high"),
    [
        (DataType.BOOLEAN, 1, 0, 1),
        (DataType.INTEGER8, 8, -128, 127),
        (DataType.INTEGER24, 24, -(2**23), 2**23 - 1),
        (DataType.INTEGER64, 64, -(2**63), 2**63 - 1),
        (DataType.UNSIGNED40, 40, 0, 2**40 - 1),
        (DataType.TIME_OF_DAY, 48, 0, 2**48 - 1),
        (DataType.REAL32, 32, 0, 0),
        (DataType.DOMAIN, None, 0, 0),
    ],
)
def test_a_type_has_its_width_and_range(data_type, bits, low, high):
    assert (data_type.bits, data_type.minimum, data_type.maximum) == (bits, low, high)


@pytest.mark.parametrize(
    ("access", "readable", "writable", "rpdo", "tpdo"),
    [
        ("ro", True, False, False, True),
        ("const", True, False, False, True),
        ("wo", False, True, True, False),
        ("rw", True, True, True, True),
        ("rwr", True, True, False, True),
        ("rww", True, True, True, False),
    ],
)
def test_access_reports_what_sdo_and_pdo_may_do(access, readable, writable, rpdo, tpdo):
    mappable = entry(access=access, pdo_mappable=True)
    assert (mappable.readable, mappable.writable) == (readable, writable)
    assert (mappable.rpdo_mappable, mappable.tpdo_mappable) == (rpdo, tpdo)
    assert not entry(access=access).rpdo_mappable
    assert not entry(access=access).tpdo_mappable


def test_entries_are_found_by_address():
    od = ObjectDictionary()
    od.add(entry(subindex=2))
    od.add(entry(subindex=0))
    assert (0x2000, 2) in od
    assert (0x2000, 1) not in od
    assert od[0x2000, 2].subindex == 2
    assert od.get(0x2000, 1) is None
    assert od.subindices(0x2000) == [0, 2]
    assert od.subindices(0x3000) == []
    assert len(od) == len(list(od)) == 2
    assert od.objects[0x2000].code is ObjectCode.RECORD


def test_a_name_finds_an_entry_only_where_it_is_the_only_one():
    od = ObjectDictionary()
    od.objects[0x2000] = ObjectInfo(0x2000, "Gains", ObjectCode.RECORD)
    od.objects[0x2001] = ObjectInfo(0x2001, "Limits", ObjectCode.RECORD)
    for index in (0x2000, 0x2001):
        od.add(entry(index, 1, "Position"))
    od.add(entry(0x6040, name="Controlword"))
    assert od.find("Controlword").index == 0x6040
    assert od.find("controlWORD").index == 0x6040
    assert od.find("Position") is None
    assert od.find("Limits.Position").index == 0x2001
    assert od.find("nothing") is None


def test_case_decides_only_where_it_must():
    od = ObjectDictionary()
    od.add(entry(0x2000, name="gain"))
    od.add(entry(0x2001, name="Gain"))
    assert od.find("Gain").index == 0x2001
    assert od.find("GAIN") is None


def test_one_dictionary_serves_many_nodes():
    od = ObjectDictionary()
    od.add(entry(0x1400, 1, default=0x200, relative=True, low=0x180, low_relative=True, high=0xFFFF))
    od.add(entry(0x1401, 1, default=0x300))
    od.add(entry(0x1402, 1, parameter_value=0x400, parameter_relative=True, default=5))
    three = od.for_node(3)
    assert (three.node_id, three[0x1400, 1].default, three[0x1400, 1].low) == (3, 0x203, 0x183)
    assert three[0x1400, 1].high == 0xFFFF
    assert three[0x1401, 1].default == 0x300
    assert (three[0x1402, 1].value, three[0x1402, 1].default) == (0x403, 5)
    assert three.for_node(5)[0x1400, 1].default == 0x205
    assert od[0x1400, 1].default == 0x200


def test_a_number_is_the_value_of_the_file_and_none_without_one():
    od = ObjectDictionary()
    od.add(entry(0x1000, 0, default=0x20192))
    od.add(entry(0x1402, 1, parameter_value=0, default=5))
    od.add(entry(0x1008, 0, default="drive"))
    od.add(entry(0x1017, 0))
    result = [od.number(0x1000), od.number(0x1402, 1), od.number(0x1008), od.number(0x1017), od.number(0x1018, 1)]
    assert result == [0x20192, 0, None, None, None]
