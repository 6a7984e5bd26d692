"""PDOs of a node in its boot: read, compare, write, verify, or the node's own."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.conversation import READ_ONLY, WRONG_STATE, Device, plan

from canopen_control.cia301.pdo import MappedObject
from canopen_control.errors import BootError
from canopen_control.master.boot_pdos import (
    cob_id_of,
    configure_pdo,
    final_values,
    groups,
    is_cob_id,
    keep_rtr_bit,
    matches,
    needed_writes,
    reads_of,
    release_cob_ids,
)
from canopen_control.master.plan_builder import PlannedPdo, PlannedWrite
from canopen_control.master.requests import BootTransfers, Read
from canopen_control.od.model import DataType

RPDO1 = ("rpdo", 1)


def number(value, size=4):
    return value.to_bytes(size, "little")


def write(index, subindex, value, size=4, *, pdo=RPDO1, **how):
    kind = DataType.UNSIGNED32 if size == 4 else DataType.UNSIGNED8
    return PlannedWrite(index, subindex, number(value, size), "x", pdo=pdo, data_type=kind, **how)


PDO = [
    write(0x1400, 1, 0xC0000203),
    write(0x1400, 2, 1, 1),
    write(0x1600, 0, 0, 1),
    write(0x1600, 1, 0x60400010),
    write(0x1600, 0, 1, 1),
    write(0x1400, 1, 0x40000203),
]
HELD = {(0x1400, 1): number(0x40000203), (0x1400, 2): b"\x01", (0x1600, 0): b"\x01", (0x1600, 1): number(0x60400010)}


def test_the_writes_of_one_pdo_belong_together_and_others_stand_alone():
    ramp, mode = write(0x6083, 0, 1, pdo=None), write(0x6084, 0, 1, pdo=None)
    assert groups([ramp, mode, *PDO, ramp]) == [[ramp], [mode], PDO, [ramp]]


def test_a_pdo_is_read_once_for_each_of_its_objects():
    assert sorted(reads_of(PDO)) == [(0x1400, 1), (0x1400, 2), (0x1600, 0), (0x1600, 1)]
    assert final_values(PDO)[0x1600, 0].data == b"\x01"
    assert cob_id_of(("tpdo", 3)) == 0x1802
    assert [is_cob_id(write) for write in PDO] == [True, False, False, False, False, True]


NEEDED = {
    "as requested": ({}, []),
    "as requested, whatever its bit 30": ({(0x1400, 1): number(0x203)}, []),
    "another type, which leaves the mapping": ({(0x1400, 2): b"\xff"}, [0, 1, 5]),
    "another mapping, as a whole while invalid": ({(0x1600, 1): number(0x60410010)}, [0, 2, 3, 4, 5]),
    "already invalid": ({(0x1400, 1): number(0xC0000203)}, [5]),
    "unreadable": (dict.fromkeys(HELD), [0, 1, 2, 3, 4, 5]),
}


@pytest.mark.parametrize(("changes", "writes"), NEEDED.values(), ids=NEEDED)
def test_of_the_writes_of_a_pdo_those_are_needed_that_change_it(changes, writes):
    held = {address: data for address, data in {**HELD, **changes}.items() if data is not None}
    needed = [(write.address, write.data) for write in needed_writes(PDO, held)]
    assert needed == [(PDO[at].address, PDO[at].data) for at in writes]


def test_of_a_pdo_that_is_to_be_invalid_only_bit_31_counts():
    off = write(0x1402, 1, 0xC0000403, pdo=("rpdo", 3))
    assert matches(off, number(0x80000000))
    assert not matches(off, number(0x40000403))


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
    for write in needed_writes(PDO, held):
        held[write.address] = write.data
    assert needed_writes(PDO, held) == []


CONTROLWORD = MappedObject(0x6040, 0, 16, DataType.UNSIGNED16)
MODE = MappedObject(0x6060, 0, 8, DataType.INTEGER8)
TARGET = MappedObject(0x60FF, 0, 32, DataType.INTEGER32)
LAYOUT = PlannedPdo(1, 0x203, 255, (CONTROLWORD, MODE))


GROUP = [
    write(0x1400, 1, 0x80000203),
    write(0x1600, 0, 0, 1),
    write(0x1600, 1, 0x60400010),
    write(0x1600, 2, 0x60600008),
    write(0x1600, 0, 2, 1),
    write(0x1400, 1, 0x203),
]


def device(*entries, cob_id=0x40000203, **how):
    """A node whose RPDO 1 carries `entries`."""
    mapping = {(0x1600, slot): number(entry) for slot, entry in enumerate(entries, 1)}
    return Device(
        {(0x1400, 1): number(cob_id), (0x1400, 2): b"\xff", (0x1600, 0): number(len(entries), 1), **mapping}, **how
    )


def run(node, group=GROUP, **changes):
    transfers = BootTransfers()
    node.run(configure_pdo(plan(**{"rpdos": (LAYOUT,), **changes}), group, transfers, {}))
    return transfers


def held(node):
    return {
        address: int.from_bytes(data, "little")
        for address, data in node.objects.items()
        if address[0] in (0x1400, 0x1600)
    }


def test_a_pdo_that_is_as_requested_is_only_read():
    node = device(0x60400010, 0x60600008)
    assert run(node).writes == 0
    assert node.written == []


def test_a_cob_id_is_read_again_only_after_it_was_released():
    node, transfers = device(0x60400010, 0x60600008), BootTransfers()
    node.objects[0x1401, 1] = number(0x203)  # the COB-ID planned for RPDO 1: RPDO 2 has to give it up
    second = PlannedWrite(0x1401, 1, number(0x303), "x", pdo=("rpdo", 2), data_type=DataType.UNSIGNED32)

    def configure():
        known = yield from release_cob_ids([GROUP, [second]], transfers)
        for group in (GROUP, [second]):
            yield from configure_pdo(plan(rpdos=(LAYOUT,)), group, transfers, known)

    node.run(configure())
    reads = [(request.index, request.subindex) for request in node.log if isinstance(request, Read)]
    assert reads.count((0x1400, 1)) == 1
    assert reads.count((0x1401, 1)) == 3  # before and after the release, and to verify the new one
    assert [(index, int.from_bytes(data, "little")) for index, _, data in node.written] == [
        (0x1401, 0x80000203),
        (0x1401, 0x303),
    ]


def test_the_order_is_invalid_mapping_valid_and_bit_30_stays_the_devices():
    node = device(0x60410010)
    run(node)
    assert [(index, subindex, int.from_bytes(data, "little")) for index, subindex, data in node.written] == [
        (0x1400, 1, 0xC0000203),
        (0x1600, 0, 0),
        (0x1600, 1, 0x60400010),
        (0x1600, 2, 0x60600008),
        (0x1600, 0, 2),
        (0x1400, 1, 0x40000203),
    ]


def test_an_optional_setting_that_is_write_only_is_written_and_not_read():
    node = device(0x60410010)
    run(node, [*GROUP[:1], write(0x1400, 5, 0, 1, optional=True, compare=False), *GROUP[1:]])
    assert (0x1400, 5, b"\0") in node.written


def test_bit_30_that_the_device_does_not_have_is_not_given_to_it():
    node = device(0x60410010, cob_id=0x203)
    run(node)
    assert held(node)[0x1400, 1] == 0x203


MAPPING_FIXED = {(0x1600, slot): READ_ONLY for slot in range(9)}


def test_a_fixed_mapping_that_carries_what_is_needed_is_adopted_with_its_order():
    node = device(0x60600008, 0x60400010, refuse=MAPPING_FIXED)
    transfers = run(node)
    kind, layout = transfers.adopted[0]
    assert (kind, layout.number, layout.cob_id) == ("rpdo", 1, 0x203)
    assert layout.objects == (MODE, CONTROLWORD)
    assert held(node)[0x1400, 1] == 0x40000203
    assert "RPDO 1 is used with the node's own mapping (0x6060:00, 0x6040:00): it refuses" in transfers.warnings[0]


def test_empty_entries_of_a_fixed_mapping_map_nothing():
    node = device(0x60400010, 0, 0x60600008, 0, refuse=MAPPING_FIXED)
    transfers = run(node)
    assert transfers.adopted[0][1].objects == (CONTROLWORD, MODE)
    with pytest.raises(BootError, match=r"its own mapping \(0x6040:00\) lacks 0x6060:00"):
        run(device(0x60400010, 0, refuse=MAPPING_FIXED))


def test_further_objects_of_an_adopted_rpdo_are_kept_at_what_they_are():
    node = device(0x60400010, 0x60600008, 0x60FF0020, refuse=MAPPING_FIXED)
    node.objects[0x60FF, 0] = number(77)
    transfers = run(node)
    assert transfers.adopted[0][1].objects == (CONTROLWORD, MODE, MappedObject(0x60FF, 0, 32, DataType.UNSIGNED32))
    assert transfers.presets == {(0x60FF, 0): 77}


def test_an_object_that_another_rpdo_carries_keeps_its_type_and_its_value():
    other = PlannedPdo(2, 0x303, 255, (TARGET,))
    node = device(0x60400010, 0x60600008, 0x60FF0020, refuse=MAPPING_FIXED)
    transfers = run(node, rpdos=(LAYOUT, other))
    assert transfers.adopted[0][1].objects == (CONTROLWORD, MODE, TARGET)
    assert transfers.presets == {}


def test_a_fixed_mapping_that_lacks_an_object_leaves_the_pdo_invalid_and_names_it():
    node = device(0x60400010, refuse=MAPPING_FIXED)
    with pytest.raises(BootError) as caught:
        run(node)
    assert caught.value.letter == "J"
    assert "its own mapping (0x6040:00) lacks 0x6060:00; the PDO is invalid now" in str(caught.value)
    assert held(node)[0x1400, 1] & 0x80000000


def test_a_constant_cob_id_is_adopted_where_the_mapping_will_do():
    node = device(0x60400010, 0x60600008, cob_id=0x40000277, refuse={(0x1400, 1): READ_ONLY})
    layout = run(node).adopted[0][1]
    assert (layout.cob_id, layout.objects) == (0x277, LAYOUT.objects)


def test_a_refusal_half_way_puts_back_what_was_there():
    full = {(0x1600, 2): lambda node, data: WRONG_STATE if data == number(0x60600008) else 0}
    node = device(0x60400010, 0x60FF0020, refuse=full)
    with pytest.raises(BootError, match=r"its own mapping \(0x6040:00, 0x60FF:00\) lacks 0x6060:00"):
        run(node)
    assert held(node)[0x1600, 0] == 2
    assert held(node)[0x1600, 2] == 0x60FF0020
    assert held(node)[0x1400, 1] & 0x80000000


def test_a_mapping_that_is_taken_and_not_kept_is_not_a_success():
    node = device(0x60410010, clamp={(0x1600, 1): number(0x60410010)})
    with pytest.raises(BootError, match="0x1600:01 holds 0x60410010 after 0x60400010 was written"):
        run(node)


UNLISTED = [write(0x1400, 1, 0x80000203, reason="valid by default, but not configured", optional=True)]


def test_an_unlisted_pdo_is_switched_off_once():
    node = device(0x60400010)
    run(node, UNLISTED, rpdos=())
    assert held(node)[0x1400, 1] == 0xC0000203
    assert run(node, UNLISTED, rpdos=()).writes == 0


def test_an_unlisted_pdo_that_stays_live_is_reported_and_a_listed_one_that_does_is_an_error():
    stubborn = {(0x1400, 1): READ_ONLY}
    assert "remains valid" in run(device(0x60400010, refuse=stubborn), UNLISTED, rpdos=()).warnings[0]
    requested = [write(0x1400, 1, 0x80000203)]
    with pytest.raises(BootError, match="RPDO 1 cannot be made invalid"):
        run(device(0x60400010, refuse={**stubborn, (0x1600, 0): READ_ONLY}), requested, rpdos=())


def test_an_unlisted_pdo_that_keeps_an_impossible_cob_id_is_not_called_live():
    node = device(0x60400010, cob_id=0x180, refuse={(0x1400, 1): READ_ONLY})
    warnings = run(node, UNLISTED, rpdos=()).warnings
    assert "keeps the COB-ID 0x180, which is not allowed for PDOs" in warnings[0]
    assert "live" not in warnings[0]


def test_a_listed_pdo_that_cannot_be_made_invalid_is_off_by_an_empty_mapping():
    node = device(0x60400010, refuse={(0x1400, 1): READ_ONLY})
    assert "disabled by an empty mapping" in run(node, [write(0x1400, 1, 0x80000203)], rpdos=()).warnings[0]
    assert held(node)[0x1600, 0] == 0


@pytest.mark.parametrize("code", [READ_ONLY, 0x06040041, 0x06090030])
def test_a_cob_id_that_is_right_and_cannot_be_written_stays_and_the_mapping_is_written(code):
    node = device(0x60410010, refuse={(0x1400, 1): code})
    assert run(node).adopted == []
    assert [(index, subindex, int.from_bytes(data, "little")) for index, subindex, data in node.written] == [
        (0x1600, 0, 0),
        (0x1600, 1, 0x60400010),
        (0x1600, 2, 0x60600008),
        (0x1600, 0, 2),
    ]


def test_a_cob_id_that_is_another_one_and_cannot_be_written_is_named_with_its_key():
    node = device(0x60410010, cob_id=0x40000277, refuse={(0x1400, 1): READ_ONLY})
    with pytest.raises(BootError, match=r"set rpdo.1 `cob_id: 0x277` in bus.yml.*; the PDO is unchanged"):
        run(node)


FIXED = [*GROUP[1:5], write(0x1400, 1, 0x203, fixed=True)]


def test_a_cob_id_that_the_eds_has_as_read_only_is_not_written():
    node = device(0x60410010, refuse={(0x1400, 1): READ_ONLY})
    run(node, FIXED)
    assert [address[:2] for address in node.written] == [(0x1600, 0), (0x1600, 1), (0x1600, 2), (0x1600, 0)]


def test_a_drive_whose_eds_has_its_cob_id_as_read_only_and_that_needs_it_invalid_is_served_too():
    def valid(node, _data):
        return 0 if held(node)[0x1400, 1] & 0x80000000 else WRONG_STATE

    node = device(0x60410010, refuse={(0x1600, slot): valid for slot in range(9)})
    assert run(node, FIXED).warnings == []
    assert held(node)[0x1400, 1] & 0x80000000 == 0
    assert held(node)[0x1600, 2] == 0x60600008


def test_silence_names_the_pdo_and_the_object():
    node = device(0x60400010)
    node.silent = True
    with pytest.raises(BootError, match="RPDO 1: 0x1400:01: no answer within 1 s"):
        run(node)
