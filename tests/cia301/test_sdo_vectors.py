"""Every golden exchange, on the client and on the server, each against frames it did not make."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from support.sdo import NODE, MemoryStore, frame

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_exchange import SdoOptions, SdoRequest
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.errors import SdoAbort

VECTORS = json.loads((Path(__file__).parents[1] / "data" / "sdo.json").read_text())
EXCHANGES = {vector["name"]: vector["frames"] for vector in VECTORS["sdo"]}
ABORTS = {vector["name"]: (vector["request"], vector["answer"]) for vector in VECTORS["sdo_aborts"]}

LOST = "block write with segment 2 lost: ack says 1, client must resend from segment 2 with seqno restarting at 1"
WRONG_CRC = "block write with wrong CRC -> server abort 0x05040004"
BLKSIZE_0 = "block read with blksize 0 -> abort 0x05040002"
ACK_0 = "block read, client acks 0 of 3: server resends the whole sub-block with same seqnos"
# requests that no correct client sends: see the tests after the table
FAULTY_CLIENT = (LOST, WRONG_CRC, BLKSIZE_0, ACK_0)


class Exchange:
    """What an exchange is about, read from its frames alone."""

    def __init__(self, frames):
        self.frames = [frame(text) for text in frames]
        first = self.frames[0].data
        self.command = first[0]
        self.index, self.subindex = first[1] | first[2] << 8, first[3]
        self.is_write = self.command >> 5 in (1, 6)
        self.is_block = self.command >> 5 in (5, 6)
        self.block_size, self.threshold = first[4], first[5]

    @property
    def data(self):
        """The object's bytes: of the expedited frame, or of all segments."""
        sender = 0x603 if self.is_write else 0x583
        frames = [f.data for f in self.frames if f.can_id == sender]
        if frames[0][0] & 0xE2 in (0x22, 0x42):
            return frames[0][4 : 8 - (frames[0][0] >> 2 & 3)]
        size = int.from_bytes(frames[0][4:8], "little")
        return b"".join(f[1:] for f in frames[1:])[:size]


def options_of(exchange):
    read = exchange.is_block and not exchange.is_write
    crc = bool(exchange.command & 4) if exchange.is_block else True
    return SdoOptions(
        block_size=exchange.block_size or 127 if read else 127,
        switch_threshold=exchange.threshold if read else 0,
        crc=crc,
    )


def start(exchange) -> tuple[SdoClient, SdoRequest]:
    client = SdoClient(NODE, options=options_of(exchange))
    if exchange.is_write:
        data, block = exchange.data, exchange.is_block
        return client, client.write(exchange.index, exchange.subindex, data, block=block, now=0)
    return client, client.read(exchange.index, exchange.subindex, block=exchange.is_block, now=0)


@pytest.mark.parametrize("name", [name for name in EXCHANGES if name not in FAULTY_CLIENT])
def test_the_client_follows_the_documented_exchange(name):
    exchange = Exchange(EXCHANGES[name])
    client, request = start(exchange)
    messages = []
    for one in exchange.frames:
        messages += client.frames()
        if one.can_id == 0x583:
            client.receive(one, 0)
    messages += client.frames()
    assert messages == [f for f in exchange.frames if f.can_id == 0x603]
    assert request.done
    assert request.error is None
    assert request.data == exchange.data
    assert client.events() == [request]
    assert client.ignored == 0


@pytest.mark.parametrize("name", [name for name in EXCHANGES if name != LOST])
def test_the_server_follows_the_documented_exchange(name):
    exchange = Exchange(EXCHANGES[name])
    store = MemoryStore({(exchange.index, exchange.subindex): b"" if exchange.is_write else exchange_value(name)})
    server = SdoServer(NODE, store, block_size=2 if "server blksize 2" in name else 127)
    messages = []
    for one in exchange.frames:
        if one.can_id == 0x603:
            server.receive(one, 0)
            messages += server.frames()
    assert messages == [f for f in exchange.frames if f.can_id == 0x583]
    if exchange.is_write and name != WRONG_CRC:
        assert store.objects[exchange.index, exchange.subindex] == exchange.data
        assert server.served == 1


def exchange_value(name):
    if name in (BLKSIZE_0, ACK_0):
        return bytes(range(26))
    return Exchange(EXCHANGES[name]).data


def test_the_server_acknowledges_what_came_before_a_lost_segment():
    exchange = Exchange(EXCHANGES[LOST])
    server = SdoServer(NODE, MemoryStore({(exchange.index, exchange.subindex): b""}))
    messages = []
    for one in exchange.frames:
        if one.can_id == 0x603:
            server.receive(one, 0)
            messages += server.frames()
    assert messages == [f for f in exchange.frames if f.can_id == 0x583]


def test_the_client_resends_behind_a_lost_segment_numbered_from_1():
    data = bytes(range(20))
    client = SdoClient(NODE)
    client.write(0x2008, 0, data, block=True, now=0)
    for answer in ("583#A40820007F000000", "583#A2017F0000000000"):
        client.frames()
        client.receive(frame(answer), 0)
    assert client.frames() == [frame("603#010708090A0B0C0D"), frame("603#820E0F1011121300")]
    client.receive(frame("583#A2027F0000000000"), 0)
    assert [str(f)[:6] for f in client.frames()] == ["603#C5"]


def test_the_client_writes_in_segments_after_a_crc_error():
    client = SdoClient(NODE)
    client.write(0x2008, 0, b"12345", block=True, now=0)
    messages = []
    for answer in EXCHANGES[WRONG_CRC]:
        messages += client.frames()
        if answer.startswith("583"):
            client.receive(frame(answer), 0)
    assert messages[-1].data[0] == 0xC9
    assert client.frames() == [frame("603#2108200005000000")]


def test_the_client_reads_plainly_after_a_refused_block_size():
    client = SdoClient(NODE)
    request = client.read(0x2008, 0, block=True, now=0)
    client.frames()
    client.receive(frame(EXCHANGES[BLKSIZE_0][1]), 0)
    assert client.frames() == [frame("603#4008200000000000")]
    assert not request.done


def test_the_client_acknowledges_0_of_3_when_the_first_segment_is_lost():
    frames = [frame(text) for text in EXCHANGES[ACK_0]]
    client = SdoClient(NODE, options=SdoOptions(block_size=3))
    client.read(0x2008, 0, block=True, now=0)
    assert client.frames() == [frames[0]]
    client.receive(frames[1], 0)
    assert client.frames() == [frames[2]]
    for one in frames[4:6]:  # 3 is lost
        client.receive(one, 0)
    assert client.frames() == [frames[6]]
    for one in frames[7:]:
        client.receive(one, 0)
    assert client.frames() == [frame("603#A203030000000000")]


@pytest.mark.parametrize("name", ABORTS)
def test_the_server_aborts_as_it_should(name):
    request, answer = map(frame, ABORTS[name])
    index, subindex, code = (
        answer.data[1] | answer.data[2] << 8,
        answer.data[3],
        int.from_bytes(answer.data[4:], "little"),
    )
    store = MemoryStore()
    store.aborts[index, subindex] = code
    server = SdoServer(NODE, store)
    server.receive(request, 0)
    assert server.frames() == [answer]
    assert (server.aborted, server.served) == (1, 0)


@pytest.mark.parametrize("name", [name for name in ABORTS if "idle" not in name and "unknown command" not in name])
def test_the_client_reports_the_abort(name):
    request, answer = ABORTS[name]
    exchange = Exchange([request])
    client, pending = start(exchange)
    assert client.frames() == [frame(request)]
    client.receive(frame(answer), 0)
    assert isinstance(pending.error, SdoAbort)
    assert pending.error.code == int.from_bytes(frame(answer).data[4:], "little")
    assert (pending.error.index, pending.error.subindex) == (exchange.index, exchange.subindex)
    assert client.frames() == []
