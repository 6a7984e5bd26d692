"""Quirks of modes of operation and of the power state machine (CiA 402)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import HALT_BIT, VOLTAGE_ENABLED, Command, State, transition_of
from canopen_control.virtual.fault_effects import served_in_preop
from canopen_control.virtual.quirk_base import Quirk, apply_switch, axis_refuses, hide_objects, in_seconds, whole

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia402.state import Transition
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.injection_point import InjectionPoint
    from canopen_control.virtual.object_store import Guard
    from canopen_control.virtual.power_machine import TransitionAct
    from canopen_control.virtual.quirk_base import AxisAct, QuirkHooks
    from canopen_control.virtual.virtual_drive import VirtualDrive


_MS, _S = 1_000_000, 1_000_000_000
_CYCLIC_MODES = (OperationMode.IP, OperationMode.CSP, OperationMode.CSV, OperationMode.CST)
_POWER = "CiA 402-2, 6.3 (power state machine)"
_MODE = "CiA 402-2, object 0x6060"
_SHOWN = "CiA 402-2, object 0x6061"
_LISTED = "CiA 402-2, object 0x6502"
_QUICK = "CiA 402-2, object 0x605A"
_IPOS_MODES = "yarp-devices: TechnosoftIpos, embedded-pid/IControlModeRawImpl.cpp"


# -- modes of operation


def _point(point: Callable[[VirtualDrive], InjectionPoint[Any]], value: Callable[[float], Any]) -> AxisAct:
    """Return a quirk action that changes the healthy value of an injection point."""
    return lambda hooks, drive, strength: hooks.healthy(point(drive), value(strength))


def _condition(holds: Callable[[VirtualDrive], bool]) -> AxisAct:
    """Return a quirk action that permits a change of mode only if `holds` is true."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
        modes = drive.modes
        hooks.attribute(modes, "conditions", (*modes.conditions, lambda: holds(drive)))

    return act


def _modes_listed_without(hooks: QuirkHooks, drive: VirtualDrive, mode: float) -> None:
    bit = 1 << int(mode) - 1
    hooks.show(o.SUPPORTED_DRIVE_MODES + drive.objects.offset, 0, lambda shown: shown & ~bit)


def _further_mode(like: OperationMode) -> AxisAct:
    """Return a quirk action that makes a manufacturer-specific mode number behave like a standard mode."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, number: float) -> None:
        mode = int(number)
        drive.modes.add(mode, like)
        hooks.later(lambda: drive.modes.remove(mode))
        index = o.MODES_OF_OPERATION + drive.objects.offset
        beyond = hooks.node.store.beyond_limits
        beyond.add((index, mode))
        hooks.later(partial(beyond.discard, (index, mode)))
        hooks.guard([index], lambda entry, value, before: value if value == mode else before(entry, value))

    return act


def _mode_shown_late(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    since = [float(drive.modes.number), 0]
    wait = round(seconds * _S)

    def view(shown: int) -> int:
        now = drive.mover.time
        if shown != since[0]:
            since[:] = shown, now
            drive.mover.at("mode shown", now + wait, lambda _now: hooks.node.outbox.values_changed())
        return -1 if shown in _CYCLIC_MODES and now - since[1] < wait else shown

    hooks.show(o.MODES_OF_OPERATION_DISPLAY + drive.objects.offset, 0, view)


def _mode_display_zero_until_enabled(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    hooks.show(
        o.MODES_OF_OPERATION_DISPLAY + drive.objects.offset,
        0,
        lambda shown: shown if drive.state is State.OPERATION_ENABLED else 0,
    )


def _enable_needs_mode(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    hooks.act(drive, 4, lambda transition, now, before: before(transition, now) if drive.modes.number else None)


_MODES_OF_OPERATION: Final[tuple[Quirk, ...]] = (
    Quirk(
        "modes_listed_without",
        "has a mode that is not listed in 0x6502 (the strength is the number of the mode)",
        _LISTED,
        "Technosoft, iPOS CANopen programming manual (2023), 6502h; yarp-devices#222",
        _modes_listed_without,
        strength=whole("mode", 8, 1, 32),
        group="0x6502",
    ),
    Quirk(
        "modes_not_listed",
        "has no 0x6502",
        _LISTED,
        "ros_canopen#462",
        node=hide_objects(o.SUPPORTED_DRIVE_MODES),
        group="0x6502",
    ),
    Quirk(
        "own_velocity_mode",
        "has a manufacturer-specific velocity mode that uses 0x60FF without a ramp",
        _MODE,
        "Kinco, FD5 manual, p. 190",
        _further_mode(OperationMode.CSV),
        strength=whole("mode", -3, -128, -1),
    ),
    Quirk(
        "own_torque_mode",
        "has a manufacturer-specific torque mode that uses 0x6071",
        _MODE,
        _IPOS_MODES,
        _further_mode(OperationMode.CST),
        strength=whole("mode", -5, -128, -1),
    ),
    Quirk(
        "own_position_mode",
        "has a manufacturer-specific cyclic position mode that uses 0x607A",
        _MODE,
        _IPOS_MODES,
        _further_mode(OperationMode.CSP),
        strength=whole("mode", -1, -128, -1),
    ),
    Quirk(
        "one_mode",
        "accepts only one mode (the strength is the number of the mode)",
        _MODE,
        "linuxcnc-ethercat#180 (Omron MX2)",
        axis_refuses(AbortCode.INVALID_VALUE, o.MODES_OF_OPERATION, lambda _drive, value, mode: value not in (0, mode)),
        strength=whole("mode", 2, 1, 10),
    ),
    Quirk(
        "mode_shown_late",
        "shows -1 in 0x6061 for some time after a change to a cyclic mode",
        _SHOWN,
        "ros_canopen#457 (Festo CMMP-AS)",
        _mode_shown_late,
        strength=in_seconds(4.0),
    ),
    Quirk(
        "mode_display_zero_until_enabled",
        "shows 0 in 0x6061 until it is in OPERATION ENABLED",
        _SHOWN,
        "ros2_canopen#444",
        _mode_display_zero_until_enabled,
    ),
    Quirk(
        "mode_display_late",
        "changes its mode late",
        _SHOWN,
        "unsourced",
        _point(lambda drive: drive.modes.delay_ns, lambda seconds: round(seconds * _S)),
        strength=in_seconds(0.2),
    ),
    Quirk(
        "mode_fixed_while_halted",
        "does not change its mode while the halt bit is set",
        _MODE,
        "ros2_canopen#234 (ENGEL HBI)",
        _condition(lambda drive: not drive.power.controlword & HALT_BIT),
    ),
    Quirk(
        "mode_fixed_while_enabled",
        "changes its mode only in SWITCH ON DISABLED and READY TO SWITCH ON",
        _MODE,
        "ros_canopen#259 (switching_state)",
        _condition(
            lambda drive: drive.state not in (State.SWITCHED_ON, State.OPERATION_ENABLED) or not drive.modes.number
        ),
    ),
    Quirk(
        "mode_fixed_while_moving",
        "changes its mode only at standstill",
        _MODE,
        "unsourced",
        _condition(lambda drive: drive.mover.at_standstill),
    ),
    Quirk(
        "enable_needs_mode",
        "does not enter OPERATION ENABLED while 0x6060 is 0",
        _POWER,
        "ros_canopen#331 (Nanotec)",
        _enable_needs_mode,
    ),
)


# -- the power state machine


def _delays(number: int) -> AxisAct:
    """Return a quirk action that delays transition `number` by the strength in s."""
    return lambda hooks, drive, strength: hooks.delay(drive, number, strength)


def _brake_delay(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    gate, wait = hooks.gate(drive), round(seconds * _S)
    gate.brake_ns = wait

    def opened(now: int) -> None:
        gate.closed_by.discard("brake")
        if drive.power.live:
            drive.start(now)

    def enable(transition: Transition, now: int, before: TransitionAct) -> None:
        gate.closed_by.add("brake")
        drive.mover.at("brake", now + wait, opened)
        before(transition, now)

    hooks.act(drive, 4, enable)


def _mains_awaited(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    def fall(now: int) -> None:
        if drive.state is State.SWITCHED_ON and not drive.power.voltage.value:
            drive.power.enter(State.SWITCH_ON_DISABLED, now)

    def switch_on(transition: Transition, now: int, before: TransitionAct) -> None:
        before(transition, now)
        drive.mover.at("mains", now + round(seconds * _S), fall)

    hooks.act(drive, 3, switch_on)


def _link_empty_after_fault(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    until = [-(1 << 62)]

    def reset(transition: Transition, now: int, before: TransitionAct) -> None:
        before(transition, now)
        if drive.state is not State.FAULT:
            until[0] = now + round(seconds * _S)

    def charged(transition: Transition, now: int, before: TransitionAct) -> None:
        if now >= until[0]:
            before(transition, now)

    hooks.act(drive, 15, reset)
    for number in (2, 3, 4):
        hooks.act(drive, number, charged)
    hooks.word(drive, lambda word: word if drive.mover.time >= until[0] else word & ~VOLTAGE_ENABLED)


def _ends_in(state: State, end: State | None) -> AxisAct:
    """Return a quirk action that makes the stop in `state` end in the state `end`, or never if `end` is None."""
    return lambda hooks, drive, _strength: hooks.entry(drive.power.stop_states, state, end)


def _quick_stop_unseen(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    hooks.act(drive, 11, lambda _transition, now, _before: drive.power.enter(State.SWITCH_ON_DISABLED, now))


def _quick_stop_off(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    hooks.act(drive, 11, lambda _transition, _now, _before: None)
    hooks.show(o.QUICK_STOP_OPTION + drive.objects.offset, 0, lambda _shown: -1)


def _quick_stop_resumes(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    enabling = transition_of(State.SWITCHED_ON, Command.ENABLE_OPERATION)
    if enabling is not None:
        hooks.act(drive, 16, lambda _transition, now, _before: drive.power.act_of(4)(enabling, now))


def _fault_reset_twice(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    edges = [0]

    def reset(transition: Transition, now: int, before: TransitionAct) -> None:
        edges[0] += 1
        if edges[0] % 2 == 0:
            before(transition, now)

    hooks.act(drive, 15, reset)


def _fault_reset_slow(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    def reset(transition: Transition, now: int, before: TransitionAct) -> None:
        drive.mover.at("fault reset", now + round(seconds * _S), lambda then: before(transition, then))

    hooks.act(drive, 15, reset)


def _fault_reset_level(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    def reset(transition: Transition, now: int, before: TransitionAct) -> None:
        def check(then: int) -> None:
            if drive.power.controlword & 0x80 and drive.state is State.FAULT:
                before(transition, then)

        drive.mover.at("fault reset", now + round(seconds * _S), check)

    hooks.act(drive, 15, reset)


def _fault_returns(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    power = drive.power

    def reset(transition: Transition, now: int, before: TransitionAct) -> None:
        before(transition, now)
        if power.causes and drive.state is State.FAULT:
            code = min(power.causes)
            hooks.node.outbox.clear_errors()
            power.enter(State.SWITCH_ON_DISABLED, now)
            drive.mover.at("fault again", now + 5 * _MS, lambda then: drive.fault(code, then))

    hooks.act(drive, 15, reset)


def _first_enable_faults(hooks: QuirkHooks, drive: VirtualDrive, code: float) -> None:
    enabled = [False]

    def enable(transition: Transition, now: int, before: TransitionAct) -> None:
        before(transition, now)
        if not enabled[0] and drive.state is State.OPERATION_ENABLED:
            enabled[0] = True
            drive.fault(int(code), now)

    hooks.act(drive, 4, enable)


def _torque_then_position(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    torque, modes = (OperationMode.TQ, OperationMode.CST), drive.modes

    def check(entry: Entry, value: Value, before: Guard) -> Value:
        result = before(entry, value)
        if drive.state is State.OPERATION_ENABLED and modes.number in torque and result == OperationMode.CSP:
            drive.fault(0x8A00, hooks.node.clock.now)
        return result

    hooks.guard([o.MODES_OF_OPERATION + drive.objects.offset], check)


def _sync_period_judged(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    def enable(transition: Transition, now: int, before: TransitionAct) -> None:
        before(transition, now)
        period = round(drive.objects.interpolation_s * 1e6)
        if drive.power.running and drive.modes.number in _CYCLIC_MODES and hooks.node.store.number(0x1006) != period:
            drive.fault(0x8700, now)

    hooks.act(drive, 4, enable)


_STATE_MACHINE: Final[tuple[Quirk, ...]] = (
    Quirk(
        "enable_delay",
        "shows OPERATION ENABLED only after a delay, when its brake is released",
        _POWER,
        "Beckhoff, MR3107, 8001:11; jsd#48",
        _delays(4),
        strength=in_seconds(0.5),
    ),
    Quirk(
        "brake_delay",
        "follows set-points only some time after OPERATION ENABLED, when its brake is released",
        _POWER,
        "jsd#48 (Elmo: motor on, servo enabled)",
        _brake_delay,
        strength=in_seconds(0.5),
    ),
    Quirk(
        "switch_on_delay",
        "needs some time from READY TO SWITCH ON to SWITCHED ON, to charge its DC link",
        _POWER,
        "Festo, CMMP-AS manual, p. 164",
        _delays(3),
        strength=in_seconds(6.0),
    ),
    Quirk(
        "link_empty_after_fault",
        "obeys no command for some time after a fault reset, because its DC link is empty (bit 4 is 0)",
        _POWER,
        "Festo, CMMP-AS manual, p. 164",
        _link_empty_after_fault,
        strength=in_seconds(3.0),
    ),
    Quirk(
        "transition_slow",
        "needs some time for every transition",
        _POWER,
        "unsourced",
        _point(lambda drive: drive.power.transition_delay_ns, lambda seconds: round(seconds * _S)),
        strength=in_seconds(2.0),
    ),
    Quirk(
        "not_ready_time",
        "shows NOT READY TO SWITCH ON for some time after a reset",
        _POWER,
        "unsourced",
        _delays(1),
        strength=in_seconds(4.0),
    ),
    Quirk(
        "mains_awaited",
        "falls back from SWITCHED ON to SWITCH ON DISABLED after some time without main power",
        _POWER,
        "Toshiba, VF-S15 CANopen manual, p. 30",
        _mains_awaited,
        strength=in_seconds(3.0),
    ),
    Quirk(
        "sto_switched_on",
        "falls from OPERATION ENABLED to SWITCHED ON when its power stage is switched off",
        _POWER,
        "fastcat#164 (Elmo)",
        lambda hooks, drive, _strength: hooks.attribute(drive.power, "unsupplied", State.SWITCHED_ON),
        group="supply",
    ),
    Quirk(
        "supply_loss_unseen",
        "stays in OPERATION ENABLED when its power stage is switched off, and only clears bit 4",
        _POWER,
        "unsourced",
        lambda hooks, drive, _strength: hooks.attribute(drive.power, "unsupplied", State.OPERATION_ENABLED),
        group="supply",
    ),
    Quirk(
        "quick_stop_ends_switched_on",
        "is in SWITCHED ON after a quick stop",
        _POWER,
        "UDTStudio#4 (UniSwarm)",
        _ends_in(State.QUICK_STOP_ACTIVE, State.SWITCHED_ON),
        group="quick stop",
    ),
    Quirk(
        "quick_stop_unseen",
        "enters SWITCH ON DISABLED at once, without power, on a quick stop",
        _QUICK,
        "canopen#167",
        _quick_stop_unseen,
        group="quick stop",
    ),
    Quirk(
        "quick_stop_off",
        "ignores a quick stop (0x605A has the manufacturer's value -1)",
        _QUICK,
        "Beckhoff, AX8xxx, object 605A",
        _quick_stop_off,
        group="quick stop",
    ),
    Quirk(
        "quick_stop_resumes",
        "leaves QUICK STOP ACTIVE for OPERATION ENABLED by controlword 0x0F, regardless of 0x605A",
        _QUICK,
        "jsd#93, #66 (Elmo)",
        _quick_stop_resumes,
    ),
    Quirk(
        "fault_reset_twice",
        "resets a fault only at every second edge of bit 7",
        _POWER,
        "ros_canopen#138",
        _fault_reset_twice,
        group="fault reset",
    ),
    Quirk(
        "fault_reset_slow",
        "leaves FAULT some time after the edge of bit 7",
        _POWER,
        "unsourced",
        _fault_reset_slow,
        strength=in_seconds(3.0),
        group="fault reset",
    ),
    Quirk(
        "fault_reset_level",
        "resets a fault when bit 7 has been set for some time",
        _POWER,
        "unsourced",
        _fault_reset_level,
        strength=in_seconds(1.0),
        group="fault reset",
    ),
    Quirk(
        "fault_returns",
        "leaves FAULT on a reset although the cause persists, and enters FAULT again at once",
        _POWER,
        "yarp-devices#215 (iPOS)",
        _fault_returns,
        group="fault reset",
    ),
    Quirk(
        "fault_reaction_endless",
        "stays in FAULT REACTION ACTIVE",
        _POWER,
        "unsourced",
        _ends_in(State.FAULT_REACTION_ACTIVE, None),
    ),
    Quirk(
        "enable_faults",
        "enters FAULT when it is enabled while a precondition is missing (the strength is the EMCY code)",
        _POWER,
        "ros2_canopen#298 (Leadshine iSV2)",
        _point(lambda drive: drive.power.fault_on_enable, int),
        strength=whole("EMCY code", 0x5201, 1, 0xFFFF),
        group="enable",
    ),
    Quirk(
        "first_enable_faults",
        "enters FAULT at the first enable after its start, and at no later enable (the strength is the EMCY code)",
        _POWER,
        "ethercat_driver_ros2#151, #87 (ZeroErr eRob)",
        _first_enable_faults,
        strength=whole("EMCY code", 0xFF00, 1, 0xFFFF),
        group="enable",
    ),
    Quirk(
        "torque_then_position",
        "enters FAULT with 0x8A00 when its mode changes from torque to CSP while it is enabled",
        _MODE,
        "eRob_SOEM_linux#12 (ZeroErr eRob)",
        _torque_then_position,
    ),
    Quirk(
        "enabled_in_preop",
        "can be enabled in PRE-OPERATIONAL too, and accepts set-points by SDO there",
        _POWER,
        "unsourced",
        node=apply_switch(served_in_preop),
    ),
    Quirk(
        "sync_period_judged",
        "enters FAULT with 0x8700 in a cyclic mode unless 0x1006 equals its interpolation time",
        "CiA 301, object 0x1006",
        "canfestival-rtt#18; canopen#407 (Delta ASDA-A2)",
        _sync_period_judged,
    ),
)


POWER_QUIRKS: Final[tuple[Quirk, ...]] = (*_MODES_OF_OPERATION, *_STATE_MACHINE)
