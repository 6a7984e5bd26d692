"""For all data on the wire: nothing raises, nothing grows, and wrong data is never reported as a success."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.properties import examples
from support.sdo import MS, NODE, SECOND, BadLine, Line, MemoryStore

from canopen_control.cia301.sdo_client import SdoClient
from canopen_control.cia301.sdo_exchange import SdoOptions
from canopen_control.cia301.sdo_server import SdoServer, SdoServerAbort
from canopen_control.errors import SdoAbort, SdoTimeout
from canopen_control.frame import CanFrame

COMMANDS = st.one_of(
    st.integers(0, 255),
    st.sampled_from((0x80, 0x40, 0x41, 0x43, 0x4F, 0x60, 0x21, 0x23, 0x20, 0x30, 0x00, 0x10, 0x01, 0x0F, 0x70)),
    st.sampled_from((0xA0, 0xA1, 0xA2, 0xA3, 0xA4, 0xC0, 0xC1, 0xC2, 0xC6, 0xD9, 0x81, 0x82)),
)
MUXES = st.sampled_from((b"\x00\x20\x00", b"\x01\x20\x00", b"\x00\x10\x00", b"\0\0\0", b"\x7f\x7f\0"))
TAILS = st.one_of(st.binary(max_size=4), st.sampled_from((b"\x07\0\0\0", b"\x1a\0\0\0", b"\xff\xff\xff\xff")))
FRAMES = st.one_of(
    st.builds(lambda c, m, t: bytes((c,)) + m + t.ljust(4, b"\0"), COMMANDS, MUXES, TAILS),
    st.builds(lambda c, t: bytes((c,)) + t, COMMANDS, st.binary(max_size=7)),
    st.binary(max_size=9),
)
STEPS = st.lists(
    st.one_of(
        FRAMES, st.sampled_from(("read", "write", "read block", "write block", "frames", "events", "tick", "cancel"))
    ),
    max_size=60,
)


def operate(client, step, now):
    """Do what a caller may do at any time."""
    if step.startswith("read"):
        client.read(0x2000, 0, block="block" in step)
    elif step.startswith("write"):
        client.write(0x2000, 0, bytes(20), block="block" in step)
    elif step == "cancel":
        client.cancel_all(SdoTimeout(NODE, 0, 0, 0))
    elif step == "frames":
        client.frames()
    elif step == "events":
        client.events()
    else:
        client.tick(now)


@given(STEPS)
@settings(max_examples=examples(100))
def test_no_sequence_of_frames_breaks_the_client(steps):
    client = SdoClient(NODE, options=SdoOptions(max_size=50))
    now = 0
    for step in steps:
        now += 200 * MS
        if isinstance(step, bytes):
            client.receive(CanFrame(0x580 + NODE, step), now)
            assert len(client._exchange.out) <= 140
        else:
            operate(client, step, now)
        transfer = client._exchange.phase.transfer
        assert transfer is None or len(transfer.result) <= 60
    assert_usable(client, SdoServer(NODE, MemoryStore({(0x2000, 0): b"old"})), now)


@given(STEPS, st.booleans())
@settings(max_examples=examples(100))
def test_no_sequence_of_frames_breaks_the_server(steps, fetch):
    store = MemoryStore({(0x2000, 0): bytes(20), (0x2001, 0): b"\1\2"})
    server = SdoServer(NODE, store, max_size=50)
    now = 0
    for step in steps:
        now += 200 * MS
        if isinstance(step, bytes):
            server.receive(CanFrame(0x600 + NODE, step), now)
        server.tick(now)
        if fetch:
            server.frames()
        assert len(server._out) <= 512
        assert server._transfer is None or len(server._transfer.result) <= 60
    assert all(len(value) <= 57 for value in store.objects.values())
    server.frames()
    assert_usable(SdoClient(NODE), server, now)


def assert_usable(client, server, now):
    """Whatever has happened: once it is over, a write and a read work."""
    line = BadLine(client, server, 0)
    line.now = now + 1
    client.cancel_all(SdoTimeout(NODE, 0, 0, 0))
    server.receive(CanFrame(0x600 + NODE, bytes.fromhex("8000000000000000")), line.now)
    server.store.objects[0x2000, 0] = b"old"
    for block in (False, True):
        written = client.write(0x2000, 0, b"new value", block=block)
        line.run(written)
        read = client.read(0x2000, 0, block=block)
        line.run(read)
        assert (written.error, read.error, read.data) == (None, None, b"new value")


def test_unfetched_answers_of_the_server_do_not_accumulate():
    server = SdoServer(NODE, MemoryStore({(0x2000, 0): b"\1"}))
    for number in range(5000):
        server.receive(CanFrame(0x600 + NODE, bytes((0x40, 0, 0x20, number & 0xFF, 0, 0, 0, 0))), 0)
    assert len(server.frames()) <= 256
    assert server.ignored > 4000


SIZES = st.one_of(st.integers(0, 30), st.integers(880, 900), st.integers(1700, 1800), st.just(100_000))


@pytest.mark.rest
@given(SIZES, st.booleans(), st.booleans(), st.booleans(), st.booleans(), st.integers(1, 127), st.integers(1, 127))
@settings(max_examples=examples(60))
def test_any_bytes_cross_by_every_kind_of_transfer(size, block, sized, crc, serves_block, up_size, down_size):
    data = random.Random(size).randbytes(size)
    store = MemoryStore({(0x2000, 0): b""})
    options = SdoOptions(crc=crc, announce_size=sized, block_size=up_size)
    client = SdoClient(NODE, options=options)
    line = Line(client, SdoServer(NODE, store, block=serves_block, block_size=down_size))
    if not sized and 1 <= size <= 4:
        store.sizes[0x2000, 0] = size
    written = client.write(0x2000, 0, data, block=block)
    line.run()
    assert (written.done, written.error) == (True, None)
    assert store.objects[0x2000, 0] == data
    read = client.read(0x2000, 0, block=block)
    line.run()
    assert (read.error, read.data) == (None, data)


LOSSES = st.sampled_from((0.0, 0.002, 0.02, 0.2))
DOUBLES = st.sampled_from((0.0, 0.02, 0.3))
LATES = st.sampled_from((0.0, 0.01, 0.2))


@given(st.integers(0, 2**32), LOSSES, DOUBLES, LATES, st.booleans(), st.booleans())
@settings(max_examples=examples(150))
def test_on_a_bad_line_a_success_is_true(seed, loss, double, late, block, crc):
    """Reads and writes of one object, of changing length, each with data of its own."""
    choose = random.Random(seed)
    store = MemoryStore({(0x2000, 0): b"first"})
    client = SdoClient(NODE, options=SdoOptions(crc=crc, block_size=choose.choice((1, 3, 10, 127))))
    server = SdoServer(NODE, store, block_size=choose.choice((1, 3, 10, 127)))
    line = BadLine(client, server, seed, loss=loss, double=double, late=late)
    for _ in range(8):
        values = [store.objects[0x2000, 0]]
        known = len(store.downloads)
        if choose.random() < 0.5:
            request = client.read(0x2000, 0, block=block)
            line.run(request)
            values += [value for _, _, value in store.downloads[known:]]  # a write given up may still arrive
            assert request.error is not None or request.data in values
        else:
            data = choose.randbytes(choose.choice((1, 2, 4, 5, 7, 20, 100, 889, 2000)))
            request = client.write(0x2000, 0, data, block=block)
            line.run(request)
            assert request.error is not None or store.objects[0x2000, 0] == data
        assert isinstance(request.error, SdoAbort | SdoTimeout | None)


class LosesSegments(BadLine):
    """Loses data segments alone, and never the first of a sub-block: what a receiver's overrun does to it."""

    segments: frozenset[int] = frozenset()

    def _put(self, way, one):
        spared = one.data[0] & 0x7F in (0, 1) or one.data[0] & 0xC0 == 0xC0  # 0xC1 may be the end, 0xC6 the initiate
        self.loss = 0.02 if one.can_id in self.segments and not spared else 0
        super()._put(way, one)


@pytest.mark.rest
@given(st.integers(0, 2**32), st.booleans())
@settings(max_examples=examples(20))
def test_lost_segments_of_100_kilobytes_are_asked_for_again(seed, upload):
    data = random.Random(seed).randbytes(100_000)
    store = MemoryStore({(0x2000, 0): data if upload else b""})
    client = SdoClient(NODE)
    line = LosesSegments(client, SdoServer(NODE, store), seed)
    request = client.read(0x2000, 0, block=True) if upload else client.write(0x2000, 0, data, block=True)
    line.segments = frozenset((0x583 if upload else 0x603,))
    line.run(request)
    assert (request.error, client.retried) == (None, 0)
    assert (request.data if upload else store.objects[0x2000, 0]) == data


class Counter(MemoryStore):
    """0x2000 tells how often it was read; odd values are refused by 0x2001."""

    def upload(self, index, subindex):
        data = super().upload(index, subindex)
        return self.uploads.to_bytes(4, "little") if index == 0x2000 else data

    def download(self, index, subindex, data):
        if data[0] & 1:
            raise SdoServerAbort(0x06090030)
        super().download(index, subindex, data)


@given(st.integers(0, 2**32), LOSSES, DOUBLES, LATES)
@settings(max_examples=examples(100))
def test_no_answer_is_taken_for_that_of_another_request(seed, loss, double, late):
    choose = random.Random(seed)
    store = Counter({(0x2000, 0): b"", (0x2001, 0): b"\0\0\0\0"})
    client = SdoClient(NODE)
    line = BadLine(client, SdoServer(NODE, store), seed, loss=loss, double=double, late=late)
    for number in range(20):
        reads = store.uploads
        if choose.random() < 0.5:
            request = client.read(0x2000, 0)
            line.run(request)
            assert request.error is not None or int.from_bytes(request.data, "little") > reads
        else:
            value = bytes((choose.randrange(256), number, 0, 0))
            request = client.write(0x2001, 0, value)
            line.run(request)
            assert request.error is not None or store.objects[0x2001, 0] == value
            assert not isinstance(request.error, SdoAbort) or request.error.code == 0x05040000 or value[0] & 1


@given(st.integers(0, 2**32), LOSSES, DOUBLES, LATES)
@settings(max_examples=examples(100))
def test_nor_if_all_are_asked_at_once(seed, loss, double, late):
    choose = random.Random(seed)
    store = Counter({(0x2000, 0): b"", (0x2001, 0): b"\0\0\0\0"})
    client = SdoClient(NODE)
    line = BadLine(client, SdoServer(NODE, store), seed, loss=loss, double=double, late=late)
    values = [bytes((choose.randrange(256), number, 0, 0)) for number in range(20)]
    writes = [(client.write(0x2001, 0, value), client.read(0x2000, 0), client.read(0x2000, 0)) for value in values]
    line.run(writes[-1][-1])
    taken = {data for _, _, data in store.downloads}
    assert all(w.error is not None or value in taken for value, (w, _, _) in zip(values, writes, strict=True))
    counts = [int.from_bytes(r.data, "little") for _, *reads in writes for r in reads if r.error is None]
    assert counts == sorted(set(counts)), "one reading was given to two requests"


def test_two_callers_interleave_a_thousand_requests_without_an_error():
    store = MemoryStore({(0x6064, 0): b"left", (0x6084, 0): b"right hand", (0x2001, 0): bytes(4)})
    client = SdoClient(NODE)
    line = Line(client, SdoServer(NODE, store))
    requests = []
    for number in range(500):
        requests.append((client.read(0x6064, 0), b"left"))
        requests.append((client.read(0x6084, 0, block=number % 3 == 0), b"right hand"))
        client.write(0x2001, 0, number.to_bytes(4, "little"))
        if number % 7 == 0:
            line.run()
    line.run()
    assert [(r.done, r.error, r.data) for r, _ in requests] == [(True, None, data) for _, data in requests]
    assert [data for _, _, data in store.downloads] == [number.to_bytes(4, "little") for number in range(500)]
    assert len(client.events()) == 1500
    assert (client.ignored, client.retried, client.waiting) == (0, 0, 0)


def test_time_does_not_advance_without_an_answer():
    client = SdoClient(NODE)
    request = client.read(0x2000, 0, now=0)
    steps = 0
    while not request.done:
        client.frames()
        deadline = client.next_deadline()
        assert deadline is not None
        client.tick(deadline)
        steps += 1
    assert (steps, request.elapsed_ns) == (2, SECOND)
