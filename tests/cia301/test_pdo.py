from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.services import MS, frame, vectors

from canopen_control.cia301.pdo import (
    DUMMY_TYPES,
    EMCY_OF,
    MappedObject,
    PdoCodec,
    PdoParameters,
    RpdoConsumer,
    RpdoEvent,
    RpdoEventKind,
    TpdoProducer,
    dummy,
    mapping_entry,
    parse_mapping_entry,
)
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import EXTENDED_FLAG, CanFrame
from canopen_control.od.model import DataType

SYNC = vectors()["sync"]


class Device:
    """A TPDO of one byte, whose value the test sets."""

    def __init__(self, transmission_type: int, **settings: object) -> None:
        self.value = 0
        self.samples = 0
        settings.setdefault("cob_id", 0x183)
        self.tpdo = TpdoProducer(PdoParameters(transmission_type=transmission_type, **settings), self.sample)
        self.tpdo.start(0)
        self.start = self.data()

    def sample(self) -> bytes:
        self.samples += 1
        return bytes((self.value,))

    def data(self) -> list[int]:
        return [f.data[0] for f in self.tpdo.frames()]

    def change(self, value: int, now: int) -> list[int]:
        self.value = value
        self.tpdo.changed(now)
        return self.data()


def sending_syncs(device: Device, counters: list[int | None]) -> list[int]:
    sent = []
    for number, counter in enumerate(counters, 1):
        device.tpdo.sync(number, counter)
        if device.data():
            sent.append(number)
    return sent


@pytest.mark.parametrize("transmission_type", [254, 255])
def test_an_event_driven_pdo_is_sent_at_start_and_on_every_change(transmission_type):
    device = Device(transmission_type)
    assert device.start == [0]
    assert [device.change(1, 10), device.change(2, 11)] == [[1], [2]]
    assert device.tpdo.next_deadline() is None


def test_the_inhibit_time_sends_the_newest_value_once_when_it_is_over():
    device = Device(255, inhibit_time_100us=10)
    device.tpdo.tick(MS)
    assert device.change(1, MS) == [1]
    assert device.change(2, MS + 1) == []
    assert device.change(3, 2 * MS - 1) == []
    assert device.tpdo.next_deadline() == 2 * MS
    device.tpdo.tick(2 * MS - 1)
    assert device.data() == []
    device.tpdo.tick(2 * MS)
    assert device.data() == [3]
    assert device.tpdo.next_deadline() is None


def test_the_event_timer_runs_from_the_last_transmission():
    device = Device(255, event_timer_ms=10)
    assert device.tpdo.next_deadline() == 10 * MS
    assert device.change(1, 4 * MS) == [1]
    device.tpdo.tick(14 * MS - 1)
    assert device.data() == []
    device.tpdo.tick(14 * MS)
    assert device.data() == [1]
    assert device.tpdo.next_deadline() == 24 * MS


def test_the_event_timer_waits_for_the_inhibit_time():
    device = Device(255, event_timer_ms=1, inhibit_time_100us=30)
    assert device.tpdo.next_deadline() == 3 * MS
    device.tpdo.tick(2 * MS)
    assert device.data() == []
    device.tpdo.tick(3 * MS)
    assert device.data() == [0]


def test_acyclic_synchronous_is_sent_at_the_sync_after_a_change_only():
    device = Device(0)
    assert device.start == []
    device.tpdo.sync(1)
    assert device.data() == []
    assert device.change(5, 2) == []
    device.value = 6
    device.tpdo.sync(3)
    device.tpdo.sync(4)
    assert device.data() == [6]


@pytest.mark.parametrize("every", [1, 2, 3, 4, 240])
def test_cyclic_synchronous_is_sent_every_nth_sync(every):
    device = Device(every)
    assert sending_syncs(device, [None] * 480) == list(range(every, 481, every))
    assert device.change(1, 0) == []


@pytest.mark.parametrize(("every", "group"), [(1, "tt1_overflow4_start3"), (2, "tt2_overflow4_start3")])
def test_the_start_value_is_the_vectors(every, group):
    device = Device(every, sync_start=3)
    counters: list[int | None] = [1, 2, 3, 4, 1, 2, 3, 4, 1, 2]
    sent = [counters[number - 1] for number in sending_syncs(device, counters)]
    expected = SYNC[group]["lely_sends_on_counter"]
    assert sent[: len(expected)] == expected


def test_a_start_value_without_a_counter_is_ignored():
    assert sending_syncs(Device(1, sync_start=3), [None] * 3) == [1, 2, 3]


def test_rtr_synchronous_answers_with_the_sample_of_the_last_sync():
    device = Device(252)
    device.tpdo.receive(frame("183#R1"), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 1)
    device.value = 7
    device.tpdo.sync(1)
    device.value = 8
    device.tpdo.receive(frame("183#R1"), 2)
    device.tpdo.receive(frame("183#R1"), 3)
    assert device.data() == [7, 7]


def test_rtr_event_answers_with_the_present_value():
    device = Device(253)
    device.value = 9
    device.tpdo.receive(frame("183#R1"), 0)
    device.tpdo.sync(1)
    assert device.change(1, 2) == [9]


@pytest.mark.parametrize("settings", [{"transmission_type": 255}, {"transmission_type": 253, "rtr_allowed": False}])
def test_other_types_do_not_answer_remote_frames(settings):
    device = Device(**settings)
    device.tpdo.receive(frame("183#R1"), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 1)


def test_foreign_frames_are_ignored():
    device = Device(253)
    for text in ("183#00", "184#R1", "080#"):
        device.tpdo.receive(frame(text), 0)
    assert (device.data(), device.tpdo.unanswered) == ([], 0)


def test_a_stopped_or_invalid_pdo_is_silent():
    device = Device(255, event_timer_ms=1, inhibit_time_100us=100)
    device.tpdo.changed(1)
    device.tpdo.stop()
    device.tpdo.stop()
    device.tpdo.tick(10**12)
    device.tpdo.sync(1)
    device.tpdo.changed(1)
    assert (device.data(), device.tpdo.next_deadline()) == ([], None)
    assert Device(255, enabled=False).start == []
    assert Device(243).change(1, 1) == []


def test_starting_again_clears_the_history():
    device = Device(2)
    device.tpdo.sync(1)
    device.tpdo.stop()
    device.tpdo.start(2)
    assert sending_syncs(device, [None, None]) == [2]


def test_new_parameters_count_at_once():
    device = Device(255)
    device.tpdo.configure(PdoParameters(0x283, transmission_type=1), 5)
    assert device.change(1, 6) == []
    device.tpdo.sync(7)
    assert device.tpdo.frames() == [CanFrame(0x283, b"\1")]
    assert device.tpdo.parameters.cob_id == 0x283
    device.tpdo.stop()
    device.tpdo.configure(PdoParameters(0x12345, transmission_type=255, extended=True), 8)
    assert device.tpdo.frames() == []
    device.tpdo.start(9)
    assert device.tpdo.frames() == [CanFrame(0x12345 | EXTENDED_FLAG, b"\1")]
    assert device.tpdo.sent == 3


KIND = RpdoEventKind


def running(transmission_type: int = 255, length: int = 3, **settings: int) -> RpdoConsumer:
    window_ns = settings.pop("window_ns", 0)
    rpdo = RpdoConsumer(
        PdoParameters(0x203, transmission_type=transmission_type, **settings), length, window_ns=window_ns
    )
    rpdo.start()
    return rpdo


def applied(rpdo: RpdoConsumer) -> list[str]:
    return [event.data.hex() for event in rpdo.events() if event.kind is KIND.APPLY]


@pytest.mark.parametrize("transmission_type", [0, 1, 240])
def test_a_synchronous_rpdo_is_held_until_the_next_sync_and_the_newest_counts(transmission_type):
    rpdo = running(transmission_type)
    assert not rpdo.holds
    rpdo.receive(frame("203#010000"), 0)
    rpdo.receive(frame("203#020000"), 1)
    assert rpdo.events() == []
    assert rpdo.holds
    rpdo.sync(2)
    assert not rpdo.holds
    rpdo.sync(3)
    assert applied(rpdo) == ["020000"]
    assert rpdo.received == 2


def test_short_data_are_dropped_and_reported():
    rpdo = running()
    rpdo.receive(frame("203#0F00"), 0)
    assert rpdo.events() == [RpdoEvent(KIND.TOO_SHORT, length=2)]
    assert (rpdo.short, rpdo.received, EMCY_OF[KIND.TOO_SHORT]) == (1, 0, 0x8210)


def test_of_long_data_the_mapped_part_counts_and_the_rest_is_reported():
    rpdo = running()
    rpdo.receive(frame("203#0F00030405"), 0)
    assert rpdo.events() == [RpdoEvent(KIND.TOO_LONG, length=5), RpdoEvent(KIND.APPLY, bytes.fromhex("0F0003"), 5)]
    assert (rpdo.long, EMCY_OF[KIND.TOO_LONG]) == (1, 0x8220)


def test_the_deadline_starts_with_the_first_data_and_is_reported_once():
    rpdo = running(event_timer_ms=10)
    assert rpdo.next_deadline() is None
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.tick(10 * MS - 1)
    assert applied(rpdo) == ["0f0003"]
    rpdo.tick(10 * MS)
    rpdo.tick(99 * MS)
    assert rpdo.events() == [RpdoEvent(KIND.TIMEOUT)]
    rpdo.receive(frame("203#0F0003"), 100 * MS)
    assert [event.kind for event in rpdo.events()] == [KIND.RESOLVED, KIND.APPLY]
    assert EMCY_OF[KIND.TIMEOUT] == 0x8250


def test_data_behind_the_deadline_do_not_hide_the_timeout():
    rpdo = running(event_timer_ms=1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.receive(frame("203#0F0003"), 2 * MS)
    assert [event.kind for event in rpdo.events()] == [KIND.APPLY, KIND.TIMEOUT, KIND.RESOLVED, KIND.APPLY]


def test_synchronous_data_outside_the_window_are_dropped_and_counted():
    rpdo = running(1, window_ns=50)
    rpdo.sync(100)
    rpdo.receive(frame("203#010000"), 150)
    rpdo.receive(frame("203#020000"), 151)
    rpdo.sync(200)
    assert (applied(rpdo), rpdo.late) == (["010000"], 1)


@pytest.mark.parametrize("settings", [{"enabled": False}, {"transmission_type": 243}, {"transmission_type": 252}])
def test_an_invalid_rpdo_is_deaf(settings):
    rpdo = running(**settings)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.sync(1)
    assert rpdo.events() == []


def test_stopping_clears_held_data_and_deadline():
    rpdo = running(1, event_timer_ms=1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.stop()
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.sync(1)
    rpdo.tick(10**12)
    assert (rpdo.events(), rpdo.next_deadline()) == ([], None)


def test_new_parameters_and_length_count_at_once():
    rpdo = running(1)
    rpdo.receive(frame("203#0F0003"), 0)
    rpdo.configure(PdoParameters(0x303, transmission_type=255), 2)
    rpdo.sync(1)
    rpdo.receive(frame("303#0F00"), 2)
    assert (applied(rpdo), rpdo.parameters.cob_id) == (["0f00"], 0x303)


@pytest.mark.parametrize(
    ("kind", "data", "settings"),
    [
        (1, "010203", {}),
        (255, "010203", {}),
        (1, "0102", {}),
        (1, "01020304", {}),
        (1, "010203", {"event_timer_ms": 5}),
        (1, "010203", {"window_ns": 5 * MS}),
        (1, "010203", {"enabled": False}),
    ],
)
def test_an_unchecked_frame_gives_the_same_result_as_a_checked_one(kind, data, settings):
    looked, held = running(kind, **settings), running(kind, **settings)
    looked.receive(frame(f"203#{data}"), 0)
    usual = kind == 1 and data == "010203" and not settings
    assert held.hold(bytes.fromhex(data)) is usual
    if not usual:
        assert (held.received, held.holds, held.events()) == (0, False, [])
        held.receive(frame(f"203#{data}"), 0)
    for rpdo in (looked, held):
        rpdo.sync(1)
    assert (held.received, held.events()) == (looked.received, looked.events())


def test_no_frame_is_applied_unchecked_after_a_wrong_length_or_before_the_start():
    rpdo = running(1)
    rpdo.receive(frame("203#0102"), 0)
    assert not rpdo.hold(b"123")
    rpdo.receive(frame("203#010203"), 1)
    assert rpdo.hold(b"123")
    rpdo.stop()
    assert not rpdo.hold(b"123")


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
    expected = int(text or "0", 2).to_bytes(length, "little")
    one = codec(*fields)
    assert one.length == length
    assert one.pack(values) == expected
    assert one.unpack(expected + b"\xff") == tuple(values)


@given(mappings(), st.binary(min_size=8, max_size=8))
def test_any_data_round_trips_except_for_unmapped_bits(fields, data):
    one = codec(*fields)
    used = (1 << one.bits) - 1
    again = int.from_bytes(one.pack(one.unpack(data)), "little")
    assert again == int.from_bytes(data, "little") & used


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
