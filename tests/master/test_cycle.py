import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canopen_control.cia301.pdo import MappedObject, PdoCodec
from canopen_control.errors import LocalProtocolError
from canopen_control.frame import RECORD, RECORD_SIZE, frames_of
from canopen_control.master.cycle import Output, ProcessImage, SentPdo
from canopen_control.master.plan_builder import PlannedPdo
from canopen_control.master.supervision import PdoWatch
from canopen_control.od.model import DataType

CONTROLWORD = MappedObject(0x6040, 0, 16, DataType.UNSIGNED16)
MODE = MappedObject(0x6060, 0, 8, DataType.INTEGER8)
TARGET_VELOCITY = MappedObject(0x60FF, 0, 32, DataType.INTEGER32)
POSITION = MappedObject(0x6064, 0, 32, DataType.INTEGER32)
VELOCITY = MappedObject(0x606C, 0, 32, DataType.INTEGER32)


def image_with_two_controlwords(**how):
    image = ProcessImage(refresh=5)
    first = image.add_rpdo(3, 0x203, [CONTROLWORD, MODE], **how)
    second = image.add_rpdo(3, 0x303, [CONTROLWORD, TARGET_VELOCITY], **how)
    first.enabled = second.enabled = True
    image.output(3, 0x6040).drive()
    return image


def sent(image):
    return [(frame.can_id, frame.data) for frame in frames_of(image.collect())]


def test_a_received_pdo_gives_signed_values_and_their_age():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x283, [POSITION, VELOCITY])
    position = image.input(3, 0x6064)
    assert not position.fresh
    assert position.age_ns(10) is None
    pdo.receive(bytes.fromhex("18FCFFFF00C80000"), 8, 100)
    assert (position.value, image.input(3, 0x606C).value) == (-1000, 51200)
    assert position.age_ns(150) == 50


def test_a_short_frame_changes_nothing_but_a_counter():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x283, [POSITION, VELOCITY])
    pdo.receive(bytes(8), 7, 100)
    assert (pdo.short, pdo.count, pdo.stamp) == (1, 0, -1)


def test_a_long_frame_is_taken_and_counted():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x183, [MappedObject(0x6041, 0, 16, DataType.UNSIGNED16)])
    pdo.receive(bytes.fromhex("3706FFFFFFFFFFFF"), 8, 5)
    assert pdo.long == 1
    assert image.input(3, 0x6041).value == 0x0637


def test_all_rpdos_that_carry_the_controlword_carry_the_same_one():
    image = image_with_two_controlwords()
    image.output(3, 0x6040).set(0x0F)
    image.output(3, 0x6060).set(3)
    assert sent(image) == [(0x203, bytes.fromhex("0F0003")), (0x303, bytes.fromhex("0F0000000000"))]


def test_only_what_changed_is_sent_and_the_rest_again_after_a_while():
    image = image_with_two_controlwords()
    assert len(sent(image)) == 2
    image.output(3, 0x60FF).set(-2)
    assert sent(image) == [(0x303, bytes.fromhex("0000FEFFFFFF"))]
    image.output(3, 0x60FF).set(-2)
    silent = [len(sent(image)) for _ in range(3)]
    assert silent == [0, 0, 0]
    assert [can_id for can_id, _ in sent(image)] == [0x203]
    assert [can_id for can_id, _ in sent(image)] == [0x303]


def test_cyclic_synchronous_rpdos_are_sent_every_cycle():
    image = image_with_two_controlwords(transmission_type=1)
    assert [len(sent(image)) for _ in range(3)] == [2, 2, 2]


def test_a_node_that_is_not_operational_is_sent_nothing():
    image = image_with_two_controlwords()
    for pdo in image.outputs:
        pdo.enabled = False
    image.output(3, 0x6040).set(0x0F)
    assert sent(image) == []
    for pdo in image.outputs:
        pdo.enabled = True
    assert len(sent(image)) == 2, "what changed meanwhile is sent once the node is there"


def test_sync_comes_after_the_rpdos():
    image = image_with_two_controlwords()
    records = image.collect(RECORD.pack(0x80, 0, b""))
    assert [frame.can_id for frame in frames_of(records)] == [0x203, 0x303, 0x080]
    assert len(records) == 3 * RECORD_SIZE


def test_an_object_that_no_pdo_carries_has_no_place():
    image = ProcessImage()
    assert image.input(3, 0x6041) is None
    assert image.output(3, 0x6040) is None


def test_a_lost_node_is_not_fresh_any_more():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x283, [POSITION, VELOCITY])
    pdo.receive(bytes(8), 8, 100)
    pdo.forget()
    assert not image.input(3, 0x6064).fresh


def test_a_tpdo_in_the_nodes_own_order_gives_the_planned_one():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x283, [POSITION, VELOCITY], 1)
    position, velocity = image.input(3, 0x6064), image.input(3, 0x606C)
    pdo.use(PlannedPdo(2, 0x277, 2, (VELOCITY, POSITION)), [POSITION, VELOCITY])
    pdo.receive((7).to_bytes(4, "little") + (-9).to_bytes(4, "little", signed=True), 8, 5)
    assert (position.value, velocity.value) == (-9, 7)
    assert (pdo.cob_id, pdo.every) == (0x277, 2)
    pdo.use(PlannedPdo(2, 0x283, 1, (POSITION, VELOCITY)), [POSITION, VELOCITY])
    pdo.receive((1).to_bytes(4, "little") + (2).to_bytes(4, "little"), 8, 6)
    assert (position.value, velocity.value) == (1, 2)


def test_a_tpdo_that_comes_by_events_is_never_overdue():
    image = ProcessImage()
    pdo = image.add_tpdo(3, 0x283, [POSITION], 1)
    watch = PdoWatch()
    watch.add(pdo)
    pdo.use(PlannedPdo(2, 0x283, 255, (POSITION,)), [POSITION])
    pdo.expected = True
    assert not any(watch.sync() for _ in range(1000))


def test_an_rpdo_in_the_nodes_own_order_is_sent_in_it_with_shared_values():
    image = image_with_two_controlwords()
    first = image.outputs[0]
    own = (MODE, CONTROLWORD, TARGET_VELOCITY)
    first.use(PlannedPdo(1, 0x277, 1, own), image.outputs_of(3, own))
    image.output(3, 0x6040).set(0x0F)
    image.output(3, 0x6060).set(3)
    image.output(3, 0x60FF).set(-1)
    assert sent(image)[0] == (0x277, b"\x03\x0f\0\xff\xff\xff\xff")
    assert [can_id for can_id, _ in sent(image)] == [0x277]  # cyclic now, the other one has not changed


def test_an_rpdo_in_the_nodes_own_order_leaves_nothing_of_the_planned_one():
    image = image_with_two_controlwords()
    own = (MODE, CONTROLWORD)
    image.outputs[1].use(PlannedPdo(1, 0x277, 1, own), image.outputs_of(3, own))
    sent(image)
    image.output(3, 0x60FF).set(7)  # no PDO carries it any more
    image.output(3, 0x6040).set(6)
    assert sent(image) == [(0x203, b"\6\0\0"), (0x277, b"\0\6\0")]


def test_a_value_that_does_not_fit_leaves_the_record_as_it_was():
    image = image_with_two_controlwords()
    image.output(3, 0x6040).set(0x0F)
    before = sent(image)
    image.output(3, 0x6040).set(1 << 16)
    with pytest.raises(LocalProtocolError, match="cannot be packed"):
        image.collect()
    assert image.outputs[0].record == RECORD.pack(0x203, 3, before[0][1])


def test_process_data_begin_with_what_the_node_reports():
    image = image_with_two_controlwords()
    image.add_tpdo(3, 0x283, [POSITION, VELOCITY])
    image.preset(3, {(0x6060, 0): 3, (0x6064, 0): -5, (0x5999, 0): 1})
    assert image.output(3, 0x6060).value == 3
    position = image.input(3, 0x6064)
    assert (position.value, position.fresh) == (-5, False)


_WIDTHS = (
    (DataType.UNSIGNED8, 8), (DataType.INTEGER8, 8), (DataType.UNSIGNED16, 16), (DataType.INTEGER16, 16),
    (DataType.UNSIGNED32, 32), (DataType.INTEGER32, 32), (DataType.BOOLEAN, 1), (DataType.UNSIGNED8, 4),
)  # fmt: skip
_mappings = st.lists(st.sampled_from(_WIDTHS), max_size=8).filter(lambda found: sum(bits for _, bits in found) <= 64)


@given(_mappings, st.lists(st.integers(-(1 << 33), 1 << 33), min_size=8, max_size=8))
def test_a_record_is_its_identifier_its_length_and_what_the_codec_packs(mapping, values):
    objects = [MappedObject(0x2000 + number, 0, bits, kind) for number, (kind, bits) in enumerate(mapping)]
    outputs = [Output() for _ in objects]
    pdo = SentPdo(0x203, objects, outputs, cyclic=True)
    before = pdo.record
    for output, value in zip(outputs, values, strict=False):
        output.set(value)
    pdo.changed = True
    try:
        data = PdoCodec(objects).pack(values[: len(objects)])
    except LocalProtocolError as error:
        with pytest.raises(LocalProtocolError, match=re.escape(str(error))):
            pdo.pack()
        assert (pdo.record, pdo.changed) == (before, True)
    else:
        pdo.pack()
        assert pdo.record == RECORD.pack(0x203, len(data), data)
        assert not pdo.changed


@pytest.mark.parametrize(("data_type", "signed"), [(DataType.UNSIGNED64, False), (DataType.INTEGER64, True)])
@pytest.mark.parametrize("taken", [False, True])
def test_a_tpdo_with_one_object_of_64_bits_is_decoded_from_its_first_byte_on(data_type, signed, taken):
    image = ProcessImage()
    objects = [MappedObject(0x2000, 0, 64, data_type)]
    pdo = image.add_tpdo(9, 0x189, objects, 1)
    if taken:  # as the node has it
        pdo.use(PlannedPdo(1, 0x189, 1, tuple(objects)), objects)
    for value in (0x0123456789ABCDEF, 1, 1 << 56, -2 if signed else (1 << 64) - 1):
        pdo.receive(value.to_bytes(8, "little", signed=signed), 8, 1)
        assert image.input(9, 0x2000).value == value


def test_an_rpdo_with_a_deadline_is_repeated_in_half_of_it_and_another_one_as_before():
    image = ProcessImage(refresh=10)
    watched, other = image.add_rpdo(3, 0x203, [CONTROLWORD], deadline=10), image.add_rpdo(4, 0x204, [CONTROLWORD])
    for pdo, node_id in ((watched, 3), (other, 4)):
        image.output(node_id, 0x6040).drive()
        pdo.start()
    sent = [[item.count for item in (watched, other)] for _ in range(21) if image.collect() is not None]
    assert sent[-1] == [5, 3]


def test_an_output_with_a_deadline_is_repeated_once_it_was_written():
    image = ProcessImage(refresh=10)
    pdo = image.add_rpdo(3, 0x203, [CONTROLWORD], deadline=6)
    pdo.start()
    for _ in range(10):
        image.collect()
    assert pdo.count == 0
    image.output(3, 0x6040).write(1)
    for _ in range(9):
        image.collect()
    assert pdo.count == 3
