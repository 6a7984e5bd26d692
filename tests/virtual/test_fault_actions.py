"""Every switch is seen on the wire, and the drive is healthy again after it is switched off."""

from __future__ import annotations

import itertools
import struct

import pytest
from support.virtualbench import MS, Aborted, Bench, ready_tmcm, servo, tmcm

from canopen_control.cia301.nmt import NmtCommand
from canopen_control.frame import CanFrame
from canopen_control.virtual.faults import FAULTS
from canopen_control.virtual.switchboard import FaultSwitches


class Faulty(Bench):
    """A bench with its switchboard."""

    def __init__(self, node):
        super().__init__(node)
        self.board = node.switches or FaultSwitches(node)

    def set(self, name, on=True):
        self.board.set(name, on, self.now)
        self.collect()

    def sent(self, can_id, seconds):
        self.seen.clear()
        self.on(seconds)
        return [(when, frame.data) for when, frame in self.seen if frame.can_id == can_id]

    def beats(self, seconds=0.5):
        return [data for _, data in self.sent(0x705, seconds)]

    def answers(self, index=0x1000, sub=0):
        try:
            return self.read(index, sub)
        except Aborted as error:
            return error.code


def bench(**kwargs):
    b = Faulty(servo(**kwargs))
    b.write(0x1017, 100)
    b.on(0.01)
    return b


TESTED = set()


def fault(name):
    TESTED.add(name)
    assert name in FAULTS
    return name


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
    ("name", "index", "sub", "seen"),
    [
        (fault("sdo_silent"), 0x1000, 0, None),
        (fault("optional_missing"), 0x603F, 0, 0x06020000),
        (fault("sdo_short_answer"), 0x1000, 0, b"\x92"),
    ],
)
def test_sdo_answers(name, index, sub, seen):
    b = bench()
    healthy = b.answers(index, sub)
    b.set(name)
    assert b.answers(index, sub) == seen
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


def test_coming_back_from_bus_off_is_told():
    b = bench()
    b.set("bus_off")
    b.on(1)
    b.seen.clear()
    b.set("bus_off", False)
    b.on(0)
    assert [frame.data[:2].hex() for _, frame in b.seen if frame.can_id == 0x085] == ["4081"]


@pytest.mark.parametrize(
    ("name", "code"),
    [
        (fault("drive_fault"), 0x4310),
        (fault("short_circuit"), 0x2320),
        (fault("undervoltage"), 0x3220),
        (fault("following_error"), 0x8611),
    ],
)
def test_a_fault_whose_cause_lasts(name, code):
    b = bench().enable(3)
    b.seen.clear()
    b.set(name)
    b.on(0.1)
    assert b.state == "FAULT"
    assert [frame.data[:2] for _, frame in b.seen if frame.can_id == 0x085] == [struct.pack("<H", code)]
    b.control(0x80)
    assert b.state == "FAULT"
    b.set(name, False)
    b.control(0)
    b.control(0x80)
    assert b.state == "SWITCH_ON_DISABLED"
    b.enable(3)
    assert b.state == "OPERATION_ENABLED"


def test_a_fault_that_needs_a_reset_of_the_communication():
    b = bench().enable(3)
    b.set(fault("fault_needs_reset"))
    b.on(0.1)
    for word in (0x80, 0, 0x80, 0):
        b.control(word)
    assert b.state == "FAULT"
    b.nmt(NmtCommand.RESET_COMMUNICATION)
    b.on(0.1)
    b.control(0x80)
    assert b.state == "SWITCH_ON_DISABLED"


def test_a_fault_on_enable_and_a_reset_that_is_not_heard():
    b = bench()
    b.set(fault("fault_on_enable"))
    b.enable(3)
    b.on(0.1)
    assert (b.state, b.number(0x603F)) == ("FAULT", 0x5441)
    b.set("fault_on_enable", False)
    b.set(fault("fault_reset_ignored"))
    b.control(0x80)
    assert b.state == "FAULT"
    b.set("fault_reset_ignored", False)
    b.control(0)
    b.control(0x80)
    b.enable(3)
    assert b.state == "OPERATION_ENABLED"


def test_slow_transitions():
    b = bench()
    b.start()
    b.set(fault("transition_slow"))
    b.control(6)
    b.on(1.9)
    assert b.state == "SWITCH_ON_DISABLED"
    b.on(0.2)
    assert b.state == "READY_TO_SWITCH_ON"
    b.control(0x0F)  # held: 3, then 4
    b.on(4.1)
    assert b.state == "OPERATION_ENABLED"
    b.set("transition_slow", False)
    b.control(7)
    b.on(0)
    assert b.state == "SWITCHED_ON"


def test_the_power_stage_off():
    b = bench().enable(3)
    b.set(fault("power_stage_off"))
    assert b.state == "SWITCH_ON_DISABLED"
    assert not b.statusword & 0x10
    b.set("power_stage_off", False)
    b.enable(3)
    assert b.statusword & 0x7F == 0x37


@pytest.mark.parametrize(
    ("name", "mask", "faulty"),
    [
        (fault("undefined_statusword"), 0xFFFF, 0x0001),
        (fault("local_control"), 0x0200, 0),
        (fault("warning"), 0x0080, 0x0080),
        (fault("pp_ack_stuck"), 0x1000, 0x1000),
        (fault("target_reached_stale"), 0x0400, 0x0400),
        (fault("pp_ack_missing"), 0x1000, 0),
    ],
)
def test_bits_of_the_statusword(name, mask, faulty):
    b = bench().enable(1)
    b.write(0x607A, 5000)
    if name != "pp_ack_stuck":
        b.control(0x1F)
    b.on(0.1)
    healthy = b.number(0x6041) & mask
    assert healthy != faulty
    b.set(name)
    assert b.number(0x6041) & mask == faulty
    b.set(name, False)
    assert b.number(0x6041) & mask == healthy


def test_the_mode_display():
    b = bench()
    b.write(0x6060, 1)
    b.set(fault("mode_display_stuck"))
    b.write(0x6060, 3)
    b.on(10)
    assert b.number(0x6061) == 1
    b.set("mode_display_stuck", False)
    b.write(0x6060, 3)
    assert b.number(0x6061) == 3
    b.set(fault("mode_display_late"))
    b.write(0x6060, 8)
    b.on(0.19)
    assert b.number(0x6061) == 3
    b.on(0.02)
    assert b.number(0x6061) == 8
    b.set("mode_display_late", False)
    b.write(0x6060, 3)
    assert b.number(0x6061) == 3


def test_positions():
    b = bench()
    b.set(fault("hand_moved"))
    assert b.position == 500
    b.set(fault("position_jump"))
    assert b.position == 1_000_500
    b.set(fault("position_wrap"))
    assert b.position == 0x7FFFFFFF - 1000
    b.enable(3)
    b.write(0x60FF, 10_000)
    b.on(1.5)
    assert b.position < 0
    b.set(fault("direction_inverted"))
    assert b.velocity == -10_000
    b.set("direction_inverted", False)
    assert b.velocity == 10_000


def test_a_limit_switch():
    b = bench().enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    b.set(fault("limit_switch"))
    b.on(1)
    assert b.velocity == 0
    assert b.statusword & 0x0800
    assert b.number(0x60FD) & 2
    b.write(0x60FF, 2000)
    b.on(1)
    assert b.velocity == 0
    b.write(0x60FF, -1000)
    b.on(1)
    assert b.velocity == -1000
    b.set("limit_switch", False)
    b.write(0x60FF, 1000)
    b.on(2)
    assert b.velocity == 1000


def test_the_tmcm_1270_reports_its_limit_switch_unless_its_switches_are_disabled():
    b = Faulty(tmcm())
    for index in (0x6083, 0x6085):
        b.write(index, 16000)
    b.enable(3)
    b.write(0x60FF, 1000)
    b.on(1)
    b.seen.clear()
    b.set("limit_switch")
    b.on(1)
    assert [frame.data[:4].hex() for _, frame in b.seen if frame.can_id == 0x083] == ["01ff8103"]
    b.write(0x2005, 3)
    b.write(0x60FF, 900)
    b.on(1)
    assert b.velocity == 900


def test_homing_that_fails_and_homing_without_end():
    b = bench(x6098=17).enable(6)
    b.set(fault("homing_fails"))
    b.control(0x1F)
    b.on(1)
    assert b.statusword & 0x3400 == 0x2400
    b.set("homing_fails", False)
    b.control(0x0F)
    b.set(fault("homing_endless"))
    b.control(0x1F)
    b.on(600)
    assert b.statusword & 0x3400 == 0
    b.set("homing_endless", False)
    b.control(0x0F)
    b.on(10)
    b.control(0x1F)
    b.on(10_000)  # from far beyond the switch, slowly
    assert b.statusword & 0x3400 == 0x1400


@pytest.mark.parametrize(("name", "sub"), [(fault("wrong_identity"), 2), (fault("wrong_revision"), 3)])
def test_the_identity(name, sub):
    b = bench()
    healthy = b.number(0x1018, sub)
    b.set(name)
    assert b.number(0x1018, sub) == healthy + 1
    b.set(name, False)
    assert b.number(0x1018, sub) == healthy


def test_a_clamped_parameter():
    b = bench()
    b.set(fault("parameter_clamped"))
    b.write(0x6083, 5000)
    assert b.number(0x6083) == 1000
    b.set("parameter_clamped", False)
    b.write(0x6083, 5000)
    assert b.number(0x6083) == 5000


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


def test_every_switch_is_tested_here():
    assert set(FAULTS) == TESTED


def test_a_turning_tmcm_keeps_turning_when_its_heartbeats_are_lost():
    b = Faulty(ready_tmcm().node)
    b.write(0x60FF, 1600)
    b.set("heartbeat_lost")
    b.on(1)
    assert b.velocity == 1600
