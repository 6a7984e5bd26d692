import pytest
from support.tracing import frame, robby_decoder, robby_network

from canopen_control.errors import ConfigError
from canopen_control.frame import EXTENDED_FLAG, REMOTE_FLAG
from canopen_control.trace.frame_lines import Filter, node_ids_of, parse_ids, parse_services

STREAM = [
    (0x183, "370603"),
    (0x080, ""),
    (0x183, "370603"),
    (0x083, "1186210000000000"),
    (0x083, "1186210000000000"),
    (0x080, ""),
    (0x182, "370603"),
    (0x183, "370604"),
    (0x703, "05"),
    (REMOTE_FLAG | 0x703, ""),
]


def shown(**how):
    decoder, expected = robby_decoder(), Filter(**how)
    return [item[0] for item in STREAM if expected.wants(decoder.decode(frame(*item)))]


def test_by_node_by_service_and_by_identifier():
    assert shown(nodes=frozenset({2})) == [0x182]
    assert shown(services=frozenset({"emcy"})) == [0x083, 0x083]
    assert shown(ids=(range(0x180, 0x184),)) == [0x183, 0x183, 0x182, 0x183]
    assert shown(ids=(range(0x703, 0x704),)) == [0x703, REMOTE_FLAG | 0x703]
    assert shown(nodes=frozenset({3}), services=frozenset({"hb"})) == [0x703, REMOTE_FLAG | 0x703]


def test_changes_leave_out_repetitions_but_never_an_event():
    assert shown(changes=True) == [0x183, 0x080, 0x083, 0x083, 0x182, 0x183, 0x703, REMOTE_FLAG | 0x703]


def test_events_are_what_is_news_and_nothing_else():
    decoder, expected = robby_decoder(), Filter(events=True)
    stream = [
        (0x703, "05"),
        (0x183, "310603"),
        (0x183, "310203"),  # the same state
        (0x183, "370603"),
        (0x203, "0F0003"),
        (0x203, "1F0003"),  # the same command
        (0x083, "1186210000000000"),
        (0x183, "180603"),
        (0x183, "180203"),
        (0x603, "4041600000000000"),
        (0x703, "7F"),
    ]
    shown = [item for item in stream if expected.wants(decoder.decode(frame(*item)))]
    assert shown == [stream[1], stream[3], stream[4], stream[6], stream[7], stream[10]]


def test_the_history_of_changes_is_bounded():
    decoder, expected = robby_decoder(), Filter(changes=True)
    for number in range(5000):
        expected.wants(decoder.decode(frame(0x183, f"{number:06x}")))
    assert len(expected._last) == 1


def test_services_are_named_and_a_wrong_one_names_them():
    assert parse_services("pdo, SDO,heartbeat") == {"pdo", "sdo", "hb"}
    with pytest.raises(ValueError, match=r"unknown service 'pod'; services: nmt, sync"):
        parse_services("pod")


def test_identifiers_are_hexadecimal_with_or_without_0x():
    assert parse_ids("181") == parse_ids("0x181") == range(0x181, 0x182)
    assert parse_ids("180-1FF") == range(0x180, 0x200)
    assert parse_ids("00000181") == range(EXTENDED_FLAG | 0x181, (EXTENDED_FLAG | 0x181) + 1)
    for text in ("x", "200-100", "FFFFFFFF"):
        with pytest.raises(ValueError, match=text.split("-")[0]):
            parse_ids(text)


def test_nodes_are_named_or_numbered():
    assert node_ids_of(robby_network(), ["left_drive", "0x2", "master", "99"]) == {3, 2, 1, 99}
    with pytest.raises(ConfigError, match=r"left_drive, right_drive|right_drive, left_drive"):
        node_ids_of(robby_network(), ["middle_drive"])
