import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.data_files import data_path
from canopen_control.od.codec import default_of
from canopen_control.od.eds import read_eds
from canopen_control.service.parameter_set import parameters_of, without_unused_slots
from canopen_control.service.restore import restore_groups

OD = read_eds(data_path("eds", "TMCM-1270.eds"), 5).od
HELD = without_unused_slots({entry.address: default_of(entry) for entry in parameters_of(OD)})


def order(wanted, held=HELD):
    return [write.address for group in restore_groups(OD, {**held, **wanted}, held) for write in group.writes]


def test_what_does_not_differ_is_not_written():
    assert restore_groups(OD, HELD, HELD) == []
    assert restore_groups(OD, {(0x6081, 0): 5}, {}) == []  # what the node has refused to read


def test_resolution_comes_before_values_and_the_mode_last():
    wanted = {(0x6060, 0): 3, (0x6081, 0): 7, (0x2000, 0): 4, (0x607D, 2): 9, (0x1017, 0): 100, (0x2003, 0): 1}
    assert order(wanted) == [(0x1017, 0), (0x2000, 0), (0x2003, 0), (0x607D, 2), (0x6081, 0), (0x6060, 0)]


def test_the_side_of_a_range_that_widens_comes_first():
    held = {**HELD, (0x607D, 1): -5, (0x607D, 2): 5}
    assert order({(0x607D, 1): 10, (0x607D, 2): 20}, held) == [(0x607D, 2), (0x607D, 1)]
    assert order({(0x607D, 1): -20, (0x607D, 2): -10}, held) == [(0x607D, 1), (0x607D, 2)]


def test_a_pdo_is_invalid_while_it_is_changed_and_mapped_as_a_whole():
    (group,) = restore_groups(OD, {**HELD, (0x1A01, 2): 0x60640020, (0x1801, 2): 1}, HELD)
    assert group.name == "TPDO 2"
    assert [(write.address, int.from_bytes(write.data, "little")) for write in group.writes] == [
        ((0x1801, 1), 0xC0000285),
        ((0x1801, 2), 1),
        ((0x1A01, 0), 0),
        ((0x1A01, 1), 0x60410010),
        ((0x1A01, 2), 0x60640020),
        ((0x1A01, 0), 2),
        ((0x1801, 1), 0x40000285),
    ]


def test_a_pdo_that_is_to_be_off_stays_off_and_bit_30_is_the_devices():
    held = {**HELD, (0x1801, 1): 0x80000285}
    (group,) = restore_groups(OD, {**held, (0x1801, 1): 0x40000285}, held)
    assert [write.data.hex() for write in group.writes] == ["85020000"]
    assert order({(0x1801, 1): 0x80000285, (0x1801, 2): 1}, held) == [(0x1801, 2)]
    (group,) = restore_groups(OD, {**HELD, (0x1801, 1): 0x80000285}, HELD)
    assert group.writes[-1].data.hex() == "850200c0"


def test_records_that_cannot_be_written_are_left_alone():
    fixed = {address: value for address, value in HELD.items() if address not in ((0x1801, 1), (0x1A01, 0))}
    assert order({(0x1A01, 2): 0x60640020}, fixed) == [(0x1A01, 2)]


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_every_value_that_differs_is_written_once(shift):
    changed = {
        address: value + 1
        for number, (address, value) in enumerate(HELD.items())
        if isinstance(value, int) and number % 3 == shift and address[0] > 0x2000 and value < 100
    }
    assert sorted(order(changed)) == sorted(changed)


@given(st.lists(st.sampled_from([address for address in HELD if 0x1400 <= address[0] < 0x1C00]), max_size=6))
def test_a_count_is_never_above_0_while_an_entry_is_written(addresses):
    wanted = {
        **HELD,
        **{address: 0 if address[1] == 0 else 0x60640020 for address in addresses if address[0] >= 0x1A00},
    }
    counts = {index: value for (index, sub), value in HELD.items() if sub == 0}
    valid = {
        index: not value & 1 << 31
        for (index, sub), value in HELD.items()
        if sub == 1 and index in range(0x1800, 0x1A00)
    }
    for group in restore_groups(OD, wanted, HELD):
        for write in group.writes:
            (index, sub), value = write.address, int.from_bytes(write.data, "little")
            if 0x1800 <= index < 0x1A00 and sub == 1:
                valid[index] = not value & 1 << 31
            elif sub == 0:
                assert not valid[index - 0x200]
                counts[index] = value
            else:
                assert counts[index] == 0
