"""Quirks of the statusword, of set-points and of homing: each is seen on the wire, is not there without it, and ends when it is switched off."""

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
)
from support.virtualbench import BIT_12, LIMIT, REACHED, T, entry, generic, servo, servo_od

from canopen_control.virtual.device import make_device
from canopen_control.virtual.motion_quirks import MOTION_QUIRKS

REMOTE, VOLTAGE, WARNING = 1 << 9, 1 << 4, 1 << 7


def word(bits, *, value=True, before=lambda b: None):
    """Look for bits of the statusword that are all set, or all clear."""

    def probe(b):
        before(b)
        return b.statusword & bits == (bits if value else 0)

    return probe


def recorded(b):
    b.write(0x6060, 7)
    b.enable()
    b.control(0x1F)
    b.node.store.set(0x60C1, 2, 50)
    b.write(0x60C1, 20, 1)
    b.on(0.05)
    return b.position == 50


def changing(bits, before=lambda b: None):
    def probe(b):
        before(b)
        observed = set()
        for _ in range(40):
            b.on(0.005)
            observed.add(b.statusword & bits)
        return len(observed) > 1

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


def acknowledged_at_enable(b):
    b.enable(1)
    before = b.statusword & BIT_12
    positioning(b)
    b.control(0x0F)
    b.on(0.1)
    return bool(before) and not b.statusword & BIT_12


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


def steep(b):
    b.write(0x6084, 1000)
    b.moving()
    b.write(0x60FF, 0)
    b.on(0.11)
    return b.velocity == 0


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


def zero_late(b):
    """Whether the position is the old one after homing, and later the new one."""
    b.moving()
    b.write(0x60FF, 0)
    b.on(3)
    b.write(0x6098, 37)
    b.write(0x6060, 6)
    b.control(0x1F)
    early = b.position
    b.on(0.1)
    assert b.statusword & BIT_12
    return early != b.position == 0


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


def not_mapped(b):
    invalid(b)
    b.write(0x1A00, 0)
    return absent(0x606C)(b) and b.abort_of(0x1A00, 0x606C0020, 1) == NO_OBJECT


def with_record():
    """A drive whose 0x60C1 has two subindices."""
    od = servo_od()
    od.add(entry(0x60C1, 2, T.INTEGER32, 0, mapped=True))
    return make_device(od, 5)


def with_buffer():
    """A drive whose IP has a buffer of eight set-points."""
    od = servo_od()
    for subindex, value in enumerate((8, 0, 0, 0, 4, 0), start=1):
        od.add(entry(0x60C4, subindex, T.UNSIGNED32, value))
    return make_device(od, 5)


def kept(b):
    b.enable(7)
    b.write(0x60C4, 1, 6)
    b.write(0x60C1, 100, 1)
    b.control(6)
    return b.number(0x60C4, 4) == 1


PROBES = {
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
    "acknowledged_at_enable": acknowledged_at_enable,
    "set_points_elsewhere": lambda b: b.moving().velocity == 0 and b.state == "OPERATION_ENABLED",
    "no_phase_lock": lambda b: not b.drive.modes.active.model.recovers_sync and not b.drive.objects.model.recovers_sync,
    "extrapolates": goes_on,
    "set_points_supervised": supervised,
    "record_position": recorded,
    "records_kept": kept,
    "period_refused": refused(0x60C2, 8, READ_ONLY, 1),
    "period_rounded": lambda b: b.write(0x60C2, 10, 1) and b.number(0x60C2, 1) == 8,
    "polarity_of_targets": turned,
    "one_ramp": ramps,
    "own_velocity_unit": unit,
    "own_ramp_unit": steep,
    "parameter_clamped": lambda b: b.write(0x6083, 5000) and b.number(0x6083) == 1000,
    "inputs_shifted": shifted,
    "optional_missing": absent(0x60C2),
    "error_code_absent": absent(0x603F),
    "velocity_shown_zero": lambda b: b.moving().velocity == 0 and abs(b.drive.mover.plant.velocity) > 900,
    "velocity_absent": not_mapped,
    "homing_latched": latched,
    "homing_shown_briefly": briefly,
    "homing_without_bit_12": by_bit_10,
    "homing_without_bit_10": lambda b: homed(b) or b.statusword & (BIT_12 | REACHED) == BIT_12,
    "homing_zero_late": zero_late,
    "homing_zero_refused": refused(0x6098, 0, INVALID),
    "homing_method_fixed": refused(0x6098, 17, DEVICE_STATE, before=lambda b: b.enable(6)),
    "homes_without_power": unpowered_homing,
    "homing_ignores_halt": homing_halted,
}  # fmt: skip
# ruff: noqa: E501 - one quirk is one line of the table
NODES = {"record_position": with_record, "records_kept": with_buffer, "polarity_of_targets": generic}


def test_every_quirk_has_its_probe():
    assert list(PROBES) == [quirk.name for quirk in MOTION_QUIRKS]


@pytest.mark.parametrize("name", PROBES)
def test_a_drive_has_a_quirk_from_its_power_on_and_without_it_none(name):
    check_from_power_on(name, PROBES[name], NODES.get(name, servo))


@pytest.mark.parametrize("name", PROBES)
def test_a_quirk_is_switched_on_and_off_while_the_drive_runs(name):
    check_switched(name, PROBES[name], NODES.get(name, servo))
