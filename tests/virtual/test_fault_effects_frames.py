"""Every fault of the wire is seen there, and the node is healthy again after it is switched off."""

from __future__ import annotations

import itertools
import struct

import pytest
from support.faulty import Faulty, bench, fault
from support.virtualbench import MS, ready_tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.frame import CanFrame


@pytest.mark.parametrize(
    ("name", "on", "off"),
    [
        (fault("heartbeat_lost"), 0, 5),
        (fault("silent"), 0, 5),
        (fault("duplicate_node"), 10, 5),
        (fault("bus_off"), 0, 5),
    ],
)
def test_heartbeats(name, on, off):
    b = bench()
    b.set(name)
    assert len(b.beats()) == on
    b.set(name, False)
    assert len(b.beats()) == off


def test_a_heartbeat_of_the_wrong_state():
    b = bench()
    b.start()
    b.set(fault("heartbeat_wrong_state"))
    assert set(b.beats()) == {b"\x7f"}
    b.set("heartbeat_wrong_state", False)
    assert set(b.beats()) == {b"\x05"}


def test_heartbeats_with_jitter():
    b = bench()
    b.set(fault("heartbeat_jitter"))
    times = [when for when, _ in b.sent(0x705, 3)]
    gaps = {round((y - x) / MS) for x, y in itertools.pairwise(times)}
    assert len(gaps) > 5
    assert max(gaps) <= 160
    b.set("heartbeat_jitter", False)
    b.on(0.2)
    times = [when for when, _ in b.sent(0x705, 1)]
    assert {y - x for x, y in itertools.pairwise(times)} == {100 * MS}


def test_a_late_boot():
    b = bench()
    b.set(fault("boot_late"))
    b.nmt(NmtCommand.RESET_NODE)
    assert b.beats(4.9) == []
    assert b.beats(0.2) == [b"\0"]
    b.set("boot_late", False)
    b.nmt(NmtCommand.RESET_NODE)
    assert b.beats(0.1) == [b"\0"]


def test_no_boot():
    b = bench()
    b.set(fault("no_boot"))
    b.nmt(NmtCommand.RESET_NODE)
    assert b.beats(60) == []
    assert b.answers() is None
    b.set("no_boot", False)
    b.on(0.01)
    assert [frame.data for _, frame in b.seen if frame.can_id == 0x705] == [b"\0"]
    assert b.answers() is not None


def test_a_spontaneous_reset():
    b = bench().enable(3)
    b.write(0x6083, 777)
    b.set(fault("spontaneous_reset"))
    assert b.beats(0.1) == [b"\0"]
    assert (b.state, b.number(0x6083), b.board.active) == ("SWITCH_ON_DISABLED", 10000, [])


def test_leaving_operational_and_not_hearing_start():
    b = bench()
    b.start()
    b.set(fault("leaves_operational"))
    assert set(b.beats()) == {b"\x7f"}
    b.set(fault("nmt_start_ignored"))
    b.start()
    assert set(b.beats()) == {b"\x7f"}
    b.set("nmt_start_ignored", False)
    b.start()
    assert set(b.beats()) == {b"\x05"}


def test_operational_without_a_command():
    b = bench()
    b.set(fault("already_operational"))
    assert b.node.operational
    b.nmt(NmtCommand.RESET_NODE)
    b.on(0.1)
    assert b.node.operational
    b.set("already_operational", False)
    b.nmt(NmtCommand.RESET_NODE)
    b.on(0.1)
    assert not b.node.operational


@pytest.mark.parametrize(
    ("name", "index", "sub", "observed"),
    [
        (fault("sdo_silent"), 0x1000, 0, None),
        (fault("optional_missing"), 0x603F, 0, 0x06020000),
        (fault("sdo_short_answer"), 0x1000, 0, b"\x92"),
    ],
)
def test_sdo_answers(name, index, sub, observed):
    b = bench()
    healthy = b.answers(index, sub)
    b.set(name)
    assert b.answers(index, sub) == observed
    b.set(name, False)
    assert b.answers(index, sub) == healthy


def test_one_lost_sdo_request():
    b = bench()
    b.set(fault("sdo_silent_once"))
    assert b.answers() is None
    assert b.answers() == b"\x92\x01\x02\x00"
    assert b.board.active == []


def test_an_answer_for_another_object():
    b = bench()
    b.set(fault("sdo_wrong_mux"))
    assert b.request(bytes.fromhex("4000100000000000"))[1:4].hex() == "011000"
    b.set("sdo_wrong_mux", False)
    assert b.request(bytes.fromhex("4000100000000000"))[1:4].hex() == "001000"


def test_a_late_answer():
    b = bench()
    b.set(fault("sdo_late"))
    start = b.now
    assert b.answers() is None
    assert [when - start for when, _ in b.sent(0x585, 1)] == [700 * MS]
    b.set("sdo_late", False)
    assert b.answers() == b"\x92\x01\x02\x00"


@pytest.mark.parametrize(
    ("name", "index", "value", "code"),
    [(fault("sdo_busy"), 0x6083, 5, 0x08000022), (fault("mapping_fixed"), 0x1600, 0, 0x06010002)],
)
def test_refused_writes(name, index, value, code):
    b = bench()
    b.write(0x1400, 0x80000205, 1)
    b.set(name)
    assert b.abort_of(index, value) == code
    b.set(name, False)
    assert b.abort_of(index, value) is None


def test_segments():
    b = bench()
    b.set(fault("sdo_toggle_error"))
    b.request(bytes.fromhex("4008100000000000"))
    assert b.request(b"\x60" + bytes(7))[0] & 0x10
    b.set("sdo_toggle_error", False)
    b.set(fault("sdo_segment_lost"))
    b.request(bytes.fromhex("4008100000000000"))
    assert b.request(b"\x60" + bytes(7)) is None
    b.set("sdo_segment_lost", False)
    assert b.read(0x1008) == b"a servo drive"


def test_no_block_transfer():
    b = bench()
    block = bytes.fromhex("A408100010000000")
    b.set(fault("sdo_no_block"))
    assert b.request(block) == bytes.fromhex("8008100001000405")
    b.set("sdo_no_block", False)
    assert b.request(block)[0] & 0xE0 == 0xC0


@pytest.mark.parametrize(
    ("name", "length"), [(fault("tpdo_short"), 2), (fault("tpdo_long"), 4), (fault("tpdo_missing"), None)]
)
def test_tpdos(name, length):
    b = bench()
    b.start()

    def lengths():
        b.seen.clear()
        b.sync()
        return [len(frame.data) for _, frame in b.seen if frame.can_id == 0x185]

    b.set(name)
    assert lengths() == ([] if length is None else [length])
    b.set(name, False)
    assert lengths() == [3]


def test_late_tpdos_and_unheard_syncs():
    b = bench()
    b.start()
    b.set(fault("tpdo_late"))
    b.sync()
    start = b.now
    assert [when - start for when, _ in b.sent(0x185, 0.2)] == [70 * MS]
    b.set("tpdo_late", False)
    b.set(fault("sync_deaf"))
    b.seen.clear()
    b.sync()
    assert b.seen == []
    b.set("sync_deaf", False)
    b.sync()
    assert len(b.seen) == 2


def test_emcy_messages():
    b = bench()
    b.set(fault("emcy_flood"))
    assert 990 <= len(b.sent(0x085, 1)) <= 1010
    b.set("emcy_flood", False)
    assert b.sent(0x085, 1) == []
    b.seen.clear()
    b.set(fault("emcy_short"))
    b.set(fault("emcy_partial_reset"))
    assert [frame.data.hex() for _, frame in b.seen if frame.can_id == 0x085] == ["cdab8107", "0000090000000000"]
    assert b.board.active == []
    b.seen.clear()
    b.set(fault("error_passive"))
    b.set("error_passive", False)
    codes = [frame.data[:3].hex() for _, frame in b.seen if frame.can_id == 0x085]
    assert codes == ["208111", "000000"]


def test_coming_back_from_bus_off_is_reported():
    b = bench()
    b.set("bus_off")
    b.on(1)
    b.seen.clear()
    b.set("bus_off", False)
    b.on(0)
    assert [frame.data[:2].hex() for _, frame in b.seen if frame.can_id == 0x085] == ["4081", "0000"]


def test_a_second_node_boots_beats_and_answers_as_the_first_does():
    b = bench()
    b.write(0x1017, 100)
    b.seen.clear()
    b.set(fault("second_node"))
    assert b"\0" in [frame.data for _, frame in b.seen if frame.can_id == 0x705]  # its boot-up
    b.seen.clear()
    b.put(0x605, struct.pack("<BHB4x", 0x40, 0x1018, 4))
    answers = [frame.data[4:] for _, frame in b.seen if frame.can_id == 0x585]
    assert sorted(answers) == sorted(struct.pack("<I", serial) for serial in (5, 1005))
    b.put(0x605, struct.pack("<BHBI", 0x2B, 0x1017, 0, 100))  # both take it
    b.on(0.1)
    assert len(b.beats(1)) == 20
    b.set("second_node", False)
    b.on(0.1)
    assert len(b.beats(1)) == 10
    assert b.answers(0x1018, 4) == struct.pack("<I", 5)
    assert b.node.filter is None


def csp_steps(name, cycles=10_100):
    """Return the way of each cycle of 10 ms, of set-points one count further each."""
    b = bench()
    if name:
        b.set(name)
    b.enable(8)
    ways, last = [], 0.0
    for cycle in range(1, cycles):
        b.node.receive(CanFrame(0x305, struct.pack("<ii", 1000 * cycle, 0)), b.now)
        b.on(0.01)
        here = b.drive.mover.plant.position
        ways.append(round((here - last) / 1000))
        last = here
        b.seen.clear()
    return ways[5:]


def test_a_drive_with_the_masters_clock_follows_every_set_point():
    assert set(csp_steps("", 200)) == {1}


@pytest.mark.rest
@pytest.mark.parametrize(("name", "odd", "beat"), [(fault("clock_fast"), 0, 99.99), (fault("clock_slow"), 2, 100.01)])
def test_a_clock_that_drifts_repeats_or_misses_a_set_point_once_in_ten_thousand(name, odd, beat):
    ways = csp_steps(name)
    assert set(ways) == {1, odd}
    assert ways.count(odd) == 1
    b = bench()
    b.set(name)
    times = [when / MS for when, _ in b.sent(0x705, 1)]
    assert [y - x for x, y in itertools.pairwise(times)] == pytest.approx([beat] * (len(times) - 1))
    b.set(name, False)
    b.on(0.2)
    times = [when for when, _ in b.sent(0x705, 1)]
    assert {y - x for x, y in itertools.pairwise(times)} == {100 * MS}


def test_a_turning_tmcm_keeps_turning_when_its_heartbeats_are_lost():
    b = Faulty(ready_tmcm().node)
    b.write(0x60FF, 1600)
    b.set("heartbeat_lost")
    b.on(1)
    assert b.velocity == 1600
