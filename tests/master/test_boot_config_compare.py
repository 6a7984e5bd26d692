"""A plan against what a node holds: what counts as a difference, and what is written for it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.master.boot_config import (
    cob_id_of,
    final_values,
    groups,
    is_cob_id,
    keep_rtr_bit,
    matches,
    needed,
    reads_of,
)
from canopen_control.master.plan_builder import PlannedWrite
from canopen_control.od.model import DataType

RPDO1 = ("rpdo", 1)


def u32(index, subindex, value, pdo=RPDO1):
    return PlannedWrite(index, subindex, value.to_bytes(4, "little"), "x", pdo=pdo, data_type=DataType.UNSIGNED32)


def u8(index, subindex, value, pdo=RPDO1):
    return PlannedWrite(index, subindex, bytes((value,)), "x", pdo=pdo, data_type=DataType.UNSIGNED8)


PDO = [
    u32(0x1400, 1, 0xC0000203),
    u8(0x1400, 2, 1),
    u8(0x1600, 0, 0),
    u32(0x1600, 1, 0x60400010),
    u8(0x1600, 0, 1),
    u32(0x1400, 1, 0x40000203),
]
HELD = {
    (0x1400, 1): (0x40000203).to_bytes(4, "little"),
    (0x1400, 2): b"\x01",
    (0x1600, 0): b"\x01",
    (0x1600, 1): (0x60400010).to_bytes(4, "little"),
}


def told(held):
    return [(write.index, write.subindex, int.from_bytes(write.data, "little")) for write in needed(PDO, held)]


def test_the_writes_of_one_pdo_belong_together_and_others_stand_alone():
    ramp, mode = u32(0x6083, 0, 1, None), u32(0x6084, 0, 1, None)
    assert groups([ramp, mode, *PDO, ramp]) == [[ramp], [mode], PDO, [ramp]]


def test_a_pdo_is_read_once_for_each_of_its_objects():
    assert sorted(reads_of(PDO)) == [(0x1400, 1), (0x1400, 2), (0x1600, 0), (0x1600, 1)]
    assert final_values(PDO)[0x1600, 0].data == b"\x01"
    assert cob_id_of(("tpdo", 3)) == 0x1802
    assert [is_cob_id(write) for write in PDO] == [True, False, False, False, False, True]


def test_a_pdo_that_is_as_wanted_needs_nothing_whatever_its_bit_30():
    assert told(HELD) == []
    assert told({**HELD, (0x1400, 1): (0x203).to_bytes(4, "little")}) == []


def test_another_type_alone_leaves_the_mapping_as_it_is():
    assert told({**HELD, (0x1400, 2): b"\xff"}) == [
        (0x1400, 1, 0xC0000203),
        (0x1400, 2, 1),
        (0x1400, 1, 0x40000203),
    ]


def test_another_mapping_is_written_as_a_whole_while_the_pdo_is_invalid():
    order = told({**HELD, (0x1600, 1): (0x60410010).to_bytes(4, "little")})
    assert order == [
        (0x1400, 1, 0xC0000203),
        (0x1600, 0, 0),
        (0x1600, 1, 0x60400010),
        (0x1600, 0, 1),
        (0x1400, 1, 0x40000203),
    ]


def test_a_pdo_that_is_invalid_already_is_not_made_so_again():
    assert told({**HELD, (0x1400, 1): (0xC0000203).to_bytes(4, "little")}) == [(0x1400, 1, 0x40000203)]


def test_of_a_pdo_that_is_to_be_invalid_only_bit_31_counts():
    off = u32(0x1402, 1, 0xC0000403, ("rpdo", 3))
    assert matches(off, (0x80000000).to_bytes(4, "little"))
    assert not matches(off, (0x40000403).to_bytes(4, "little"))


def test_what_cannot_be_read_is_written():
    assert told({}) == [(write.index, write.subindex, int.from_bytes(write.data, "little")) for write in PDO]


@pytest.mark.parametrize(
    ("data", "data_type", "held", "same"),
    [
        (b"\x05\0", DataType.UNSIGNED16, b"\x05\0\0\0", True),
        (b"\xfd", DataType.INTEGER8, b"\xfd\xff\xff\xff", True),
        (b"\xfd", DataType.INTEGER8, b"\xfd\0\0\0", False),
        (b"abc", DataType.VISIBLE_STRING, b"abc\0\0", True),
        (b"abc", DataType.OCTET_STRING, b"abc\0\0", False),
        (b"\0\0\x80\x3f", DataType.REAL32, b"\0\0\x80\x3f", True),
        (b"\x01", None, b"\x01\0", False),
        (b"\x01", DataType.UNSIGNED8, None, False),
    ],
)
def test_values_are_compared_as_their_type(data, data_type, held, same):
    assert matches(PlannedWrite(0x2000, 0, data, "x", data_type=data_type), held) is same


@given(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFFFFFF))
def test_bit_30_is_the_devices_and_every_other_bit_the_plans(planned, own):
    kept = int.from_bytes(keep_rtr_bit(planned.to_bytes(4, "little"), own.to_bytes(4, "little")), "little")
    assert kept & 0x40000000 == own & 0x40000000
    assert kept & ~0x40000000 == planned & ~0x40000000
    assert keep_rtr_bit(planned.to_bytes(4, "little"), None) == planned.to_bytes(4, "little")


@given(st.dictionaries(st.sampled_from(sorted(HELD)), st.sampled_from([b"", b"\0", b"\x01", bytes(4), b"\xff" * 4])))
def test_after_the_needed_writes_nothing_is_needed_any_more(changes):
    held = {**HELD, **changes}
    for write in needed(PDO, held):
        held[write.address] = write.data
    assert needed(PDO, held) == []
