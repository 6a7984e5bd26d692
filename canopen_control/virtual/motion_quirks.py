"""Quirks of the statusword, of set-points, of homing and of missing objects (CiA 402)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.abort import AbortCode
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import INTERNAL_LIMIT, REMOTE, TARGET_REACHED, VOLTAGE_ENABLED, State
from canopen_control.virtual.axis_motion import wrap32
from canopen_control.virtual.device_model import MissingSetPoint
from canopen_control.virtual.fault_effects import lacks_optional, refusing
from canopen_control.virtual.mode_base import BIT_12, NEW_SET_POINT
from canopen_control.virtual.profile_modes import IMMEDIATELY
from canopen_control.virtual.quirk_base import (
    Quirk,
    Strength,
    axis_refuses,
    filter_frames,
    hide_objects,
    in_seconds,
    whole,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.cia402.state import Transition
    from canopen_control.od.model import Entry, Value
    from canopen_control.virtual.device_model import DeviceModel
    from canopen_control.virtual.object_store import Guard
    from canopen_control.virtual.power_machine import TransitionAct
    from canopen_control.virtual.quirk_base import AxisAct, QuirkHooks
    from canopen_control.virtual.virtual_drive import VirtualDrive


_MS, _S = 1_000_000, 1_000_000_000
_NEVER = -1
_STATUS = "CiA 402-2, object 0x6041"
_CONTROL = "CiA 402-2, object 0x6040"
_PP = "CiA 402-2, 10 (profile position)"
_HOMING = "CiA 402-2, 11 (homing)"
_PERIOD = "CiA 402-2, object 0x60C2"


# -- bits of the statusword


def _word(change: Callable[[VirtualDrive, int], int]) -> AxisAct:
    """Return a quirk action that applies `change` to the statusword."""
    return lambda hooks, drive, _strength: hooks.word(drive, lambda word: change(drive, word))


def _flickers(period_ns: int, duty: int, bits: int) -> Callable[[VirtualDrive, int], int]:
    """Return a function that inverts `bits` of the statusword in every `duty`-th period."""
    return lambda drive, word: word ^ bits if drive.mover.time // period_ns % duty == 0 else word


def _in_pp(change: Callable[[VirtualDrive, int], int]) -> AxisAct:
    """Return a quirk action that applies `change` to the statusword of an enabled axis in PP."""
    return _word(
        lambda drive, word: (
            change(drive, word)
            if drive.state is State.OPERATION_ENABLED and drive.modes.number == OperationMode.PP
            else word
        )
    )


def _in_homing(cleared: int) -> AxisAct:
    """Return a quirk action that clears the bits `cleared` of the statusword in homing mode."""
    return _word(lambda drive, word: word & ~cleared if drive.modes.number == OperationMode.HM else word)


def _controlword_write_only(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    controlword = o.CONTROLWORD + drive.objects.offset
    hooks.incoming.append(
        refusing(AbortCode.WRITE_ONLY, lambda command, index: command >> 5 in (2, 5) and index == controlword)
    )


_STATUSWORD: Final[tuple[Quirk, ...]] = (
    Quirk(
        "remote_when_enabled",
        "sets bit 9 only in OPERATION ENABLED",
        _STATUS,
        "SMC, LECSN-T manual, p. 871",
        _word(lambda drive, word: word if drive.state is State.OPERATION_ENABLED else word & ~REMOTE),
        group="bit 9",
    ),
    Quirk(
        "remote_never",
        "never sets bit 9",
        _STATUS,
        "SMC, LECSN-T manual, p. 871",
        _word(lambda _drive, word: word & ~REMOTE),
        group="bit 9",
    ),
    Quirk(
        "voltage_never",
        "never sets bit 4",
        _STATUS,
        "SMC, LECSN-T manual, p. 871",
        _word(lambda _drive, word: word & ~VOLTAGE_ENABLED),
    ),
    Quirk("warning_always", "always sets bit 7", _STATUS, "unsourced", _word(lambda _drive, word: word | 0x80)),
    Quirk(
        "internal_limit_always",
        "always sets bit 11",
        _STATUS,
        "unsourced",
        _word(lambda _drive, word: word | INTERNAL_LIMIT),
    ),
    Quirk(
        "own_bits_change",
        "changes bits 8 and 15 continually",
        _STATUS,
        "Nanotec, NP5 manual, 6041h",
        _word(_flickers(13 * _MS, 2, 0x8100)),
    ),
    Quirk(
        "target_reached_flickers",
        "sets and clears bit 10 during a motion in PP",
        _PP,
        "yarp-devices#245 (iPOS)",
        _in_pp(_flickers(7 * _MS, 5, TARGET_REACHED)),
        group="bit 10",
    ),
    Quirk(
        "target_reached_inverted",
        "clears bit 10 at the target in PP, and sets it before",
        _PP,
        "unsourced",
        _in_pp(lambda _drive, word: word ^ TARGET_REACHED),
        group="bit 10",
    ),
    Quirk(
        "controlword_write_only",
        "refuses to read 0x6040",
        _CONTROL,
        "ros_canopen#377 (Applied Motion)",
        _controlword_write_only,
    ),
)


# -- set-points and motion


def _model(change: Callable[[DeviceModel, float], DeviceModel]) -> AxisAct:
    """Return a quirk action that changes the device model."""
    return lambda hooks, drive, strength: hooks.model(drive, change(drive.objects.model, strength))


def _inputs_shifted(hooks: QuirkHooks, drive: VirtualDrive, bits: float) -> None:
    def view(shown: int) -> int:
        return shown & ~0xF | (shown & 0xF) << int(bits)

    hooks.show(o.DIGITAL_INPUTS + drive.objects.offset, 0, view)


def _takes(passes: Callable[[VirtualDrive, int, int], bool]) -> AxisAct:
    """Return a quirk action that accepts a PP set-point only if `passes` is true."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
        def takes(word: int, previous: int, now: int) -> bool:
            new = word & ~previous & NEW_SET_POINT and drive.modes.number == OperationMode.PP
            return not new or passes(drive, word, now)

        hooks.gate(drive).takes.append(takes)

    return act


def _acknowledged_at_enable(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    """Set bit 12 in PP from the enabling until bit 4 has risen and fallen."""
    shown = True

    def takes(word: int, previous: int, _now: int) -> bool:
        nonlocal shown
        shown = shown and not previous & ~word & NEW_SET_POINT
        return True

    def change(word: int) -> int:
        nonlocal shown
        enabled = drive.state is State.OPERATION_ENABLED
        shown = shown or not enabled
        return word | BIT_12 if shown and enabled and drive.modes.number == OperationMode.PP else word

    hooks.gate(drive).takes.append(takes)
    hooks.word(drive, change)


def _polarity_of_targets(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    store, index, inverted = hooks.node.store, o.POLARITY + drive.objects.offset, drive.readings.inverted

    def turn(_entry: Entry | None = None, _value: Value = 0) -> None:
        inverted.healthy = bool(drive.objects.number(o.POLARITY) & 0xC0)
        inverted.clear()

    hooks.healthy(inverted, inverted.healthy)
    hooks.later(partial(store.unwatch, index, turn))
    store.on_write([index], turn)
    turn()


def _own_unit(name: str) -> AxisAct:
    """Return a quirk action that sets a unit of the drive's motion, an attribute of `DriveUnits`, to the strength."""

    def act(hooks: QuirkHooks, drive: VirtualDrive, size: float) -> None:
        units, objects = drive.objects.units, drive.objects
        hooks.later(lambda: units.update(objects))
        hooks.attribute(units, name, size)
        units.update(objects)

    return act


def _period_rounded(hooks: QuirkHooks, drive: VirtualDrive, ms: float) -> None:
    step = int(ms)

    def check(entry: Entry, value: Value, before: Guard) -> Value:
        return before(entry, max(1, int(value) // step * step) if entry.subindex == 1 else value)

    hooks.guard([o.INTERPOLATION_TIME_PERIOD + drive.objects.offset], check)


_SET_POINTS: Final[tuple[Quirk, ...]] = (
    Quirk(
        "set_point_alone",
        "accepts a new set-point in PP only when the previous set-point is reached",
        _PP,
        "a NuttX driver of the ZLAC8015D (position start, target flag)",
        _takes(lambda drive, _word, now: drive.mover.at_standstill and now >= drive.mover.demand.end_ns),
        group="PP",
    ),
    Quirk(
        "set_point_needs_bit_5",
        "accepts a new set-point in PP only with bit 5 set",
        _PP,
        "CANOpenRobotController: KincoDrive.cpp",
        _takes(lambda _drive, word, _now: bool(word & IMMEDIATELY)),
    ),
    Quirk(
        "one_set_point",
        "has no set-point buffer in PP: a new set-point replaces the current set-point, and bit 12 shows this",
        _PP,
        "Trinamic, TMCM-1270 manual",
        _model(lambda model, _strength: replace(model, single_set_point=True)),
        group="PP",
    ),
    Quirk(
        "acknowledged_at_enable",
        "sets bit 12 in PP when it is enabled, and clears it only after bit 4 has risen and fallen",
        _PP,
        "canopen#678 (a motor with an integrated controller)",
        _acknowledged_at_enable,
    ),
    Quirk(
        "set_points_elsewhere",
        "takes its set-points from another source than the bus, and does not move when it is enabled",
        _CONTROL,
        "Vacon/H-Max frequency converters: a project's plan (START SRC)",
        lambda hooks, drive, _strength: hooks.gate(drive).closed_by.add("source"),
    ),
    Quirk(
        "no_phase_lock",
        "stops at the end of each set-point, and takes the time of each SYNC as exact",
        "CiA 402-2, 12 to 15 (cyclic modes)",
        "ros2_canopen#236 (EPOS4)",
        _model(lambda model, _strength: replace(model, recovers_sync=False, missing=MissingSetPoint())),
        group="missing set-point",
    ),
    Quirk(
        "extrapolates",
        "continues without a set-point for some interpolation times, then stops",
        "CiA 402-2, 12 to 15 (cyclic modes)",
        "unsourced",
        _model(lambda model, cycles: replace(model, missing=MissingSetPoint(cycles=int(cycles)))),
        strength=whole("cycles", 1, 1, 255),
        group="missing set-point",
    ),
    Quirk(
        "set_points_supervised",
        "continues without a set-point for some interpolation times, then enters FAULT with 0xFF02",
        "CiA 402-2, 12 to 15 (cyclic modes)",
        "jsd#66, #93 (Elmo, 0x2F75)",
        _model(lambda model, cycles: replace(model, missing=MissingSetPoint(cycles=int(cycles), fault=0xFF02))),
        strength=whole("cycles", 1, 1, 255),
        group="missing set-point",
    ),
    Quirk(
        "record_position",
        "reads the position of IP from another subindex of 0x60C1 (the strength)",
        "CiA 402-2, object 0x60C1",
        "ros_canopen#307 (Kollmorgen RGM)",
        lambda hooks, drive, subindex: hooks.attribute(drive.modes.interpolated, "position_subindex", int(subindex)),
        strength=whole("subindex", 2, 2, 8),
    ),
    Quirk(
        "records_kept",
        "keeps the set-points in the buffer of IP when it is disabled or changes its mode",
        "",
        "unsourced",
        lambda hooks, drive, _strength: hooks.attribute(drive.modes.interpolated.buffer, "kept", True),
    ),
    Quirk(
        "period_refused",
        "refuses to write 0x60C2",
        _PERIOD,
        "unsourced",
        axis_refuses(AbortCode.READ_ONLY, o.INTERPOLATION_TIME_PERIOD, lambda _drive, _value, _n: True),
        group="0x60C2",
    ),
    Quirk(
        "period_rounded",
        "rounds 0x60C2 down to a multiple of the strength, without an error",
        _PERIOD,
        "unsourced",
        _period_rounded,
        strength=whole("ms", 8, 1, 250),
        group="0x60C2",
    ),
    Quirk(
        "polarity_of_targets",
        "applies 0x607E to targets, but not to the feedback",
        "CiA 402-2, object 0x607E",
        "a public header of an EtherCAT driver for Elmo",
        _polarity_of_targets,
    ),
    Quirk(
        "one_ramp",
        "uses 0x6083 in PV for acceleration and deceleration",
        "CiA 402-2, object 0x6084",
        "Trinamic, TMCM-1270 manual",
        _model(lambda model, _strength: replace(model, velocity_ramp_both_ways=True)),
    ),
    Quirk(
        "own_velocity_unit",
        "has a velocity unit that no object describes (the strength is the number of counts/s in one unit)",
        "CiA 402-2, object 0x60A9",
        "Kinco, FD5 manual, p. 190 (512 x resolution / 1875 of a rpm)",
        _own_unit("own_speed"),
        strength=Strength("counts/s", 10.0, 1e-6, 1e6),
    ),
    Quirk(
        "own_ramp_unit",
        "has a unit of ramps that no object describes (the strength is the number of velocity units per s in one unit)",
        "CiA 402-2, object 0x6083",
        "Kinco, FD5 manual (65536 x resolution / 4000000 of a revolution per s^2)",
        _own_unit("own_ramp"),
        strength=Strength("velocity units/s", 1000.0, 1e-6, 1e6),
    ),
    Quirk(
        "parameter_clamped",
        "limits 0x6083 to the strength, without an error",
        "CiA 402-2, object 0x6083",
        "unsourced",
        node=lambda hooks, maximum: hooks.healthy(hooks.node.store.ceilings, {o.PROFILE_ACCELERATION: int(maximum)}),
        strength=whole("units", 1000, 1, 0xFFFFFFFF),
    ),
    Quirk(
        "inputs_shifted",
        "shows its switches in higher bits of 0x60FD",
        "CiA 402-2, object 0x60FD",
        "linuxcnc-ethercat: leadshine_stepper.md",
        _inputs_shifted,
        strength=whole("bits", 4, 1, 12),
    ),
    Quirk(
        "optional_missing",
        "has no objects 0x603F, 0x6007 and 0x60C2",
        "CiA 402-2, objects 0x603F, 0x6007 and 0x60C2",
        "unsourced",
        node=filter_frames(lacks_optional),
    ),
    Quirk(
        "error_code_absent",
        "has no 0x603F; only the EMCY contains the error code",
        "CiA 402-2, object 0x603F",
        "CANOpenRobotController: KincoDrive.cpp",
        node=hide_objects(o.ERROR_CODE),
    ),
    Quirk(
        "velocity_shown_zero",
        "shows 0 in 0x606C during a motion too, because it has no sensor for it",
        "CiA 402-2, object 0x606C",
        "unsourced",
        lambda hooks, drive, _strength: hooks.show(o.VELOCITY_ACTUAL + drive.objects.offset, 0, lambda _shown: 0),
    ),
    Quirk(
        "velocity_absent",
        "has no 0x606C",
        "CiA 402-2, object 0x606C",
        "unsourced",
        node=hide_objects(o.VELOCITY_ACTUAL),
    ),
)


# -- homing


def _homing_latched(hooks: QuirkHooks, drive: VirtualDrive, _strength: float) -> None:
    latched = [False]

    def change(word: int) -> int:
        homing = drive.modes.number == OperationMode.HM
        enabled = drive.state is State.OPERATION_ENABLED
        latched[0] = enabled and (latched[0] or (homing and bool(word & BIT_12)))
        return word | BIT_12 if homing and latched[0] else word

    def enable(transition: Transition, now: int, before: TransitionAct) -> None:
        latched[0] = False
        before(transition, now)

    hooks.act(drive, 4, enable)
    hooks.word(drive, change)


def _homing_shown_briefly(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    since: list[int] = []

    def change(word: int) -> int:
        if drive.modes.number != OperationMode.HM or not word & BIT_12:
            since.clear()
            return word
        since.append(drive.mover.time) if not since else None
        return word if drive.mover.time - since[0] < seconds * _S else word & ~BIT_12

    hooks.word(drive, change)


def _homing_zero_late(hooks: QuirkHooks, drive: VirtualDrive, seconds: float) -> None:
    units, mover, wait = drive.objects.units, drive.mover, round(seconds * _S)
    shown, changed_at = [units.zero], [_NEVER]

    def view(position: int) -> int:
        if units.zero == shown[0]:
            return position
        if changed_at[0] == _NEVER:
            changed_at[0] = mover.time
        if mover.time - changed_at[0] >= wait:
            shown[0], changed_at[0] = units.zero, _NEVER
            return position
        return wrap32((mover.plant.position - shown[0]) / units.position)

    hooks.show(o.POSITION_ACTUAL + drive.objects.offset, 0, view)


_HOMING_QUIRKS: Final[tuple[Quirk, ...]] = (
    Quirk(
        "homing_latched",
        "keeps bit 12 of homing set until it leaves OPERATION ENABLED",
        _HOMING,
        "aidin_hand2: header of the homing sequence",
        _homing_latched,
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_shown_briefly",
        "sets bit 12 of homing only for some time",
        _HOMING,
        "unsourced",
        _homing_shown_briefly,
        strength=in_seconds(0.05),
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_without_bit_12",
        "shows the end of homing only by bit 10",
        _HOMING,
        "unsourced",
        _in_homing(BIT_12),
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_without_bit_10",
        "never sets bit 10 in homing",
        _HOMING,
        "ros2_canopen#245 (JVL MIS)",
        _in_homing(TARGET_REACHED),
        group="bit 12 of homing",
    ),
    Quirk(
        "homing_zero_late",
        "shows its new position in 0x6064 only some time after homing has set its zero",
        _HOMING,
        "ODrive#710 (position estimate after homing)",
        _homing_zero_late,
        strength=in_seconds(0.05, 1.0),
    ),
    Quirk(
        "homing_zero_refused",
        "refuses homing method 0",
        "CiA 402-2, object 0x6098",
        "ros2_canopen#328 (Faulhaber)",
        axis_refuses(AbortCode.INVALID_VALUE, o.HOMING_METHOD, lambda _drive, value, _n: value == 0),
    ),
    Quirk(
        "homing_method_fixed",
        "refuses to write 0x6098 in OPERATION ENABLED",
        "CiA 402-2, object 0x6098",
        "unsourced",
        axis_refuses(
            AbortCode.DEVICE_STATE, o.HOMING_METHOD, lambda drive, _value, _n: drive.state is State.OPERATION_ENABLED
        ),
    ),
    Quirk(
        "homes_without_power",
        "sets its home position by methods 35 and 37 in every state, even without power",
        _HOMING,
        "Trinamic, TMCM-1270 manual",
        _model(lambda model, _strength: replace(model, homes_without_power=True)),
    ),
    Quirk(
        "homing_ignores_halt",
        "continues homing when the halt bit is set",
        _HOMING,
        "Trinamic, TMCM-1270 manual",
        _model(lambda model, _strength: replace(model, homing_halts=False)),
    ),
)


MOTION_QUIRKS: Final[tuple[Quirk, ...]] = (*_STATUSWORD, *_SET_POINTS, *_HOMING_QUIRKS)
