import select
from types import SimpleNamespace

import pytest
from support.host import TIMEOUT_S
from support.localbus import end_hubs

from canopen_control.bus.channel import open_port
from canopen_control.errors import ConfigError
from canopen_control.frame import CanFrame, pack_records
from canopen_control.host.sockets import list_sockets
from canopen_control.monitor.frame_tables import BusTap, FrameTable, LoadMeter, TraceLog, parse_filter
from canopen_control.trace.decoder import Decoder
from canopen_control.trace.network_description import NetworkDescription, NodeDescription

NETWORK = NetworkDescription(nodes={3: NodeDescription("left_drive", 3)}, master_node_id=1)
DECODER = Decoder(NETWORK)
MS = 1_000_000


def frame(can_id, data=b"\x05", at=0):
    return DECODER.decode(CanFrame(can_id, bytes(data)), at * MS)


def wanted(text, *frames):
    chosen = parse_filter(text, NETWORK)
    return [item.can_id for item in frames if chosen.wants(item)]


FRAMES = [frame(0x703), frame(0x702), frame(0x183), frame(0x603, bytes(8)), frame(0x080, b"")]


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("", [0x703, 0x702, 0x183, 0x603, 0x080]),
        ("hb", [0x703, 0x702]),
        ("HB, sdo", [0x703, 0x702, 0x603]),
        ("left_drive", [0x703, 0x183, 0x603]),
        ("2,", [0x702]),
        ("hb,left_drive", [0x703]),
        ("0x700-0x77F", [0x703, 0x702]),
        ("0x80", [0x080]),
    ],
)
def test_words_of_one_kind_are_alternatives_and_kinds_must_all_hold(text, ids):
    assert wanted(text, *FRAMES) == ids


@pytest.mark.parametrize("text", ["xx", "hb,0xZZ", "0x200-0x100", "200"])
def test_a_wrong_word_is_reported_with_those_there_are(text):
    with pytest.raises(ConfigError) as caught:
        parse_filter(text, NETWORK)
    assert str(caught.value)


def test_identifiers_are_counted_with_their_period():
    table = FrameTable()
    for at in range(0, 1000, 20):
        table.add(frame(0x703, at=at))
    row = table.rows[0x703]
    assert (row.count, row.period_ns, row.last.time) == (50, 20 * MS, 980 * MS)
    table.add(frame(0x702))
    assert table.rows[0x702].period_ns is None


def test_a_bus_with_every_identifier_does_not_grow_the_table():
    table = FrameTable()
    for can_id in range(5000):
        table.add(frame(0x8000_0000 | can_id))
    assert len(table.rows) == 4096


def test_a_new_filter_shows_what_is_kept():
    log = TraceLog()
    log.add(frame(0x703))
    log.add(frame(0x183))
    log.fresh()
    log.choose(parse_filter("hb", NETWORK))
    log.add(frame(0x183))
    assert [item.can_id for item in log.fresh()] == [0x703]


def test_the_load_is_that_of_the_last_second():
    meter = LoadMeter(1_000_000)
    meter.tick(0)
    for _ in range(1000):
        meter.add(CanFrame(0x183, bytes(8)))
    meter.tick(999 * MS)
    assert meter.load is None
    meter.tick(1000 * MS)
    assert meter.load == pytest.approx(0.111)
    meter.tick(2000 * MS)
    assert meter.load == 0.0


# -- tap


SECOND = 1_000_000_000


@pytest.fixture
def channel(private_folders):
    yield "local:tap"
    end_hubs()


def receive_until(tap, found, count):
    while len(found) < count:
        assert select.select([tap._port.fileno()], [], [], TIMEOUT_S)[0]
        tap.receive()


@pytest.mark.process
def test_it_receives_what_others_send_and_sends_nothing_itself(channel):
    result, ports = [], []
    watcher = SimpleNamespace(port_changed=ports.append)
    with_others = open_port(channel, label="others")
    tap = BusTap(NetworkDescription(channel), result.append)
    tap.watch(watcher)
    assert tap.problem == "not opened yet"
    tap.tick(0)
    assert (tap.problem, len(ports)) == ("", 1)
    assert list_sockets("bus") == ["tap"]
    with_others.send(pack_records([CanFrame(0x703, b"\x05"), CanFrame(0x000, b"\x01\x00")]))
    receive_until(tap, result, 2)
    assert [item.service for item in result] == ["hb", "nmt"]
    assert tap._port.stats.tx == 0
    assert with_others.receive() == b""
    tap.close()
    tap.close()
    assert ports[-1] is None
    with_others.close()


def test_a_bus_that_cannot_be_opened_is_a_sentence_and_tried_again_once_a_second():
    tap = BusTap(NetworkDescription("memory:inside"), lambda _: None)
    tap.tick(0)
    assert "inside one process" in tap.problem
    tap.problem = "old"
    tap.tick(SECOND - 1)
    assert tap.problem == "old"
    tap.tick(SECOND)
    assert "inside one process" in tap.problem
