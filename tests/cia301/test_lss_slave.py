from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from support.services import frame, vectors

from canopen_control.cia301.lss import LssActivateBitTiming, LssIdentity, LssMode, LssNodeIdAssigned, LssSlave

if TYPE_CHECKING:
    from canopen_control.frame import CanFrame

FRAMES = {vector["name"]: frame(vector["frame"]) for vector in vectors()["lss"]["vectors"]}
IDENTITY = LssIdentity(0x286, 0x4F6, 0x0003001A, 0x12345678)
PARTS = [FRAMES[f"switch selective {part}"] for part in ("vendor", "product", "revision", "serial")]


def ask(slave: LssSlave, *frames: CanFrame | str) -> list[CanFrame]:
    for one in frames:
        slave.receive(FRAMES[one] if isinstance(one, str) else one, 0)
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
    assert ask(slave, *PARTS) == [FRAMES["switch selective answer"]]
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
    assert ask(slave, "configure node-ID 5") == [FRAMES["answer ok"]]
    assert slave.pending_node_id == 5
    assert ask(slave, frame("7E5#1180000000000000")) == [FRAMES["answer node-ID out of range"]]
    assert ask(slave, frame("7E5#1100000000000000")) == [FRAMES["answer node-ID out of range"]]
    assert ask(slave, frame("7E5#11FF000000000000")) == [FRAMES["answer ok"]]
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


def test_automatic_bit_timing_is_zero():
    slave = configuring(bit_timings=frozenset({9}))
    ask(slave, frame("7E5#1300090000000000"))
    assert slave.pending_bitrate == 0


def test_storing():
    stored = []

    def store(node_id: int, bitrate: int | None) -> bool:
        stored.append((node_id, bitrate))
        return node_id != 6

    slave = configuring(store=store)
    assert ask(slave, "configure node-ID 5", "store")[1:] == [FRAMES["store answer ok"]]
    assert ask(slave, frame("7E5#1106000000000000"), "store")[1].data[:2] == b"\x17\2"
    assert stored == [(5, None), (6, None)]
    assert ask(configuring(), "store")[0].data[:2] == b"\x17\1"


def test_inquiries():
    slave = configuring()
    assert ask(slave, "inquire vendor") == [FRAMES["inquire vendor answer"]]
    assert ask(slave, "inquire node-ID") == [FRAMES["inquire node-ID answer 3"]]
    answers = ask(slave, "inquire product", "inquire revision", "inquire serial")
    assert [int.from_bytes(f.data[1:5], "little") for f in answers] == list(IDENTITY[1:])


def test_identification_of_a_range():
    slave = LssSlave(IDENTITY, 3)
    steps = ["vendor", "product", "revision low", "revision high", "serial low", "serial high"]
    frames = [FRAMES[f"identify remote slave {step}"] for step in steps]
    assert ask(slave, *frames) == [FRAMES["identify slave answer"]]
    assert ask(slave, *frames[:3], frame("7E5#4919000300000000"), *frames[4:]) == []
    assert ask(slave, *frames[1:]) == []


def test_only_an_unconfigured_node_answers_as_such():
    assert ask(LssSlave(IDENTITY), "identify non-configured") == [FRAMES["identify non-configured answer"]]
    assert ask(LssSlave(IDENTITY, 3), "identify non-configured", "fastscan start (bitchecked 0x80)") == []


def test_fast_scan_by_the_vectors():
    slave, found = LssSlave(IDENTITY), [FRAMES["identify slave answer"]]
    assert ask(slave, "fastscan start (bitchecked 0x80)") == found
    assert ask(slave, "fastscan vendor bit 31") == found
    assert ask(slave, frame("7E5#51000000800A0000")) == []
    assert ask(slave, "fastscan vendor confirm next=product") == found
    assert ask(slave, "fastscan vendor bit 31") == []
    assert ask(slave, frame("7E5#51F6040000000102"), frame("7E5#511A000300000203")) == found * 2
    assert slave.mode is LssMode.WAITING
    assert ask(slave, "fastscan serial confirm next=vendor (slave enters configuration)") == found
    assert slave.mode is LssMode.CONFIGURATION


def test_impossible_scan_questions_and_wrong_lengths_are_counted():
    slave = LssSlave(IDENTITY)
    for text in ("7E5#5100000000200000", "7E5#5100000000000400", "7E5#5100000000000004"):
        assert ask(slave, frame(text)) == []
    assert slave.ignored == 3
    assert ask(slave, frame("7E5#04"), frame("7E5#9900000000000000"), frame("7E4#0401000000000000")) == []
    assert (slave.malformed, slave.mode) == (2, LssMode.WAITING)
