"""Every quirk is seen on the wire, is not there without it, and ends when it is switched off."""

from __future__ import annotations

import pytest
from support.quirky import Quirky
from support.virtualbench import BIT_12, LIMIT, REACHED, T, entry, generic, servo, servo_od

from canopen_control.virtual.device import make_device
from canopen_control.virtual.quirk_table import QUIRKS

REMOTE, VOLTAGE, WARNING = 1 << 9, 1 << 4, 1 << 7
NO_OBJECT, READ_ONLY, DEVICE_STATE, INVALID = 0x06020000, 0x06010002, 0x08000022, 0x06090030


def word(bits, *, value=True, before=lambda b: None):
    """Look for bits of the statusword that are all set, or all clear."""

    def probe(b):
        before(b)
        return b.statusword & bits == (bits if value else 0)

    return probe


def state(name, *words, before=lambda b: b.enable(3), seconds=0.0):
    """Look for a state after controlwords."""

    def probe(b):
        before(b)
        for each in words:
            b.control(each)
        b.on(seconds)
        return b.state == name

    return probe


def shown_mode(mode, before, then=9):
    """Look for the mode that is shown after another was written."""

    def probe(b):
        before(b)
        b.write(0x6060, then)
        return b.number(0x6061, signed=True) == mode

    return probe


def refused(index, value, code, sub=0, before=lambda b: None):
    """Look for the abort code of a write."""

    def probe(b):
        before(b)
        return b.abort_of(index, value, sub) == code

    return probe


def absent(index):
    return lambda b: b.code_of(index) == NO_OBJECT


def own_mode(mode, target, value, moves):
    def probe(b):
        if b.abort_of(0x6060, mode) is not None:
            return False
        b.enable()
        b.write(target, value)
        b.on(0.05)
        return moves(b)

    return probe


def late_mode(b):
    b.enable(8)
    first = b.number(0x6061, signed=True)
    b.on(4.1)
    return (first, b.number(0x6061)) == (-1, 8)


def brake(b):
    b.enable(3)
    b.write(0x60FF, 100)
    b.on(0.4)
    early = b.state, b.velocity
    b.on(0.2)
    return early == ("OPERATION_ENABLED", 0) and b.velocity == 100


def empty_link(b):
    b.faulted()
    for each in (0x80, 0x06):
        b.control(each)
    early = b.state, b.statusword & VOLTAGE
    b.on(3.1)
    b.control(0x06)
    return early == ("SWITCH_ON_DISABLED", 0) and b.state == "READY_TO_SWITCH_ON"


def not_ready(b):
    b.reboot(0.5)
    early = b.state
    b.on(4)
    return early == "NOT_READY_TO_SWITCH_ON" and b.state == "SWITCH_ON_DISABLED"


def mains(b):
    b.break_with("power_stage_off")
    return state("SWITCH_ON_DISABLED", 6, 7, before=lambda b: b.start(), seconds=3.1)(b)


def stopped_supply(b):
    b.enable(3)
    b.break_with("power_stage_off")
    return b.state == "SWITCHED_ON"


def second_edge(b):
    b.faulted()
    b.control(0x80)
    early = b.state
    b.control(0)
    b.control(0x80)
    return (early, b.state) == ("FAULT", "SWITCH_ON_DISABLED")


def reset_after(seconds):
    def probe(b):
        b.faulted()
        b.control(0x80)
        b.on(seconds - 0.1)
        early = b.state
        b.on(0.2)
        return (early, b.state) == ("FAULT", "SWITCH_ON_DISABLED")

    return probe


def reset_level(b):
    b.faulted()
    b.control(0x80)
    b.on(0.5)
    b.control(0)
    b.on(1)
    early = b.state
    b.control(0x80)
    b.on(1.1)
    return (early, b.state) == ("FAULT", "SWITCH_ON_DISABLED")


def reaction(b):
    b.moving()
    b.drive.fault(0x2310, b.now)
    b.on(5)
    return b.state == "FAULT_REACTION_ACTIVE"


def enable_fault(b):
    b.enable(3)
    return (b.state, b.number(0x603F)) == ("FAULT", 0x5201)


def returning(b):
    b.enable(3)
    b.break_with("drive_fault")
    b.on(0.5)
    b.control(0x80)
    early = b.state
    b.on(0.1)
    return (early, b.state) == ("SWITCH_ON_DISABLED", "FAULT")


def first_enable(b):
    b.enable(3)
    early = b.state, b.number(0x603F)
    for each in (0x80, 0x06, 0x07, 0x0F):
        b.control(each)
    return early == ("FAULT", 0xFF00) and b.state == "OPERATION_ENABLED"


def torque_then_position(b):
    b.enable(10)
    b.write(0x6060, 8)
    b.on(0.01)
    return (b.state, b.number(0x603F)) == ("FAULT", 0x8A00)


def recorded(b):
    b.write(0x6060, 7)
    b.enable()
    b.control(0x1F)
    b.node.store.set(0x60C1, 2, 50)
    b.write(0x60C1, 20, 1)
    b.on(0.05)
    return b.position == 50


def first_request(b):
    b.reboot()
    return (b.read(0x1001), b.read(0x1001)) == (None, b"\0")


def mapped(b):
    free = b.abort_of(0x6040, 6)
    b.start()
    return free is None and b.abort_of(0x6040, 6) == DEVICE_STATE and b.abort_of(0x6083, 5) is None


def not_stored(b):
    b.write(0x1800, 0x80000181, 1)
    b.write(0x1017, 100)
    b.write(0x1010, 0x65766173, 1)
    b.reboot()
    return b.number(0x1017) == 100 and b.number(0x1800, 1) == 0x185


def judged_period(b):
    b.write(0x60C2, 10, 1)
    b.write(0x1006, 10_000)
    b.enable(8)
    good = b.state
    b.control(0)
    b.write(0x1006, 5_000)
    b.enable(8)
    b.on(0.1)
    return (good, b.state, b.number(0x603F)) == ("OPERATION_ENABLED", "FAULT", 0x8700)


def changing(bits, before=lambda b: None):
    def probe(b):
        before(b)
        seen = set()
        for _ in range(40):
            b.on(0.005)
            seen.add(b.statusword & bits)
        return len(seen) > 1

    return probe


def positioning(b, target=20_000):
    """In PP, on the way to a target that takes long."""
    b.write(0x6081, 10_000)
    b.enable(1)
    b.write(0x607A, target)
    b.control(0x1F)


def flickers(b):
    positioning(b, 50_000)
    return changing(REACHED)(b)


def inverted_reached(b):
    positioning(b)
    b.on(0.5)
    early = b.statusword & REACHED
    b.on(10)
    return (early, b.statusword & REACHED) == (REACHED, 0)


def second_set_point(b):
    positioning(b)
    b.control(0x0F)
    b.on(0.1)
    b.write(0x607A, -500)
    b.control(0x1F)
    return not b.statusword & BIT_12


def without_bit_5(b):
    positioning(b)
    early = b.statusword & BIT_12
    b.control(0x0F)
    b.control(0x3F)
    return not early and bool(b.statusword & BIT_12)


def acknowledged_on_the_way(b):
    positioning(b)
    b.control(0x0F)
    return bool(b.statusword & BIT_12)


def goes_on(b):
    last = b.stream()
    b.on(0.05)
    return b.position == last + 10


def supervised(b):
    b.stream()
    b.on(0.1)
    return (b.state, b.number(0x603F)) == ("FAULT", 0xFF02)


def turned(b):
    """Whether targets turn and the feedback does not: its sign is that of the shaft."""
    b.write(0x607E, 0xC0)
    b.moving()
    return b.velocity == -1000


def ramps(b):
    b.moving()
    b.write(0x60FF, 0)
    b.on(0.11)
    return b.velocity == 0


def unit(b):
    b.moving()
    return round(b.drive.mover.plant.velocity) == 10_000


def shifted(b):
    b.break_with("limit_switch")
    return b.number(0x60FD) & 0xFF == 0x20


def homed(b, method=37):
    b.write(0x6098, method)
    b.enable(6)
    b.control(0x1F)


def latched(b):
    homed(b)
    assert b.statusword & BIT_12
    b.control(0x0F)
    b.write(0x6098, 17)
    b.control(0x1F)
    b.on(0.1)
    early = b.statusword & BIT_12
    b.control(0x06)
    b.on(0.5)
    b.control(0x0F)
    return bool(early) and not b.statusword & BIT_12


def briefly(b):
    homed(b)
    early = b.statusword & BIT_12
    b.on(0.06)
    return bool(early) and not b.statusword & BIT_12


def by_bit_10(b):
    homed(b)
    return b.statusword & (BIT_12 | REACHED) == REACHED


def unpowered_homing(b):
    b.write(0x6098, 37)
    b.write(0x6060, 6)
    b.control(0x10)
    return bool(b.statusword & BIT_12)


def homing_halted(b):
    homed(b, 17)
    b.on(0.2)
    b.control(0x11F)
    b.on(1)
    return b.velocity != 0


def answer(index, change, sub=0):
    """Look at the raw answer to a read."""
    return lambda b: change(b.request(bytes((0x40, *index.to_bytes(2, "little"), sub, 0, 0, 0, 0))))


def late_answer(b):
    b.seen.clear()
    first = b.request(bytes.fromhex("4001100000000000"))
    b.on(0.11)
    return first is None and any(frame.can_id == 0x585 for _, frame in b.seen)


def answers_after_boot(b):
    b.reboot(1.5)
    early = b.read(0x1001)
    b.on(0.6)
    return early is None and b.read(0x1001) is not None


def stale(b):
    b.on(0.1)
    frames = b.reboot()
    return [frame.data[:2] for frame in frames if frame.can_id == 0x085] == [b"\x10\x81"] and (
        sum(frame.can_id == 0x585 for frame in frames) == 3
    )


def written(b):
    return b.request(bytes.fromhex("2B17100064000000"))


def stored(b):
    b.write(0x1017, 100)
    b.seen.clear()
    first = b.request(b"\x23\x10\x10\x01save")
    b.on(3.9)
    early = {frame.can_id for _, frame in b.seen}
    b.on(0.2)
    return first is None and early <= {0x705} and any(frame.can_id == 0x585 for _, frame in b.seen)


def invalid(b):
    """Make the first TPDO invalid."""
    b.write(0x1800, b.number(0x1800, 1) | 0x80000000, 1)


def short_mapping(b):
    invalid(b)
    b.write(0x1A00, 0)
    for sub, mapped_object in enumerate((0x60410010, 0x60610008, 0x60640020), 1):
        b.write(0x1A00, mapped_object, sub)
    return b.abort_of(0x1A00, 3) == 0x06040042


def fixed_cob_id(b):
    kept = b.abort_of(0x1800, b.number(0x1800, 1) | 0x80000000, 1) == READ_ONLY
    return kept and b.abort_of(0x1A00, 0) is None and b.abort_of(0x1A00, 0x60640020, 1) is None


def foreign(b):
    b.write(0x1800, 0x80000189, 1)
    return b.abort_of(0x1A00, 0) == 0x06040041


def not_mapped(b):
    invalid(b)
    b.write(0x1A00, 0)
    return absent(0x606C)(b) and b.abort_of(0x1A00, 0x606C0020, 1) == NO_OBJECT


def late_rpdo(b):
    b.start()
    b.put(0x205, b"\x06\x00\x03")
    early = b.state
    b.on(0.01)
    return (early, b.state) == ("SWITCH_ON_DISABLED", "READY_TO_SWITCH_ON")


def wrong_length(b):
    b.start()
    b.seen.clear()
    b.put(0x205, b"\x06")
    return [data[:2] for data in b.emergencies()] == [b"\x20\x82"]


def boots(b):
    return any(frame.can_id == 0x705 for frame in b.reboot(1.0))


def starts_late(b):
    b.reboot()
    b.start()
    early = b.node.operational
    b.on(3)
    b.start()
    return not early and b.node.operational


def starts_without_errors(b):
    b.node.outbox.emergency(0x5000, 1)
    b.start()
    early = b.node.operational
    b.node.outbox.clear_error(0x5000)
    b.start()
    return not early and b.node.operational


def fast(b):
    b.write(0x1017, 1000)
    return b.node.heartbeat.period_ns == 999_900_000


def emergency(data):
    return lambda b: [each[3:] for each in b.faulted().emergencies()] == [bytes.fromhex(data)]


PROBES = {
    "modes_listed_without": lambda b: not b.number(0x6502) & 1 << 7 and b.abort_of(0x6060, 8) is None,
    "modes_not_listed": absent(0x6502),
    "own_velocity_mode": own_mode(-3, 0x60FF, 100, lambda b: b.velocity == 100),
    "own_torque_mode": own_mode(-5, 0x6071, 100, lambda b: b.number(0x6077) == 100),
    "own_position_mode": own_mode(-1, 0x607A, 100, lambda b: b.position == 100),
    "one_mode": refused(0x6060, 3, INVALID),
    "mode_shown_late": late_mode,
    "mode_display_zero_until_enabled": lambda b: shown_mode(0, lambda b: None)(b) and shown_mode(9, lambda b: b.enable())(b),
    "mode_display_late": shown_mode(0, lambda b: None),
    "mode_fixed_while_halted": lambda b: shown_mode(3, lambda b: b.enable(3).control(0x10F))(b) and shown_mode(9, lambda b: b.control(0x0F))(b),
    "mode_fixed_while_enabled": lambda b: shown_mode(3, lambda b: b.enable(3))(b) and shown_mode(9, lambda b: b.control(6))(b),
    "mode_fixed_while_moving": shown_mode(3, lambda b: b.moving()),
    "enable_needs_mode": lambda b: state("SWITCHED_ON", before=lambda b: b.enable())(b) and state("OPERATION_ENABLED")(b),
    "enable_delay": lambda b: state("SWITCHED_ON")(b) and state("OPERATION_ENABLED", before=lambda b: b.on(0.6))(b),
    "brake_delay": brake,
    "switch_on_delay": lambda b: state("READY_TO_SWITCH_ON")(b) and state("OPERATION_ENABLED", before=lambda b: b.on(6.1))(b),
    "link_empty_after_fault": empty_link,
    "transition_slow": state("SWITCH_ON_DISABLED"),
    "not_ready_time": not_ready,
    "mains_awaited": mains,
    "sto_switched_on": stopped_supply,
    "quick_stop_ends_switched_on": state("SWITCHED_ON", 2, seconds=1),
    "quick_stop_unseen": state("SWITCH_ON_DISABLED", 2, before=lambda b: b.moving()),
    "quick_stop_off": state("OPERATION_ENABLED", 2, before=lambda b: b.moving()),
    "quick_stop_resumes": state("OPERATION_ENABLED", 2, 0x0F, before=lambda b: b.moving()),
    "fault_reset_twice": second_edge,
    "fault_reset_slow": reset_after(3.0),
    "fault_reset_level": reset_level,
    "fault_returns": returning,
    "fault_reaction_endless": reaction,
    "enable_faults": enable_fault,
    "first_enable_faults": first_enable,
    "torque_then_position": torque_then_position,
    "enabled_in_preop": lambda b: [b.write(0x6040, each) for each in (6, 7, 15)] and b.state == "OPERATION_ENABLED",
    "sync_period_judged": judged_period,
    "remote_when_enabled": lambda b: word(REMOTE, value=False)(b) and word(REMOTE, before=lambda b: b.enable(3))(b),
    "remote_never": word(REMOTE, value=False, before=lambda b: b.enable(3)),
    "voltage_never": word(VOLTAGE, value=False),
    "warning_always": word(WARNING),
    "internal_limit_always": word(LIMIT),
    "own_bits_change": changing(0x8100),
    "target_reached_flickers": flickers,
    "target_reached_inverted": inverted_reached,
    "controlword_write_only": lambda b: b.code_of(0x6040) == 0x06010001,
    "set_point_alone": second_set_point,
    "set_point_needs_bit_5": without_bit_5,
    "one_set_point": acknowledged_on_the_way,
    "set_points_elsewhere": lambda b: b.moving().velocity == 0 and b.state == "OPERATION_ENABLED",
    "no_phase_lock": lambda b: not b.drive.modes.active.model.recovers_sync and not b.drive.objects.model.recovers_sync,
    "extrapolates": goes_on,
    "set_points_supervised": supervised,
    "record_position": recorded,
    "period_refused": refused(0x60C2, 8, READ_ONLY, 1),
    "period_rounded": lambda b: b.write(0x60C2, 10, 1) and b.number(0x60C2, 1) == 8,
    "polarity_of_targets": turned,
    "one_ramp": ramps,
    "own_velocity_unit": unit,
    "parameter_clamped": lambda b: b.write(0x6083, 5000) and b.number(0x6083) == 1000,
    "inputs_shifted": shifted,
    "homing_latched": latched,
    "homing_shown_briefly": briefly,
    "homing_without_bit_12": by_bit_10,
    "homing_without_bit_10": lambda b: homed(b) or b.statusword & (BIT_12 | REACHED) == BIT_12,
    "homing_zero_refused": refused(0x6098, 0, INVALID),
    "homing_method_fixed": refused(0x6098, 17, DEVICE_STATE, before=lambda b: b.enable(6)),
    "homes_without_power": unpowered_homing,
    "homing_ignores_halt": homing_halted,
    "sdo_after_boot": answers_after_boot,
    "sdo_late": late_answer,
    "sdo_first_lost": first_request,
    "mapped_not_written": mapped,
    "sdo_stale": stale,
    "sdo_four_bytes": answer(0x1001, lambda data: data[0] == 0x43),
    "sdo_size_unsaid": answer(0x1001, lambda data: data[0] == 0x42),
    "sdo_garbage": answer(0x6041, lambda data: data[0] == 0x4B and any(data[6:])),
    "sdo_more_bytes": lambda b: b.read(0x1008) == b"a servo drive\0",
    "sdo_acknowledges_with_data": lambda b: any(written(b)[4:]),
    "sdo_short_frames": lambda b: len(written(b)) == 4 and answer(0x1001, len)(b) == 5,
    "sdo_aborts_general": lambda b: b.code_of(0x5000) == 0x08000000,
    "sdo_aborts_zero": lambda b: b.code_of(0x5000) == 0,
    "sdo_no_block": lambda b: b.request(bytes.fromhex("A008100020000000"))[4:] == (0x05040001).to_bytes(4, "little"),
    "optional_missing": absent(0x60C2),
    "error_code_absent": absent(0x603F),
    "velocity_absent": not_mapped,
    "storing_silent": stored,
    "mapping_count_first": refused(0x1A00, 0x60640020, 0x06010000, 1, before=invalid),
    "mapping_fixed": refused(0x1A00, 0, READ_ONLY, before=invalid),
    "mapping_in_preop": refused(0x1800, 0x80000185, DEVICE_STATE, 1, before=lambda b: b.start()),
    "mapping_short": short_mapping,
    "cob_id_fixed": fixed_cob_id,
    "cob_id_not_stored": not_stored,
    "cob_ids_of_node": lambda b: {b.number(record, 1) & 0x7F for record in (0x1400, 0x1401, 0x1800, 0x1801)} == {1},
    "foreign_pdo_unmappable": foreign,
    "mapping_swapped": lambda b: (b.number(0x1A00, 1), b.number(0x1A01, 1)) == (0x60640020, 0x60410010),
    "tpdo_by_event": refused(0x1800, 1, INVALID, 2),
    "inhibit_time": lambda b: invalid(b) or (b.write(0x1800, 10, 3) and b.number(0x1800, 3) == 300),
    "rpdo_late": late_rpdo,
    "length_error_8220": wrong_length,
    "boot_delay": lambda b: not boots(b) and bool(b.on(4.1)) and b.read(0x1001) is not None,
    "boot_unsaid": lambda b: not boots(b) and b.read(0x1001) is not None,
    "already_operational": lambda b: bool(b.reboot()) and b.node.operational,
    "start_without_errors": starts_without_errors,
    "start_after_boot": starts_late,
    "heartbeat_absent": lambda b: absent(0x1017)(b) and b.abort_of(0x1016, 0, 1) == NO_OBJECT,
    "heartbeat_at_start": lambda b: bool(b.reboot()) and b.number(0x1017) == 1000,
    "heartbeats_at_boot": lambda b: [frame.data[0] for frame in b.on(0.1).reboot(0.02) if frame.can_id == 0x705] == [0, *[0x7F] * 4],
    "consumer_rounded": lambda b: b.write(0x1016, 1 << 16 | 250, 1) and b.number(0x1016, 1) == 1 << 16 | 300,
    "consumer_refused": refused(0x1016, 1 << 16 | 250, READ_ONLY, 1),
    "sync_counter_absent": refused(0x1019, 10, NO_OBJECT),
    "clock_drift": fast,
    "emcy_own_register": emergency("0200000000"),
    "emcy_own_data": emergency("0000007008"),
    "emcy_at_boot": lambda b: b.on(0.1).reboot() and [data[:2] for data in b.emergencies()] == [b"\x00\x10", b"\0\0"],
    "emcy_zeros_at_boot": lambda b: any(frame.can_id == 0x085 and not any(frame.data) for frame in b.reboot()),
}  # fmt: skip
# ruff: noqa: E501 - one quirk is one line of the table
NODES = {
    "record_position": lambda: with_record(),
    "own_velocity_mode": generic,  # whose file limits 0x6060 to 0 to 10
    "sync_period_judged": generic,
    "polarity_of_targets": generic,
}


def with_record():
    """A drive whose 0x60C1 has two subindices."""
    od = servo_od()
    od.add(entry(0x60C1, 2, T.INTEGER32, 0, mapped=True))
    return make_device(od, 5)


def node_of(name):
    return NODES.get(name, servo)()


def test_every_quirk_has_its_probe():
    assert list(PROBES) == list(QUIRKS)


@pytest.mark.parametrize("name", QUIRKS)
def test_a_drive_has_a_quirk_from_its_power_on_and_without_it_none(name):
    probe = PROBES[name]
    assert not probe(Quirky(node=node_of(name)))
    assert probe(Quirky(name, node=node_of(name)))


@pytest.mark.parametrize("name", QUIRKS)
def test_a_quirk_is_switched_on_and_off_while_the_drive_runs(name):
    probe, bench = PROBES[name], Quirky(node=node_of(name))
    bench.set(name)
    assert bench.quirks.active[0].startswith(name)
    assert probe(bench)
    other = Quirky(node=node_of(name))
    other.set(name)
    other.set(name, on=False)
    assert other.quirks.active == []
    assert not probe(other)
    assert other.node.filter is None or other.node.switches.active
