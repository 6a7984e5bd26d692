"""Quirks of modes and of the power state machine: each is seen on the wire, is not there without it, and ends when it is switched off."""

from __future__ import annotations

import pytest
from support.quirk_probes import INVALID, absent, check_from_power_on, check_switched, refused
from support.virtualbench import generic, servo

from canopen_control.virtual.power_quirks import POWER_QUIRKS


def state(name, *words, before=lambda b: b.enable(3), seconds=0.0):
    """Look for a state after controlwords."""

    def probe(b):
        before(b)
        for word in words:
            b.control(word)
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
    for value in (0x80, 0x06):
        b.control(value)
    early = b.state, b.statusword & 1 << 4
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


def supply_lost(b):
    """Whether an enabled drive shows a lost supply in bit 4 only, stands, and follows its set-point afterwards."""
    b.moving()
    b.break_with("power_stage_off")
    b.on(3)
    lost = b.state, b.statusword & 0x10, b.velocity
    b.node.fault_switches.set("power_stage_off", False, b.now)
    b.on(3)
    return lost == ("OPERATION_ENABLED", 0, 0) and bool(b.statusword & 0x10) and b.velocity == 1000


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
    for value in (0x80, 0x06, 0x07, 0x0F):
        b.control(value)
    return early == ("FAULT", 0xFF00) and b.state == "OPERATION_ENABLED"


def torque_then_position(b):
    b.enable(10)
    b.write(0x6060, 8)
    b.on(0.01)
    return (b.state, b.number(0x603F)) == ("FAULT", 0x8A00)


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
    "supply_loss_unseen": supply_lost,
    "quick_stop_ends_switched_on": state("SWITCHED_ON", 2, seconds=1),
    "quick_stop_unseen": state("SWITCH_ON_DISABLED", 2, before=lambda b: b.moving()),
    "quick_stop_off": lambda b: (
        state("OPERATION_ENABLED", 2, before=lambda b: b.moving())(b) and b.number(0x605A, signed=True) == -1
    ),
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
}  # fmt: skip
# ruff: noqa: E501 - one quirk is one line of the table
NODES = {"own_velocity_mode": generic, "sync_period_judged": generic}


def test_every_quirk_has_its_probe():
    assert list(PROBES) == [quirk.name for quirk in POWER_QUIRKS]


@pytest.mark.parametrize("name", PROBES)
def test_a_drive_has_a_quirk_from_its_power_on_and_without_it_none(name):
    check_from_power_on(name, PROBES[name], NODES.get(name, servo))


@pytest.mark.parametrize("name", PROBES)
def test_a_quirk_is_switched_on_and_off_while_the_drive_runs(name):
    check_switched(name, PROBES[name], NODES.get(name, servo))
