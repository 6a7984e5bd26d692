from __future__ import annotations

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.services import MS, frame, vectors

from canopen_control.cia301.lss import LssIdentity, LssMaster, LssMode, LssRequest, LssSlave
from canopen_control.errors import LocalProtocolError, RemoteProtocolError

FRAMES = {vector["name"]: frame(vector["frame"]) for vector in vectors()["lss"]["vectors"]}
IDENTITY = LssIdentity(0x286, 0x4F6, 0x0003001A, 0x12345678)


def run(master: LssMaster, *slaves: LssSlave, now: int = 0) -> list[LssRequest]:
    """Serve the bus until the master is done; return the finished requests."""
    while (deadline := master.next_deadline()) is not None:
        now = max(now, deadline)
        master.tick(now)
        while asked := master.frames():  # an answer may bring the next question at once
            for question, slave in product(asked, slaves):
                slave.receive(question, now)
            for slave in slaves:
                for answer in slave.frames():
                    master.receive(answer, now)
    return master.events()


def questions(master: LssMaster) -> list:
    master.tick(0)
    return master.frames()


@pytest.mark.parametrize(
    ("verb", "names"),
    [
        (lambda m: m.switch_global(LssMode.WAITING), ["switch global: waiting"]),
        (lambda m: m.switch_global(LssMode.CONFIGURATION), ["switch global: configuration"]),
        (
            lambda m: m.switch_selective(IDENTITY),
            [f"switch selective {part}" for part in ("vendor", "product", "revision", "serial")],
        ),
        (lambda m: m.configure_node_id(5), ["configure node-ID 5"]),
        (lambda m: m.configure_bit_timing(0), ["configure bit timing 1 Mbit/s (table 0 index 0)"]),
        (lambda m: m.configure_bit_timing(3), ["configure bit timing 250 kbit/s"]),
        (lambda m: m.activate_bit_timing(1000), ["activate bit timing delay 1000 ms"]),
        (lambda m: m.store(), ["store"]),
        (lambda m: m.inquire("vendor"), ["inquire vendor"]),
        (lambda m: m.inquire("product"), ["inquire product"]),
        (lambda m: m.inquire("revision"), ["inquire revision"]),
        (lambda m: m.inquire("serial"), ["inquire serial"]),
        (lambda m: m.inquire("node_id"), ["inquire node-ID"]),
        (
            lambda m: m.identify(LssIdentity(0x286, 0x4F6, 0, 0), LssIdentity(0x286, 0x4F6, 2**32 - 1, 2**32 - 1)),
            [
                f"identify remote slave {step}"
                for step in ("vendor", "product", "revision low", "revision high", "serial low", "serial high")
            ],
        ),
        (lambda m: m.identify_non_configured(), ["identify non-configured"]),
        (lambda m: m.fast_scan(), ["fastscan start (bitchecked 0x80)"]),
    ],
)
def test_the_questions_are_the_vectors(verb, names):
    master = LssMaster()
    verb(master)
    assert questions(master) == [FRAMES[name] for name in names]


def test_a_node_is_found_configured_and_stored():
    stored = []
    slave = LssSlave(IDENTITY, store=lambda node_id, rate: stored.append((node_id, rate)) is None)
    master = LssMaster()
    requests = [
        master.identify_non_configured(),
        master.fast_scan(),
        master.inquire("serial"),
        master.inquire("node_id"),
        master.configure_node_id(5),
        master.configure_bit_timing(3),
        master.store(),
        master.switch_global(LssMode.WAITING),
        master.identify_non_configured(),
    ]
    assert run(master, slave) == requests
    assert [request.error for request in requests] == [None] * 9
    assert [request.result for request in requests] == [True, IDENTITY, 0x12345678, 255, None, None, None, None, False]
    assert (slave.node_id, stored) == (5, [(5, 250_000)])


def test_selective_switching_and_identification():
    slave, other = LssSlave(IDENTITY, 3), LssSlave(IDENTITY._replace(serial=1), 4)
    master = LssMaster()
    low, high = IDENTITY._replace(serial=0), IDENTITY._replace(serial=9)
    requests = [master.switch_selective(IDENTITY), master.identify(low, high), master.identify(high, high)]
    run(master, slave, other)
    assert (slave.mode, other.mode) == (LssMode.CONFIGURATION, LssMode.WAITING)
    assert [request.result for request in requests] == [None, True, False]


def test_a_scan_of_an_empty_bus_finds_nobody_after_one_question():
    master = LssMaster(scan_timeout_ns=20 * MS)
    request = master.fast_scan()
    assert len(questions(master)) == 1
    assert master.next_deadline() == 20 * MS
    master.tick(20 * MS - 1)
    assert not request.done
    master.tick(20 * MS)
    assert (request.done, request.result, request.error) == (True, None, None)


@given(st.lists(st.builds(LssIdentity, *[st.integers(0, 2**32 - 1)] * 4), min_size=1, max_size=3, unique=True))
def test_scanning_finds_every_slave_one_after_the_other(identities):
    slaves = [LssSlave(identity) for identity in identities]
    master, found = LssMaster(), []
    for node_id in range(1, len(slaves) + 1):
        scan = master.fast_scan()
        master.configure_node_id(node_id)
        master.switch_global(LssMode.WAITING)
        run(master, *slaves)
        found.append(scan.result)
    assert sorted(found) == sorted(identities)
    assert sorted(slave.node_id for slave in slaves) == list(range(1, len(slaves) + 1))


def test_known_parts_are_only_confirmed():
    slave, master = LssSlave(IDENTITY), LssMaster()
    request = master.fast_scan(vendor=0x286, product=0x4F6, revision=0x0003001A, serial=0x12345678)
    run(master, slave)
    assert request.result == IDENTITY
    wrong = master.fast_scan(vendor=1)
    run(master, LssSlave(IDENTITY))
    assert isinstance(wrong.error, RemoteProtocolError)
    assert "vendor 0x00000001" in str(wrong.error)


def test_silence_is_an_error_where_a_slave_must_answer():
    master = LssMaster(timeout_ns=500 * MS)
    request, following = master.configure_node_id(5), master.store()
    assert len(questions(master)) == 1
    master.tick(500 * MS - 1)
    assert (request.done, master.next_deadline()) == (False, 500 * MS)
    master.tick(500 * MS)
    assert (request.done, following.done) == (True, False)
    assert "no answer" in str(request.error)
    assert master.frames() == [FRAMES["store"]]


@pytest.mark.parametrize(("answer", "reason"), [("1101", "out of range"), ("11FF07", "error 255, manufacturer's 7")])
def test_a_refusal_is_an_error_with_its_reason(answer, reason):
    master = LssMaster()
    request = master.configure_node_id(5)
    questions(master)
    master.receive(frame(f"7E4#{answer:0<16}"), 1)
    assert request.done
    assert reason in str(request.error)


def test_answers_nobody_waits_for_are_counted():
    master = LssMaster()
    master.receive(FRAMES["answer ok"], 0)
    request = master.store()
    master.receive(FRAMES["store answer ok"], 0)
    questions(master)
    for one in (FRAMES["answer ok"], frame("7E4#17"), frame("7E5#1700000000000000")):
        master.receive(one, 0)
    assert (request.done, master.stray) == (False, 4)


@pytest.mark.parametrize(
    "verb",
    [
        lambda m: m.configure_node_id(0),
        lambda m: m.configure_node_id(128),
        lambda m: m.configure_bit_timing(256),
        lambda m: m.activate_bit_timing(-1),
        lambda m: m.inquire("colour"),
    ],
)
def test_what_the_protocol_cannot_carry_is_refused_and_not_queued(verb):
    master = LssMaster()
    with pytest.raises(LocalProtocolError):
        verb(master)
    assert master.next_deadline() is None


def test_the_queue_has_an_end():
    master = LssMaster(queue_limit=2)
    master.store()
    master.store()
    with pytest.raises(LocalProtocolError, match="wait"):
        master.store()
