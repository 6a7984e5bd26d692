from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.services import MS, frame, vectors

from canopen_control.cia301.lss import (
    BIT_TIMINGS,
    LssActivateBitTiming,
    LssCommand,
    LssIdentity,
    LssMaster,
    LssMode,
    LssNodeIdAssigned,
    LssRequest,
    LssSlave,
    bit_timing_index,
    lss_frame,
)
from canopen_control.errors import LocalProtocolError, RemoteProtocolError

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame


FRAMES_OF_SLAVE = {vector["name"]: frame(vector["frame"]) for vector in vectors()["lss"]["vectors"]}
IDENTITY = LssIdentity(0x286, 0x4F6, 0x0003001A, 0x12345678)
PARTS = [FRAMES_OF_SLAVE[f"switch selective {part}"] for part in ("vendor", "product", "revision", "serial")]


def ask(slave: LssSlave, *frames: CanFrame | str) -> list[CanFrame]:
    for one in frames:
        slave.receive(FRAMES_OF_SLAVE[one] if isinstance(one, str) else one, 0)
    return slave.frames()


def configuring(node_id: int = 3, **settings: object) -> LssSlave:
    slave = LssSlave(IDENTITY, node_id, **settings)
    assert ask(slave, "switch global: configuration") == []
    return slave


def test_global_switching_is_unconfirmed():
    slave = configuring()
    assert slave.mode is LssMode.CONFIGURATION
    assert ask(slave, "switch global: waiting") == []
    assert slave.mode is LssMode.WAITING
    ask(slave, frame("7E5#0407000000000000"))
    assert slave.ignored == 1


def test_the_four_parts_in_order_select_the_slave():
    slave = LssSlave(IDENTITY, 3)
    assert ask(slave, *PARTS) == [FRAMES_OF_SLAVE["switch selective answer"]]
    assert slave.mode is LssMode.CONFIGURATION


@pytest.mark.parametrize(
    "parts",
    [PARTS[:3], PARTS[1:], [PARTS[0], PARTS[2], PARTS[1], PARTS[3]], [*PARTS[:3], frame("7E5#4379563412000000")]],
)
def test_a_missing_swapped_or_wrong_part_does_not(parts):
    slave = LssSlave(IDENTITY, 3)
    assert ask(slave, *parts) == []
    assert slave.mode is LssMode.WAITING


def test_node_id_in_and_out_of_range():
    slave = configuring()
    assert ask(slave, "configure node-ID 5") == [FRAMES_OF_SLAVE["answer ok"]]
    assert slave.pending_node_id == 5
    assert ask(slave, frame("7E5#1180000000000000")) == [FRAMES_OF_SLAVE["answer node-ID out of range"]]
    assert ask(slave, frame("7E5#1100000000000000")) == [FRAMES_OF_SLAVE["answer node-ID out of range"]]
    assert ask(slave, frame("7E5#11FF000000000000")) == [FRAMES_OF_SLAVE["answer ok"]]
    assert slave.pending_node_id == 255


def test_a_configured_node_takes_its_node_id_at_reset_communication():
    slave = configuring()
    ask(slave, "configure node-ID 5", "switch global: waiting")
    assert (slave.node_id, slave.events()) == (3, [])
    slave.reset()
    assert slave.node_id == 5


def test_an_unconfigured_node_takes_its_node_id_when_switched_back():
    slave = configuring(255)
    ask(slave, "configure node-ID 5", "switch global: waiting", "switch global: waiting")
    assert (slave.node_id, slave.events()) == (5, [LssNodeIdAssigned(5)])


@pytest.mark.parametrize(
    "name",
    [
        "configure node-ID 5",
        "configure bit timing 250 kbit/s",
        "activate bit timing delay 1000 ms",
        "store",
        "inquire vendor",
        "inquire node-ID",
    ],
)
def test_a_waiting_slave_does_not_serve_configuration(name):
    slave = LssSlave(IDENTITY, 3)
    assert ask(slave, name) == []
    assert (slave.ignored, slave.pending_node_id, slave.events()) == (1, 3, [])


def test_bit_timings():
    slave = configuring(bit_timings=frozenset({0, 3}))
    assert ask(slave, "activate bit timing delay 1000 ms") == []
    assert slave.events() == []
    for name, code in (("250 kbit/s", 0), ("125 kbit/s", 1)):
        assert ask(slave, f"configure bit timing {name}")[0].data[:2] == bytes((0x13, code))
    assert ask(slave, frame("7E5#1301000000000000"))[0].data[1] == 1
    ask(slave, "activate bit timing delay 1000 ms")
    assert slave.events() == [LssActivateBitTiming(250_000, 1000)]


def test_storing():
    stored = []

    def store(node_id: int, bitrate: int | None) -> bool:
        stored.append((node_id, bitrate))
        return node_id != 6

    slave = configuring(store=store)
    assert ask(slave, "configure node-ID 5", "store")[1:] == [FRAMES_OF_SLAVE["store answer ok"]]
    assert ask(slave, frame("7E5#1106000000000000"), "store")[1].data[:2] == b"\x17\2"
    assert stored == [(5, None), (6, None)]
    assert ask(configuring(), "store")[0].data[:2] == b"\x17\1"


def test_inquiries():
    slave = configuring()
    assert ask(slave, "inquire vendor") == [FRAMES_OF_SLAVE["inquire vendor answer"]]
    assert ask(slave, "inquire node-ID") == [FRAMES_OF_SLAVE["inquire node-ID answer 3"]]
    answers = ask(slave, "inquire product", "inquire revision", "inquire serial")
    assert [int.from_bytes(f.data[1:5], "little") for f in answers] == list(IDENTITY[1:])


def test_identification_of_a_range():
    slave = LssSlave(IDENTITY, 3)
    steps = ["vendor", "product", "revision low", "revision high", "serial low", "serial high"]
    frames = [FRAMES_OF_SLAVE[f"identify remote slave {step}"] for step in steps]
    assert ask(slave, *frames) == [FRAMES_OF_SLAVE["identify slave answer"]]
    assert ask(slave, *frames[:3], frame("7E5#4919000300000000"), *frames[4:]) == []
    assert ask(slave, *frames[1:]) == []


def test_only_an_unconfigured_node_answers_as_such():
    assert ask(LssSlave(IDENTITY), "identify non-configured") == [FRAMES_OF_SLAVE["identify non-configured answer"]]
    assert ask(LssSlave(IDENTITY, 3), "identify non-configured", "fastscan start (bitchecked 0x80)") == []


def test_fast_scan_by_the_vectors():
    slave, result = LssSlave(IDENTITY), [FRAMES_OF_SLAVE["identify slave answer"]]
    assert ask(slave, "fastscan start (bitchecked 0x80)") == result
    assert ask(slave, "fastscan vendor bit 31") == result
    assert ask(slave, frame("7E5#51000000800A0000")) == []
    assert ask(slave, "fastscan vendor confirm next=product") == result
    assert ask(slave, "fastscan vendor bit 31") == []
    assert ask(slave, frame("7E5#51F6040000000102"), frame("7E5#511A000300000203")) == result * 2
    assert slave.mode is LssMode.WAITING
    assert ask(slave, "fastscan serial confirm next=vendor (slave enters configuration)") == result
    assert slave.mode is LssMode.CONFIGURATION


def test_impossible_scan_questions_and_wrong_lengths_are_counted():
    slave = LssSlave(IDENTITY)
    for text in ("7E5#5100000000200000", "7E5#5100000000000400", "7E5#5100000000000004"):
        assert ask(slave, frame(text)) == []
    assert slave.ignored == 3
    assert ask(slave, frame("7E5#04"), frame("7E5#9900000000000000"), frame("7E4#0401000000000000")) == []
    assert (slave.malformed, slave.mode) == (2, LssMode.WAITING)


FRAMES_OF_MASTER = {vector["name"]: frame(vector["frame"]) for vector in vectors()["lss"]["vectors"]}


def run(master: LssMaster, *slaves: LssSlave, now: int = 0) -> list[LssRequest]:
    """Serve the bus until the master is done; return the finished requests."""
    while (deadline := master.next_deadline()) is not None:
        now = max(now, deadline)
        master.tick(now)
        while requested := master.frames():  # an answer may bring the next question at once
            for question, slave in product(requested, slaves):
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
        (lambda m: m.open_fast_scan(), ["fastscan start (bitchecked 0x80)"]),
    ],
)
def test_the_questions_are_the_vectors(verb, names):
    master = LssMaster()
    verb(master)
    assert questions(master) == [FRAMES_OF_MASTER[name] for name in names]


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


def test_a_scan_of_an_empty_bus_finds_no_node_after_one_request():
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
    master, results = LssMaster(), []
    for node_id in range(1, len(slaves) + 1):
        scan = master.fast_scan()
        master.configure_node_id(node_id)
        master.switch_global(LssMode.WAITING)
        run(master, *slaves)
        results.append(scan.result)
    assert sorted(results) == sorted(identities)
    assert sorted(slave.node_id for slave in slaves) == list(range(1, len(slaves) + 1))


def test_opening_a_fast_scan_only_asks():
    slaves, master = [LssSlave(IDENTITY), LssSlave(IDENTITY._replace(serial=2)), LssSlave(IDENTITY, 3)], LssMaster()
    request = master.open_fast_scan()
    run(master, *slaves)
    assert request.result is True
    assert {slave.mode for slave in slaves} == {LssMode.WAITING}
    request = master.open_fast_scan()
    run(master, slaves[2])
    assert request.result is False


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
    assert master.frames() == [FRAMES_OF_MASTER["store"]]


@pytest.mark.parametrize(
    ("answer", "reason"), [("1101", "out of range"), ("11FF07", "error 255, manufacturer-specific code 7")]
)
def test_a_refusal_is_an_error_with_its_reason(answer, reason):
    master = LssMaster()
    request = master.configure_node_id(5)
    questions(master)
    master.receive(frame(f"7E4#{answer:0<16}"), 1)
    assert request.done
    assert reason in str(request.error)


def test_answers_without_a_pending_request_are_counted():
    master = LssMaster()
    master.receive(FRAMES_OF_MASTER["answer ok"], 0)
    request = master.store()
    master.receive(FRAMES_OF_MASTER["store answer ok"], 0)
    questions(master)
    for one in (FRAMES_OF_MASTER["answer ok"], frame("7E4#17"), frame("7E5#1700000000000000")):
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


LSS = vectors()["lss"]
FRAMES = {vector["name"]: frame(vector["frame"]) for vector in LSS["vectors"]}

BUILT = {
    "switch global: waiting": lss_frame(LssCommand.SWITCH_GLOBAL, 0),
    "switch global: configuration": lss_frame(LssCommand.SWITCH_GLOBAL, 1),
    "switch selective vendor": lss_frame(LssCommand.SWITCH_SELECTIVE, 0x286),
    "switch selective answer": lss_frame(LssCommand.SWITCHED, cob_id=0x7E4),
    "fastscan serial confirm next=vendor (slave enters configuration)": lss_frame(
        LssCommand.FAST_SCAN, 0x12345678, tail=bytes((0, 3, 0))
    ),
}


@pytest.mark.parametrize("name", BUILT)
def test_frames_are_the_vectors(name):
    assert BUILT[name] == FRAMES[name]


def test_bit_timings_are_the_vectors():
    table = {int(index): rate for index, rate in LSS["bit_timing_table_0"].items() if isinstance(rate, int)}
    assert {index: rate // 1000 for index, rate in BIT_TIMINGS.items()} == table
    assert [bit_timing_index(rate) for rate in (1_000_000, 250_000, 12345)] == [0, 3, None]
