"""The PDOs of a dictionary."""

from canopen_control.data_files import data_path
from canopen_control.od.eds import read_eds
from canopen_control.od.model import DataType, Entry, ObjectDictionary
from canopen_control.od.pdos import pdos_of


def od_with(*values):
    od = ObjectDictionary()
    for index, subindex, value in values:
        od.add(Entry(index, subindex, "x", DataType.UNSIGNED32, default=value))
    return od


def test_the_pdos_of_the_tmcm_1270():
    pdos = pdos_of(read_eds(data_path("eds", "TMCM-1270.eds"), 3).od)
    assert [pdo.name for pdo in pdos] == [*(f"RPDO{n}" for n in range(1, 5)), *(f"TPDO{n}" for n in range(1, 5))]
    assert [pdo.enabled for pdo in pdos] == [True, True, True, False] * 2
    assert [pdo.bits for pdo in pdos] == [16, 24, 48, 48] * 2
    assert {pdo.slots for pdo in pdos} == {3}
    assert pdos[2].cob_id == 0x40000403
    assert [(mapped.index, mapped.entry.name) for mapped in pdos[2].mapped] == [
        (0x6040, "Controlword"),
        (0x607A, "Target position"),
    ]


def test_without_a_count_every_entry_with_a_value_is_mapped():
    od = od_with((0x1A00, 1, 0x60410010), (0x1A00, 2, 0), (0x1A00, 3, None), (0x1A00, 4, 0x00050008))
    (pdo,) = pdos_of(od)
    assert [mapped.is_dummy for mapped in pdo.mapped] == [False, True]
    assert pdo.mapped[0].entry is None


def test_multiplexed_pdos_map_nothing():
    assert pdos_of(od_with((0x1600, 0, 254), (0x1600, 1, 0x60400010)))[0].mapped == ()


def test_pdos_come_by_number_with_either_record():
    od = od_with((0x17FF, 0, 0), (0x1400, 1, 0x200), (0x1BFF, 0, 0), (0x1800, 1, 0x180))
    assert [pdo.name for pdo in pdos_of(od)] == ["RPDO1", "RPDO512", "TPDO1", "TPDO512"]
