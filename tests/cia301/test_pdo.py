from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.services import vectors

from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    MappedObject,
    PdoCodec,
    PdoParameters,
    dummy,
    is_cyclic,
    is_event_driven,
    is_reserved,
    mapping_entry,
    parse_mapping_entry,
)
from canopen_control.errors import LocalProtocolError
from canopen_control.od.model import DataType

TYPES = {
    0x0006: DataType.UNSIGNED16,
    0x2000: DataType.UNSIGNED8,
    0x6040: DataType.UNSIGNED16,
    0x6041: DataType.UNSIGNED16,
    0x6060: DataType.INTEGER8,
    0x6061: DataType.INTEGER8,
    0x6064: DataType.INTEGER32,
    0x606C: DataType.INTEGER32,
    0x607A: DataType.INTEGER32,
    0x60FF: DataType.INTEGER32,
}
INTEGERS = [
    t for t in DataType if t.is_integer and t.bits and t not in (DataType.TIME_OF_DAY, DataType.TIME_DIFFERENCE)
]


def mapped(bits: int, data_type: DataType) -> MappedObject:
    return MappedObject(0x2000, 1, bits, data_type)


def codec(*fields: tuple[int, DataType]) -> PdoCodec:
    return PdoCodec([mapped(bits, data_type) for bits, data_type in fields])


def objects_of(vector: dict) -> list[MappedObject]:
    entries = [parse_mapping_entry(int(entry, 16)) for entry in vector["mapping"]]
    return [MappedObject(index, subindex, bits, TYPES[index]) for index, subindex, bits in entries]


@pytest.mark.parametrize("vector", vectors()["pdo_packing"], ids=lambda v: v["name"])
def test_packing_is_the_vectors_both_ways(vector):
    objects = objects_of(vector)
    assert [mapping_entry(entry) for entry in objects] == [int(text, 16) for text in vector["mapping"]]
    codec = PdoCodec(objects)
    data = bytes.fromhex(vector["data"])
    assert codec.length == len(data)
    assert codec.pack(vector["values"]) == data
    assert codec.unpack(data) == tuple(vector["values"])


def test_standard_widths_are_compiled_and_others_are_not():
    assert codec((16, DataType.UNSIGNED16), (8, DataType.INTEGER8), (32, DataType.REAL32)).struct is not None
    assert codec((8, DataType.UNSIGNED32)).struct is not None
    assert codec((1, DataType.BOOLEAN)).struct is None
    assert codec((24, DataType.INTEGER24)).struct is None
    assert codec((4, DataType.UNSIGNED8), (32, DataType.INTEGER32)).struct is None


@pytest.mark.parametrize(
    ("bits", "data_type", "value", "data"),
    [
        (4, DataType.INTEGER8, -8, "08"),
        (4, DataType.INTEGER8, -7, "09"),
        (4, DataType.INTEGER8, 7, "07"),
        (1, DataType.BOOLEAN, 1, "01"),
        (8, DataType.BOOLEAN, 1, "01"),
        (24, DataType.INTEGER24, -1, "FFFFFF"),
        (24, DataType.INTEGER24, -(1 << 23), "000080"),
        (40, DataType.INTEGER40, -2, "FEFFFFFFFF"),
        (48, DataType.INTEGER48, -(1 << 47), "000000000080"),
        (56, DataType.UNSIGNED56, (1 << 56) - 1, "FFFFFFFFFFFFFF"),
        (64, DataType.INTEGER64, -(1 << 63), "0000000000000080"),
        (8, DataType.UNSIGNED32, 200, "C8"),
        (32, DataType.REAL32, 1.5, "0000C03F"),
        (64, DataType.REAL64, -2.0, "00000000000000C0"),
        (48, DataType.TIME_OF_DAY, 0x1234_00000001, "010000003412"),
        (24, DataType.VISIBLE_STRING, b"abc", "616263"),
        (64, DataType.DOMAIN, bytes(range(8)), "0001020304050607"),
    ],
)
def test_each_type_both_ways(bits, data_type, value, data):
    one = codec((bits, data_type))
    assert one.pack([value]) == bytes.fromhex(data)
    assert one.unpack(bytes.fromhex(data)) == (value,)


def test_a_real_behind_a_bit_is_read_by_bits():
    two = codec((1, DataType.BOOLEAN), (32, DataType.REAL32))
    assert two.unpack(two.pack([1, -0.25])) == (1, -0.25)


def test_a_word_that_crosses_bytes_keeps_its_top_nibble():
    three = codec((4, DataType.UNSIGNED8), (16, DataType.UNSIGNED16), (4, DataType.UNSIGNED8))
    assert three.pack([0xA, 0xFCDA, 0x5]) == bytes.fromhex("AACD5F")
    assert three.unpack(bytes.fromhex("AACD5F")) == (0xA, 0xFCDA, 0x5)


@pytest.mark.parametrize(
    ("fields", "values"),
    [
        ([(8, DataType.UNSIGNED8)], [256]),
        ([(8, DataType.INTEGER8)], [-129]),
        ([(4, DataType.INTEGER8)], [8]),
        ([(4, DataType.INTEGER8)], [-9]),
        ([(4, DataType.UNSIGNED8)], [-1]),
        ([(1, DataType.BOOLEAN)], [2]),
        ([(16, DataType.UNSIGNED16)], [1.5]),
        ([(4, DataType.UNSIGNED8)], [1.0]),
        ([(16, DataType.UNSIGNED16)], []),
        ([(4, DataType.UNSIGNED8)], [1, 2]),
        ([(24, DataType.VISIBLE_STRING)], [b"toolong"]),
        ([(24, DataType.VISIBLE_STRING)], ["abc"]),
        ([(32, DataType.REAL32)], ["x"]),
        ([(1, DataType.BOOLEAN), (32, DataType.REAL32)], [1, "x"]),
        ([(1, DataType.BOOLEAN), (32, DataType.REAL32)], [1, 1e300]),
        ([(32, DataType.REAL32)], [1e300]),
    ],
)
def test_a_value_that_does_not_fit_is_refused(fields, values):
    with pytest.raises(LocalProtocolError):
        codec(*fields).pack(values)


@pytest.mark.parametrize(
    "fields",
    [
        [(32, DataType.INTEGER32), (32, DataType.INTEGER32), (1, DataType.BOOLEAN)],
        [(0, DataType.UNSIGNED8)],
        [(16, DataType.REAL32)],
        [(12, DataType.VISIBLE_STRING)],
    ],
)
def test_an_impossible_mapping_is_refused(fields):
    with pytest.raises(LocalProtocolError):
        codec(*fields)


def test_too_few_bytes_are_refused_and_more_are_ignored():
    one = codec((16, DataType.UNSIGNED16))
    with pytest.raises(LocalProtocolError, match="check the length"):
        one.unpack(b"\1")
    assert one.unpack(memoryview(b"\1\0\xff")) == (1,)


def test_an_empty_mapping_has_no_bytes():
    empty = PdoCodec([])
    assert (empty.length, empty.pack([]), empty.unpack(b"")) == (0, b"", ())


@st.composite
def mappings(draw: st.DrawFn) -> list[tuple[int, DataType]]:
    fields: list[tuple[int, DataType]] = []
    left = 64
    while left and draw(st.booleans()):
        data_type = draw(st.sampled_from(INTEGERS))
        bits = draw(st.one_of(st.just(data_type.bits), st.integers(1, 64)))
        if bits is None or bits > left:
            break
        fields.append((bits, data_type))
        left -= bits
    return fields


@given(mappings(), st.data())
def test_any_mapping_agrees_with_a_string_of_bits(fields, data):
    values = [
        data.draw(st.integers(-(1 << bits - 1), (1 << bits - 1) - 1) if t.signed else st.integers(0, (1 << bits) - 1))
        for bits, t in fields
    ]
    # the reference: every value in two's complement as text, the last object leftmost
    text = "".join(
        format(v % (1 << bits), f"0{bits}b") for v, (bits, _) in reversed(list(zip(values, fields, strict=True)))
    )
    length = (len(text) + 7) // 8
    wanted = int(text or "0", 2).to_bytes(length, "little")
    one = codec(*fields)
    assert one.length == length
    assert one.pack(values) == wanted
    assert one.unpack(wanted + b"\xff") == tuple(values)


@given(mappings(), st.binary(min_size=8, max_size=8))
def test_any_data_come_back_but_for_the_bits_nobody_mapped(fields, data):
    one = codec(*fields)
    used = (1 << one.bits) - 1
    again = int.from_bytes(one.pack(one.unpack(data)), "little")
    assert again == int.from_bytes(data, "little") & used


def test_the_compiled_form_is_for_the_cycle():
    two = codec((16, DataType.UNSIGNED16), (32, DataType.INTEGER32))
    assert isinstance(two.struct, struct.Struct)
    assert two.struct.unpack_from(b"\0\1\0\2\0\0\0", 1) == two.unpack(b"\1\0\2\0\0\0")


def test_dummies_are_the_seven_types():
    assert dummy(DataType.UNSIGNED16) == MappedObject(6, 0, 16, DataType.UNSIGNED16)
    assert sorted(DUMMY_TYPES) == [1, 2, 3, 4, 5, 6, 7]
    with pytest.raises(LocalProtocolError):
        dummy(DataType.REAL32)


@pytest.mark.parametrize("vector", vectors()["cob_ids"]["cob_id_words"], ids=lambda v: v["value"])
def test_cob_id_entries_are_the_vectors_both_ways(vector):
    value = int(vector["value"], 16)
    parameters = PdoParameters.from_value(value, transmission_type=1)
    assert (parameters.enabled, parameters.rtr_allowed, parameters.extended, parameters.cob_id) == (
        vector["valid"],
        vector["rtr_allowed"],
        vector["extended"],
        int(vector["can_id"], 16),
    )


def test_times_are_in_nanoseconds():
    parameters = PdoParameters(0x183, inhibit_time_100us=15, event_timer_ms=20)
    assert (parameters.inhibit_ns, parameters.event_ns) == (1_500_000, 20_000_000)


def test_transmission_types():
    assert [t for t in range(-1, 257) if is_reserved(t)] == [-1, *range(241, 252), 256]
    assert [t for t in range(256) if is_cyclic(t)] == list(range(1, 241))
    assert [t for t in range(256) if is_event_driven(t)] == [254, 255]
