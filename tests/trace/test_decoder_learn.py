from hypothesis import given
from hypothesis import strategies as st
from support.robots import Bench
from support.tracing import frame, robby_decoder, said

from canopen_control.cia301.pdo import INVALID_BIT
from canopen_control.frame import EXTENDED_FLAG, is_restricted
from canopen_control.trace.decoder import LIMIT, Decoder, LearnedPdos
from canopen_control.trace.network_description import NetworkDescription, NodeDescription, pdo_name
from canopen_control.trace.values import NodeWords, SignalValue


def learner():
    node = NodeDescription("", 3)
    return LearnedPdos(node, NodeWords(node))


def held(index, subindex, value):
    return SignalValue(index, subindex, "", value, "")


MAP = [held(0x1A00, 1, 0x60410010), held(0x1A00, 2, 0x606C0020), held(0x1A00, 0, 2)]


def taught(values, pdos=None):
    pdos = pdos or learner()
    return [known for known in map(pdos.learn, values) if known is not None]


def test_a_pdo_is_known_when_it_is_valid_and_all_its_objects_were_received():
    ((pdo, before),) = taught([*MAP, held(0x1800, 2, 1), held(0x1800, 1, 0x40000183)])
    assert (pdo_name(pdo), pdo.cob_id, pdo.transmission_type, before) == ("TPDO1", 0x183, 1, None)
    assert [(item.name, item.bits, item.data_type) for item in pdo.objects] == [
        ("statusword", 16, "UNSIGNED16"),
        ("velocity actual", 32, "INTEGER32"),
    ]


def test_what_is_off_or_in_part_or_impossible_is_not_known():
    assert taught([*MAP, held(0x1800, 1, INVALID_BIT | 0x183)]) == []
    assert taught([MAP[0], MAP[2], held(0x1800, 1, 0x183)]) == []
    assert taught([*MAP, held(0x1800, 1, 0x603)]) == []  # the SDO of node 3
    assert taught([held(0x1A00, 1, 0x20000040), held(0x1A00, 2, 0x20010008), MAP[2], held(0x1800, 1, 0x183)]) == []
    assert taught([*MAP[:2], held(0x1A00, 0, 254), held(0x1800, 1, 0x183)]) == []  # multiplexed


def test_the_layout_of_a_robot_is_learned_from_its_boot_alone():
    bench, decoder, reported = Bench("learn"), Decoder(NetworkDescription()), robby_decoder()
    bench.start()
    bench.hold(1.0, -2.0, ms=200)
    frames = [each for _, each in bench.bus.history]
    bench.close()
    pairs = [(decoder.decode(item), reported.decode(item)) for item in frames]
    pdos = [(ours, theirs) for ours, theirs in pairs if theirs.service == "pdo"]
    assert len(pdos) > 50
    assert [[value.value for value in ours.values] for ours, _ in pdos] == [
        [value.value for value in theirs.values] for _, theirs in pdos
    ]
    assert {ours.subject for ours, _ in pdos} == {"RPDO1", "RPDO2", "TPDO1", "TPDO2"}


def test_what_a_node_refuses_is_not_learned():
    decoder = robby_decoder()
    said(decoder, (0x603, "23001801FD010000"), (0x583, "8000180130000906"))
    assert decoder.decode(frame(0x183, "370603")).subject == "TPDO1"
    assert decoder.decode(frame(0x1FD, "370603")).text == "mapping unknown"


def test_what_was_received_wins_over_the_description():
    decoder = robby_decoder()
    said(decoder, (0x603, "23001801FD010000"), (0x583, "6000180100000000"))
    assert decoder.decode(frame(0x1FD, "370603")).text.startswith("Statusword 0x0637")
    assert decoder.decode(frame(0x183, "370603")).text == "mapping unknown"


RECORDS = st.sampled_from([0x1400, 0x1401, 0x1600, 0x1601, 0x1800, 0x1A00])
VALUES = st.sampled_from([0, 1, 2, 0x183, 0x603, 0x60410010, 0x606C0020, 0x20000040]) | st.integers(0, 0xFFFFFFFF)


@given(st.lists(st.tuples(RECORDS | st.integers(0x1400, 0x1BFF), st.integers(0, 3), VALUES), max_size=50))
def test_whatever_a_node_holds_what_is_known_could_be_on_the_bus(values):
    for pdo, _ in taught([held(*value) for value in values]):
        assert pdo.direction in ("rpdo", "tpdo")
        assert 1 <= pdo.number <= 512
        assert 0 < len(pdo.objects) <= 64
        assert sum(item.bits for item in pdo.objects) <= 64
        assert pdo.cob_id & EXTENDED_FLAG or not is_restricted(pdo.cob_id)


def test_what_is_remembered_has_an_end():
    pdos = learner()
    taught([held(index, sub, 1) for index in range(0x1600, 0x1620) for sub in range(256)], pdos)
    assert len(pdos._held) == LIMIT
