from __future__ import annotations

from support.virtualbench import T, entry

from canopen_control.cia301.pdo import MappedObject, PdoCodec
from canopen_control.virtual.node_pdos import MappedTpdo, concerns_of

WORD, TARGET, MODE = (entry(index, 0, T.UNSIGNED16) for index in (0x6040, 0x60FF, 0x6060))
SECOND = entry(0x6840, 0, T.UNSIGNED16)


def test_an_rpdo_concerns_each_axis_once_with_all_its_objects():
    axes = {0: "first", 1: "second"}
    assert concerns_of((TARGET, None, SECOND, WORD), axes) == (
        ("first", True, {0x60FF, 0x6040}),
        ("second", True, {0x6040}),
    )


def test_an_object_that_is_no_axis_s_or_of_an_axis_that_is_not_there_leaves_none():
    assert concerns_of((WORD, entry(0x2000, 0, T.UNSIGNED8)), {0: "first"}) == ()
    assert concerns_of((WORD, SECOND), {0: "first"}) == ()


def test_a_tpdo_tells_which_of_its_objects_have_changed_since_it_was_sampled():
    values = [1, 2]
    tpdo = MappedTpdo(0)
    tpdo.codec = PdoCodec([MappedObject(0x6041, 0, 16, T.UNSIGNED16), MappedObject(0x6061, 0, 16, T.UNSIGNED16)])
    tpdo.sources = (lambda: values[0], lambda: values[1])
    tpdo.mapped = ((0x6041, 0), (0x6061, 0))
    before = tpdo.sample()
    values[1] = 3
    assert tpdo.sample() == b"\x01\0\x03\0"
    assert tpdo.changed_since(before) == [(0x6061, 0)]


def test_a_value_too_wide_for_its_place_leaves_a_tpdo_of_zeros():
    tpdo = MappedTpdo(0)
    tpdo.codec, tpdo.sources = PdoCodec([MappedObject(0x6041, 0, 16, T.UNSIGNED16)]), (lambda: 1 << 20,)
    assert tpdo.sample() == b"\0\0"
