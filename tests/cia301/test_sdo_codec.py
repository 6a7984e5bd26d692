from __future__ import annotations

import json
import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.sdo import MS, NODE, MemoryStore

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_codec import (
    EXPEDITED_CODES,
    EXPEDITED_LENGTHS,
    UPLOAD,
    crc16,
    deliver,
    segment_frames,
    segments_in_order,
)
from canopen_control.cia301.sdo_exchange import SdoOptions
from canopen_control.cia301.sdo_server import SdoServer
from canopen_control.frame import RECORD_SIZE, CanFrame, frames_of, pack_records

OBJECT = (0x2000, 0)
COB_ID = 0x583


def segments(count: int, first: int = 1) -> list[CanFrame]:
    return [CanFrame(COB_ID, bytes((first + n, *(n + byte & 0xFF for byte in range(7))))) for n in range(count)]


def data_of(frames: list[CanFrame]) -> bytes:
    return b"".join(frame.data[1:] for frame in frames)


# -- the run


def test_all_segments_in_order_are_one_run():
    whole = segments(127)
    records = pack_records(whole)
    assert segments_in_order(records, 0, COB_ID, 1, 127) == data_of(whole)
    assert segments_in_order(records, 16 * 20, COB_ID, 21, 50) == data_of(whole[20:70])
    assert segments_in_order(records[: 16 * 30], 16 * 3, COB_ID, 4, 127 - 3) == data_of(whole[3:30])


def spoilt_record(kind: str) -> bytes:
    """The record of what stands where segment 11 should."""
    right = segments(1, 11)[0]
    wrong = {
        "lost": CanFrame(COB_ID, bytes((12, *right.data[1:]))),
        "doubled": CanFrame(COB_ID, bytes((10, *right.data[1:]))),
        "last": CanFrame(COB_ID, bytes((11 | 0x80, *right.data[1:]))),
        "short": CanFrame(COB_ID, right.data[:7]),
        "of another node": CanFrame(COB_ID + 1, right.data),
        "extended": CanFrame(COB_ID | 0x80000000, right.data),
        "remote": CanFrame(COB_ID | 0x40000000, right.data),
    }
    return pack_records([wrong[kind]])


@pytest.mark.parametrize("kind", ["lost", "doubled", "last", "short", "of another node", "extended", "remote"])
def test_a_run_ends_before_what_is_not_the_next_segment(kind):
    records = bytearray(pack_records(segments(40)))
    records[160:176] = spoilt_record(kind)
    assert segments_in_order(bytes(records), 0, COB_ID, 1, 100) == data_of(segments(10))


@given(st.integers(0, 300), st.integers(0, 40), st.integers(1, 127), st.randoms(use_true_random=False))
def test_a_sub_block_is_made_as_if_segment_by_segment(size, first, count, choose):
    data = choose.randbytes(size)
    total = max(1, -(-size // 7))
    first = min(first, total - 1)
    count = min(count, total - first)
    expected = []
    for number in range(1, count + 1):
        at = (first + number - 1) * 7
        flag = 0x80 if first + number == total else 0
        expected.append(CanFrame(COB_ID, bytes((number | flag,)) + data[at : at + 7].ljust(7, b"\0")))
    created = segment_frames(COB_ID, data, first, count)
    assert created == expected
    assert all(type(frame.data) is bytes for frame in created)


def test_records_are_delivered_in_order_and_a_run_is_asked_for_where_there_is_room_for_one():
    frames = [*segments(6), CanFrame(0x80), *segments(6)]
    requested, taken = [], []

    def take_run(records, start, now):
        requested.append(start // RECORD_SIZE)
        if start != 2 * RECORD_SIZE:
            return 0
        taken.extend(frames_of(records[start : start + 4 * RECORD_SIZE]))
        return 4

    deliver(pack_records(frames), 7, take_run, lambda frame, now: taken.append(frame))
    assert taken == frames
    assert requested == [0, 1, 2, 7, 8, 9]
    deliver(b"", 7, take_run, lambda frame, now: taken.append(frame))
    assert taken == frames


# -- runs and frames leave the same


def known(core: SdoClient | SdoServer) -> tuple[object, ...]:
    """All that a core remembers, comparable with that of another."""
    holder = core._exchange if isinstance(core, SdoClient) else core
    apart = ("_transfer", "phase", "_budget", "late_answers", "active", "finished", "options", "store")
    transfer = holder.phase.transfer if isinstance(core, SdoClient) else core._transfer
    names = getattr(type(transfer), "__mypyc_attrs__", None) or getattr(transfer, "__dict__", ())
    inside = {name: getattr(transfer, name) for name in names}
    rest = {name: value for name, value in vars(holder).items() if name not in apart}
    ended = [(r.data, str(r.error), r.elapsed_ns) for r in getattr(holder, "finished", ())]
    written = [] if isinstance(core, SdoClient) else core.store.downloads
    return type(transfer), inside, rest, ended, written


class Noise:
    """What happens to a stream: `rate` for each frame and for the stream; `announced` is the size initiates tell."""

    def __init__(self, choose: random.Random, rate: float, announced: int = 0) -> None:
        self.choose, self.rate, self.announced = choose, rate, announced
        self.kinds = [self.lose, self.double, self.swap, self.interrupt, self.damage]

    def records(self, frames: list[CanFrame]) -> bytes:
        received: list[CanFrame] = []
        for frame in frames:
            received.append(frame)
            if self.choose.random() < self.rate:
                self.choose.choice(self.kinds)(received)
        if self.choose.random() < self.rate:
            del received[-self.choose.randrange(1, 20) :]
        if self.choose.random() < self.rate:
            received *= 2
        received = [self.lie(frame) for frame in received] if self.announced else received
        records = bytearray(pack_records(received))
        if self.choose.random() < 0.5:
            records[5::RECORD_SIZE] = self.choose.randbytes(len(received))
        return bytes(records)

    def lose(self, heard: list[CanFrame]) -> None:
        heard.pop()

    def double(self, heard: list[CanFrame]) -> None:
        heard.append(heard[-1])

    def swap(self, heard: list[CanFrame]) -> None:
        heard[-2:] = heard[:-3:-1]

    def interrupt(self, heard: list[CanFrame]) -> None:
        heard.append(self.choose.choice((CanFrame(0x703, b"\5"), CanFrame(0x80), CanFrame(0x582, bytes(8)))))

    def damage(self, heard: list[CanFrame]) -> None:
        can_id, data = heard.pop()
        changed = bytearray(data)
        changed[self.choose.randrange(8)] ^= 1 << self.choose.randrange(8)
        heard.append(CanFrame(can_id, bytes(changed)[: self.choose.choice((8, 8, 8, 8, 3))]))

    def lie(self, frame: CanFrame) -> CanFrame:
        """Announce another size, if it is an initiate of a block transfer that announces one."""
        if frame.data[:4] not in (b"\xc2\x00\x20\x00", b"\xc6\x00\x20\x00"):
            return frame
        return CanFrame(frame.can_id, frame.data[:4] + self.announced.to_bytes(4, "little"))


class Twins:
    """Two receivers of one sender: one takes frames, the other runs; they must never differ."""

    def __init__(self, by_frame, by_run, sender, choose: random.Random) -> None:
        self.by_frame, self.by_run, self.sender, self.choose = by_frame, by_run, sender, choose
        self.now = 1

    def hear(self, records: bytes) -> None:
        """Hand the stream over in pieces."""
        while records:
            size = self.choose.choice((1, 2, 10, 60, 127, 1000)) * RECORD_SIZE
            piece, records = records[:size], records[size:]
            self.now += self.choose.choice((0, 1, 1000))
            for frame in frames_of(piece):
                self.by_frame.receive(frame, self.now)
            deliver(piece, self.now, self.by_run.receive_records, self.by_run.receive)
            assert known(self.by_run) == known(self.by_frame)
            if self.choose.random() < 0.2:
                self.answer()

    def answer(self) -> bool:
        """Carry what the receivers say, the same, to the sender; whether there was something."""
        text = self.by_frame.frames()
        assert self.by_run.frames() == text
        for frame in text:
            self.sender.receive(frame, self.now)
        return bool(text)

    def run(self, noise: Noise, turns: int = 3000) -> None:
        """Until nobody wants anything, at most `turns`."""
        cores = (self.by_frame, self.by_run, self.sender)
        for _ in range(turns):
            frames = self.sender.frames()
            self.hear(noise.records(frames))
            if self.answer() or frames:
                continue
            deadlines = [at for core in cores if (at := core.next_deadline()) is not None]
            if not deadlines:
                break
            self.now = max(self.now, min(deadlines))
            for core in cores:
                core.tick(self.now)
            assert known(self.by_run) == known(self.by_frame)


SIZES = st.sampled_from((0, 7, 30, 400, 889, 890, 3000, 6000))
BLOCK_SIZES = st.sampled_from((3, 12, 30, 126, 127))
RATES = st.sampled_from((0.0, 0.003, 0.03, 0.2))
LIES = st.sampled_from((0, 0, 0, 100, 890, 5000))


@pytest.mark.sources  # the twins are compared inside
@given(st.integers(0, 2**32), SIZES, BLOCK_SIZES, RATES, st.booleans(), st.sampled_from((2000, 1 << 20)), LIES)
@settings(max_examples=examples(150))
def test_an_upload_by_runs_is_the_upload_by_frames(seed, size, block_size, rate, crc, limit, lie):
    choose = random.Random(seed)
    data = choose.randbytes(size)
    options = SdoOptions(block_size=block_size, crc=crc, max_size=limit)
    clients = [SdoClient(NODE, options=options) for _ in range(2)]
    requests = [client.read(*OBJECT, block=True, now=1) for client in clients]
    twins = Twins(*clients, SdoServer(NODE, MemoryStore({OBJECT: data})), choose)
    twins.run(Noise(choose, rate, lie))
    one, other = requests
    assert (one.done, one.data, str(one.error)) == (other.done, other.data, str(other.error))
    if not rate and not lie:
        assert one.data == data if size <= limit else one.error is not None


@given(st.integers(0, 2**32), SIZES, BLOCK_SIZES, RATES, st.booleans(), st.sampled_from((2000, 1 << 20)), LIES)
@settings(max_examples=examples(150))
def test_a_download_by_runs_is_the_download_by_frames(seed, size, block_size, rate, announced, limit, lie):
    choose = random.Random(seed)
    data = choose.randbytes(size)
    stores = [MemoryStore({OBJECT: b""}) for _ in range(2)]
    servers = [SdoServer(NODE, store, block_size=block_size, max_size=limit) for store in stores]
    client = SdoClient(NODE, options=SdoOptions(announce_size=announced))
    request = client.write(*OBJECT, data, block=True, now=1)
    Twins(*servers, client, choose).run(Noise(choose, rate, lie))
    assert stores[0].downloads == stores[1].downloads
    if not rate and not lie:
        assert stores[1].objects[OBJECT] == data if size <= limit else request.error is not None


# -- and they are taken


class Counting:
    """A core that counts what comes frame by frame."""

    def __init__(self, core: SdoClient | SdoServer) -> None:
        self.core, self.frames_taken = core, 0

    def hear(self, frames: list[CanFrame]) -> None:
        deliver(pack_records(frames), MS, self.core.receive_records, self._receive)

    def _receive(self, frame: CanFrame, now: int) -> None:
        self.frames_taken += 1
        self.core.receive(frame, now)


@pytest.mark.parametrize("upload", [True, False])
def test_on_a_good_line_one_segment_of_a_sub_block_comes_as_a_frame(upload):
    data = random.Random(5).randbytes(127 * 7 * 20)
    store = MemoryStore({OBJECT: data if upload else b""})
    client, server = Counting(SdoClient(NODE)), Counting(SdoServer(NODE, store))
    request = client.core.read(*OBJECT, block=True) if upload else client.core.write(*OBJECT, data, block=True)
    while not request.done:
        server.hear(client.core.frames())
        client.hear(server.core.frames())
    assert (request.error, request.data if upload else store.objects[OBJECT]) == (None, data)
    receiver = client if upload else server
    assert receiver.frames_taken == 20 + 2  # and the initiate, and the end
    assert (client.core.ignored, server.core.ignored) == (0, 0)


def test_a_run_keeps_the_transfer_alive():
    client = SdoClient(NODE)
    client.read(*OBJECT, block=True, now=0)
    client.frames()
    client.receive(CanFrame(COB_ID, bytes.fromhex("C600200000100000")), 100 * MS)
    client.frames()
    assert client.receive_records(pack_records(segments(10)), 0, 300 * MS) == 10
    assert client.next_deadline() == 800 * MS
    assert client.receive_records(pack_records(segments(10)), 0, 400 * MS) == 0
    assert client.next_deadline() == 800 * MS


def test_without_a_block_transfer_there_are_not_runs():
    client, server = SdoClient(NODE), SdoServer(NODE, MemoryStore())
    records = pack_records(segments(20))
    assert (client.receive_records(records, 0, 0), server.receive_records(records, 0, 0)) == (0, 0)
    client.read(*OBJECT)
    assert client.receive_records(records, 0, 0) == 0
    assert (client.ignored, server.ignored) == (0, 0)


CRC = json.loads((Path(__file__).parents[1] / "data" / "sdo.json").read_text())["crc16"]
RULES = {
    "bytes 0..255": bytes(range(256)),
    "byte k = (7k+1) mod 256, k=0..888": bytes((7 * k + 1) % 256 for k in range(889)),
    "byte k = (7k+1) mod 256, k=0..1999": bytes((7 * k + 1) % 256 for k in range(2000)),
}


@pytest.mark.parametrize("vector", CRC["vectors"], ids=lambda v: f"{v['len']} bytes {v['crc']}")
def test_the_crc_is_that_of_the_standard(vector):
    data = RULES[vector["rule"]] if vector["rule"] else bytes.fromhex(vector["data"])
    assert len(data) == vector["len"]
    assert crc16(data) == int(vector["crc"], 16)


def test_expedited_lengths_and_codes_are_inverse():
    for length in (1, 2, 3, 4):
        assert EXPEDITED_LENGTHS[UPLOAD | EXPEDITED_CODES[length]] == length
