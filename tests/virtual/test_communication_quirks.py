"""Quirks of communication: each is seen on the wire, is not there without it, and ends when it is switched off."""

from __future__ import annotations

import pytest
from support.quirk_probes import (
    DEVICE_STATE,
    INVALID,
    NO_OBJECT,
    READ_ONLY,
    absent,
    check_from_power_on,
    check_switched,
    invalid,
    refused,
    written,
)

from canopen_control.virtual.communication_quirks import COMMUNICATION_QUIRKS


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


def stored(b):
    b.write(0x1017, 100)
    b.seen.clear()
    first = b.request(b"\x23\x10\x10\x01save")
    b.on(3.9)
    early = {frame.can_id for _, frame in b.seen}
    b.on(0.2)
    return first is None and early <= {0x705} and any(frame.can_id == 0x585 for _, frame in b.seen)


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
    return lambda b: [item[3:] for item in b.faulted().emergencies()] == [bytes.fromhex(data)]


PROBES = {
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


def test_every_quirk_has_its_probe():
    assert list(PROBES) == [quirk.name for quirk in COMMUNICATION_QUIRKS]


@pytest.mark.parametrize("name", PROBES)
def test_a_drive_has_a_quirk_from_its_power_on_and_without_it_none(name):
    check_from_power_on(name, PROBES[name])


@pytest.mark.parametrize("name", PROBES)
def test_a_quirk_is_switched_on_and_off_while_the_drive_runs(name):
    check_switched(name, PROBES[name])
