import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.tracing import check_transcript, frame, robby_decoder, robby_network

from canopen_control.frame import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, CanFrame
from canopen_control.rpc.messages.fault import FaultEvent
from canopen_control.rpc.messages.layout import MappedEntry, PdoLayout
from canopen_control.trace.decoder import SERVICES, Decoder, Mark, lss_text
from canopen_control.trace.network_description import NetworkDescription, NodeDescription


def one(can_id, data="", decoder=None):
    return (decoder or robby_decoder()).decode(frame(can_id, data), 5)


LINES = [
    (0x000, "0103", "nmt", "left_drive", "START, node 3 (left_drive)", Mark.NOTABLE),
    (0x000, "8200", "nmt", "", "RESET COMMUNICATION, all nodes", Mark.NOTABLE),
    (0x000, "FF03", "nmt", "", "unknown NMT command", Mark.WARNING),
    (0x080, "", "sync", "", "", Mark.PLAIN),
    (0x080, "07", "sync", "", "counter 7", Mark.PLAIN),
    (0x703, "00", "hb", "left_drive", "boot-up", Mark.NOTABLE),
    (0x701, "05", "hb", "master", "OPERATIONAL", Mark.PLAIN),
    (0x701, "05 05", "hb", "master", "malformed: 05 05", Mark.WARNING),
    (0x702, "85", "hb", "right_drive", "OPERATIONAL, toggle 1", Mark.PLAIN),
    (
        *(0x083, "1186210100000000", "emcy", "left_drive"),
        "0x8611 (following error), register 0x21 (generic, device profile), data 01 00 00 00 00",
        Mark.ERROR,
    ),
    (0x083, "0000000000000000", "emcy", "left_drive", "0x0000 (error reset or no error), register 0x00", Mark.NOTABLE),
    (0x083, "11", "emcy", "left_drive", "malformed: 1 bytes", Mark.WARNING),
    (0x100, "0000000001 00", "time", "", "1984-01-02 00:00:00.000", Mark.PLAIN),
    (0x7E5, "0401", "lss", "", "all switch to configuration", Mark.PLAIN),
    (0x7E4, "1100", "lss", "", "node-ID: accepted", Mark.PLAIN),
    (0x385, "11", "pdo", "", "mapping unknown", Mark.PLAIN),
    (0x6FF, "00", "raw", "", "no CANopen service has this identifier", Mark.PLAIN),
    (EXTENDED_FLAG | 0x183, "00", "raw", "", "29-bit identifier of no known PDO", Mark.PLAIN),
    (REMOTE_FLAG | 0x703, "00", "hb", "left_drive", "guarding request", Mark.PLAIN),
    (REMOTE_FLAG | 0x183, "", "pdo", "left_drive", "request for TPDO1", Mark.PLAIN),
    (*(ERROR_FLAG | 0x40, "", "error", ""), "bus-off; check the cable, the terminators and the bit rate", Mark.ERROR),
    (ERROR_FLAG | 0x08, "", "error", "", "bus error: a frame was disturbed", Mark.WARNING),
]


@pytest.mark.parametrize(("can_id", "data", "service", "node", "text", "mark"), LINES)
def test_every_service_has_its_words(can_id, data, service, node, text, mark):
    got = one(can_id, data)
    assert (got.service, got.node, got.text, got.mark) == (service, node, text, mark)
    assert (got.time, got.can_id, got.data) == (5, can_id, bytes.fromhex(data))


def test_a_pdo_is_read_by_name_and_type():
    got = one(0x283, "FFFFFFFF40060000")
    assert got.subject == "TPDO2"
    assert [(item.name, item.value) for item in got.values] == [
        ("Position actual value", -1),
        ("Velocity actual value", 1600),
    ]
    assert got.text == "Position actual value -1; Velocity actual value 1600"


def test_the_words_of_the_drive_profile_depend_on_what_was_received_before():
    check_transcript("""
        183#371603 Statusword 0x1637 OPERATION ENABLED, target reached, speed is zero; Modes of operation display 3 PV
        203#070003 Controlword 0x0007 DISABLE OPERATION; Modes of operation 3 PV
        203#0F0003 Controlword 0x000F ENABLE OPERATION; Modes of operation 3 PV
        203#800003 Controlword 0x0080 FAULT RESET; Modes of operation 3 PV
        203#8F0003 Controlword 0x008F FAULT RESET held; Modes of operation 3 PV
    """)


def test_news_of_a_drive_are_marked_once():
    decoder = robby_decoder()
    frames = ["310603", "310603", "370603", "370604", "180604", "180204", "500604"]
    assert [decoder.decode(frame(0x183, item)).mark for item in frames] == [
        Mark.NOTABLE,
        Mark.PLAIN,
        Mark.NOTABLE,
        Mark.NOTABLE,  # another mode
        Mark.ERROR,
        Mark.PLAIN,
        Mark.NOTABLE,
    ]


def test_a_frame_that_shows_a_fault_has_it_for_programs():
    decoder = robby_decoder()
    faults = [decoder.decode(frame(0x183, data)).fault for data in ("370603", "180603", "180603", "500603")]
    assert faults == [None, FaultEvent(statusword=0x0618), None, None]
    emergency, end = (one(0x083, data).fault for data in ("1186210100000000", "0000000000000000"))
    assert emergency == FaultEvent(0x8611, 0x21, "0100000000")
    assert end.is_over


def test_a_short_pdo_is_reported_and_a_long_one_is_read():
    short, long = one(0x183, "3706"), one(0x183, "37060300")
    assert (short.text, short.values, short.mark) == ("too short: 2 bytes, 3 are mapped", (), Mark.WARNING)
    assert long.text.endswith("; 4 bytes, 3 are mapped")
    assert len(long.values) == 2


def test_a_heartbeat_reports_what_was_before_when_it_changes():
    check_transcript("""
        703#00 boot-up
        703#7F PRE-OPERATIONAL (after boot-up)
        703#7F PRE-OPERATIONAL
        703#05 OPERATIONAL (was PRE-OPERATIONAL)
    """)


def beats(*times_ms):
    decoder = robby_decoder()
    return [decoder.decode(frame(0x703, "05"), round(ms * 1_000_000)) for ms in times_ms]


def test_a_heartbeat_after_a_silence_reports_how_long_it_was():
    reported = beats(0, 100, 200, 301, 3301, 3400)
    assert [item.text for item in reported[3:]] == [
        "OPERATIONAL",
        "OPERATIONAL (after 3.00 s of silence)",
        "OPERATIONAL",
    ]
    assert reported[4].mark is Mark.WARNING


def test_heartbeats_that_were_read_late_together_are_not_silence():
    assert {beat.text for beat in beats(0, 100, 100.1, 200, 200.1, 380, 400, 2000, 3600)[:7]} == {"OPERATIONAL"}
    assert {beat.text for beat in beats(0, 0.5, 190, 191, 380)} == {"OPERATIONAL"}


def test_a_pdo_may_lie_on_any_identifier_even_one_of_29_bits():
    objects = (MappedEntry(0x2000, 0, 4, "INTEGER8", "nibble"), MappedEntry(0x2001, 0, 12, "UNSIGNED16", "rest"))
    node = NodeDescription("io", 9, None, (PdoLayout(EXTENDED_FLAG | 0x12345, "tpdo", 1, objects=objects),))
    got = Decoder(NetworkDescription(nodes={9: node})).decode(frame(EXTENDED_FLAG | 0x12345, "1F00"))
    assert (got.node, got.text) == ("io", "nibble -1; rest 1")


def test_a_mapping_that_cannot_be_is_reported_with_the_bytes():
    objects = tuple(MappedEntry(0x2000 + n, 0, 64, "UNSIGNED64", "x") for n in range(2))
    node = NodeDescription("odd", 9, None, (PdoLayout(0x189, "tpdo", 1, objects=objects),))
    got = Decoder(NetworkDescription(nodes={9: node})).decode(frame(0x189, "0102"))
    assert got.text.startswith("01 02; its mapping cannot be read")
    assert got.mark is Mark.WARNING


frames = st.builds(
    CanFrame,
    st.one_of(st.integers(0, 0x7FF), st.sampled_from([0x603, 0x583, 0x183, 0x703, 0x000]), st.integers(0, 0xFFFFFFFF)),
    st.binary(max_size=8),
)


@given(st.lists(frames, max_size=60))
def test_nothing_on_the_wire_raises_and_everything_gets_a_line(stream):
    decoder, again = robby_decoder(), Decoder(robby_network())
    for item in stream:
        got = decoder.decode(item, 1)
        assert got.service in SERVICES
        assert "\n" not in got.text
        assert got == again.decode(item, 1)


@given(st.binary(max_size=64))
def test_a_frame_longer_than_can_carries_is_cut(data):
    assert len(robby_decoder().decode(CanFrame(0x583, data)).data) <= 8


# -- lss text


@pytest.mark.parametrize(
    ("data", "from_master", "text"),
    [
        ("0400", True, "all switch to waiting"),
        ("1105", True, "configure node-ID 5"),
        ("11FF", True, "configure no node-ID"),
        ("130002", True, "configure bit rate: 500000 bit/s"),
        ("130009", True, "configure bit rate: automatic"),
        ("130105", True, "configure bit timing 5 of table 1"),
        ("15E803", True, "activate bit rate after 1000 ms"),
        ("17", True, "store"),
        ("4186020000", True, "select product 0x00000286"),
        ("4B01000000", True, "identify highest serial 0x00000001"),
        ("51000000008000", True, "fast scan: any node without a node-ID"),
        ("51860200000400 00", True, "fast scan: vendor 0x00000286, bits 4 to 31"),
        ("5E", True, "inquire node-ID"),
        ("EE", True, "unknown command 0xEE"),
        ("1101", False, "node-ID: refused, out of range"),
        ("1700", False, "store: stored"),
        ("13FF07", False, "bit rate: error 255, detail 7"),
        ("5A86020000", False, "is vendor 0x00000286"),
        ("5E05", False, "node-ID 5"),
        ("44", False, "selected"),
        ("", False, "malformed: no data"),
    ],
)
def test_each_service_has_its_words(data, from_master, text):
    assert lss_text(bytes.fromhex(data), from_master=from_master) == text


@given(st.binary(max_size=8), st.booleans())
def test_no_frame_is_without_words(data, from_master):
    assert lss_text(data, from_master=from_master)
