"""Checks of a drive with motion: modes of operation, ramps, halt, quick stop, homing, limits (CiA 402-2).

All checks need `--motion` and a shaft that is free to turn. `drive_steps` bounds every motion and returns the shaft.
"""

from __future__ import annotations

from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

from canopen_control.cia301.nmt import ERROR_CONTROL_COB_ID, NmtCommand
from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.cia402.state import HALT_BIT, INTERNAL_LIMIT, TARGET_REACHED, decode_statusword
from canopen_control.conformance.check import CheckLevel, CheckList, CheckTouch, expect
from canopen_control.conformance.checked_node import CheckFailed, NotApplicable
from canopen_control.conformance.drive_steps import (
    ENABLE,
    FAULT,
    IMMEDIATELY,
    NEW_SET_POINT,
    OE,
    ON,
    PERIOD_MS,
    QSA,
    RAMP_S,
    RELATIVE,
    SOD,
    control,
    drive_at,
    expect_bits,
    fast,
    is_drive,
    moving,
    option,
    reaches,
    reset_fault,
    sample,
    set_mode,
    set_point,
    signed,
    statusword,
    stays,
    step_of,
    still,
    streaming,
    turn,
    until,
    watch,
    window,
)
from canopen_control.conformance.nmt_checks import boot, other_node_id
from canopen_control.errors import SdoAbort

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.conformance.checked_node import CheckedNode
    from canopen_control.conformance.drive_steps import CheckMotion, DriveSample


MOTION_CHECKS = CheckList("402")
_add = MOTION_CHECKS.add
_SHOULD, _MOTION = CheckLevel.SHOULD, CheckTouch.MOTION
_POWER, _PP, _HOMING = "402-2, 6.3 (power state machine)", "402-2, 10 (profile position)", "402-2, 11 (homing)"
_CSP, _CSV, _CST = (
    "402-2, 12 (cyclic synchronous position)",
    "402-2, 13 (cyclic synchronous velocity)",
    "402-2, 14 (cyclic synchronous torque)",
)
_UNIT = "402-2, objects 0x606C and 0x60A9"
_BIT_12, _BIT_13 = 1 << 12, 1 << 13
_TIME_S = 1.5  # maximum time of a motion over the distance
_PV, _PP_MODE, _HM = OperationMode.PV, OperationMode.PP, OperationMode.HM


def _seconds(samples: list[DriveSample]) -> float:
    return samples[-1].seconds - samples[0].seconds


def _furthest(motion: CheckMotion, samples: list[DriveSample]) -> int:
    return max(abs(one.position - motion.start) for one in samples)


def _expect_duration(seconds: float, expected: float) -> None:
    """Check that a time is within 20 % of the expected time, plus two sample periods."""
    good = abs(seconds - expected) <= 0.2 * expected + 0.02
    expect(good, f"{seconds * 1000:.0f} ms", f"{expected * 1000:.0f} ms")


# -- the power stage and its first motion


@_add("D43m", "402-2, objects 0x6040 and 0x60FF", "PV: the shaft reaches 0x60FF in OPERATION ENABLED", touch=_MOTION)
def _turns(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        turn(node, motion, motion.velocity)


@_add("D23m", _POWER, "the shaft follows a set-point within 0.3 s of OPERATION ENABLED", _SHOULD, _MOTION)
def _follows_soon(node: CheckedNode) -> None:
    with moving(node, _PV, ON) as motion:
        node.put(o.TARGET_VELOCITY, 0, motion.velocity & 0xFFFFFFFF, 4)
        control(node, ENABLE)
        reaches(node, OE)
        until(node, motion, lambda one: fast(one, motion.velocity), 0.3, f"velocity {motion.velocity}")


@_add("D20e", _POWER, "the first enable after a reset leads to OPERATION ENABLED", touch=_MOTION)
def _first_enable(node: CheckedNode) -> None:
    is_drive(node)
    boot(node)
    with drive_at(node, ON):
        control(node, ENABLE)
        reaches(node, OE)
        stays(node, OE, 0.2)


@_add("D44v", _POWER, "the drive stays in SWITCHED ON without main power", _SHOULD, _MOTION)
def _without_mains(node: CheckedNode) -> None:
    is_drive(node)
    if statusword(node) & 0x10:
        raise NotApplicable("bit 4 of 0x6041 shows main power; switch it off for this check")
    with drive_at(node, ON):
        stays(node, ON, 4.0)


@_add("D37", _POWER, "a reset does not clear a fault whose cause is present", touch=_MOTION)
def _lasting_fault(node: CheckedNode) -> None:
    is_drive(node)
    if decode_statusword(statusword(node)) is not FAULT:
        raise NotApplicable("the drive is not in FAULT")
    reset_fault(node)
    states = set()
    for _ in range(100):
        states.add(decode_statusword(statusword(node)))
        node.listen(0.01)
    control(node, 0x00)
    last = decode_statusword(statusword(node))
    expect(last is not FAULT or states == {FAULT}, "FAULT was left, and entered again", "FAULT, or no fault for 1 s")


@_add("D07", "402-2, object 0x60FD", "the reserved bits 4 to 15 of 0x60FD are 0", _SHOULD)
def _reserved_inputs(node: CheckedNode) -> None:
    is_drive(node)
    inputs = node.number(o.DIGITAL_INPUTS)
    expect(not inputs & 0xFFF0, f"0x60FD = 0x{inputs:08X}", "bits 4 to 15 = 0")


# -- profile velocity


@_add("D50", "402-2, object 0x6083", "PV: the shaft accelerates by 0x6083", _SHOULD, _MOTION)
def _acceleration(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        _expect_duration(_seconds(turn(node, motion, motion.velocity)), 0.9 * RAMP_S)


@_add("D50d", "402-2, object 0x6084", "PV: the shaft decelerates by 0x6084", _SHOULD, _MOTION)
def _deceleration(node: CheckedNode) -> None:
    with moving(node, _PV, deceleration_share=0.4) as motion:
        turn(node, motion, motion.velocity)
        node.put(o.TARGET_VELOCITY, 0, 0, 4)
        stop = until(node, motion, lambda one: still(one, motion.speed), 1.0, "standstill by the ramp 0x6084")
        _expect_duration(_seconds(stop), 0.9 * RAMP_S / 0.4)


def _same_sense(node: CheckedNode, motion: CheckMotion, velocity: int) -> None:
    turn(node, motion, velocity)
    first, *_, last = watch(node, motion, 0.05)
    expect(last.velocity * velocity > 0, f"0x606C = {last.velocity}", f"the sign of 0x60FF = {velocity}")
    change = last.position - first.position
    expect(change * velocity > 0, f"0x6064 changed by {change}", f"the sign of 0x60FF = {velocity}")


@_add("D51", "402-2, objects 0x60FF and 0x606C", "PV: 0x6064 and 0x606C have the sign of 0x60FF", touch=_MOTION)
def _sense(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        _same_sense(node, motion, motion.velocity)
        _same_sense(node, motion, -motion.velocity)


@_add("D51p", "402-2, object 0x607E", "PV: 0x607E inverts targets and feedback alike", touch=_MOTION)
def _polarity(node: CheckedNode) -> None:
    is_drive(node)
    with node.kept(o.POLARITY) as polarity:
        node.put(o.POLARITY, 0, polarity ^ 0xC0, 1)
        with moving(node, _PV) as motion:
            try:
                _same_sense(node, motion, motion.velocity)
            except CheckFailed as failure:
                raise CheckFailed(
                    failure.observed, f"{failure.expected}, with 0x607E = 0x{polarity ^ 0xC0:02X}"
                ) from None


@_add("D15v", _UNIT, "without a defined unit, 0x606C is the change of 0x6064 per second", _SHOULD, _MOTION)
def _velocity_unit(node: CheckedNode) -> None:
    is_drive(node)
    for index, subindex in ((o.SI_UNIT_VELOCITY, 0), (o.VELOCITY_FACTOR, 1)):
        if node.has(index, subindex):
            raise NotApplicable(f"0x{index:04X} defines the unit")
    with moving(node, _PV) as motion:
        turn(node, motion, motion.velocity)
        node.listen(0.05)
        samples = watch(node, motion, 0.1)
        rate = (samples[-1].position - samples[0].position) / _seconds(samples)
        shown = samples[-1].velocity
        expect(abs(rate - shown) <= 0.2 * abs(shown), f"0x606C = {shown}, 0x6064 changes by {rate:.0f} per s", "equal")


@_add("D52", "402-2, object 0x6041", "PV: bit 10 is 0 on the ramp and 1 at the target velocity", touch=_MOTION)
def _velocity_reached(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        ramp = turn(node, motion, motion.velocity)
        middle = [one for one in ramp if 0.2 < abs(one.velocity) / motion.speed < 0.8]
        early = next((one for one in middle if one.word & TARGET_REACHED), None)
        expect(early is None, "" if early is None else f"bit 10 = 1 at velocity {early.velocity}", "bit 10 = 0")
        until(node, motion, lambda one: bool(one.word & TARGET_REACHED), 0.5, "bit 10 = 1")


@_add("D52z", "402-2, object 0x6041", "PV: bit 12 (speed 0) is 1 only at standstill", touch=_MOTION)
def _speed_zero(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        until(node, motion, lambda one: bool(one.word & _BIT_12), 0.5, "bit 12 = 1 at standstill")
        turn(node, motion, motion.velocity)
        expect_bits(node, _BIT_12, 0, "bit 12 = 0")


@_add("D53", "402-2, object 0x605D", "PV: halt stops the shaft, and its end resumes the motion", touch=_MOTION)
def _halt(node: CheckedNode) -> None:
    is_drive(node)
    with option(node, o.HALT_OPTION, 1), moving(node, _PV) as motion:
        turn(node, motion, motion.velocity)
        control(node, ENABLE | HALT_BIT)
        until(node, motion, lambda one: still(one, motion.speed), 1.0, "standstill")
        reaches(node, OE, 0.1)
        until(node, motion, lambda one: bool(one.word & TARGET_REACHED), 0.5, "bit 10 = 1 at the standstill of a halt")
        control(node, ENABLE)
        until(node, motion, lambda one: fast(one, motion.velocity), 0.5, f"velocity {motion.velocity}")


@_add("D68m", "402-2, objects 0x6060 and 0x6061", "the mode changes while the shaft turns", _SHOULD, _MOTION)
def _mode_in_motion(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        turn(node, motion, motion.velocity // 2 or 1)
        node.put(o.MODES_OF_OPERATION, 0, _PP_MODE, 1)
        node.listen(0.05)
        shown = signed(node, o.MODES_OF_OPERATION_DISPLAY)
        control(node, ENABLE | HALT_BIT)
        watch(node, motion, 0.2)
        expect(shown == _PP_MODE, f"0x6061 = {shown}", "1 (PP)")


# -- stops while the shaft turns


for _code, _text in (
    (1, "0x6084, and ends in SWITCH ON DISABLED"),
    (2, "0x6085, and ends in SWITCH ON DISABLED"),
    (5, "0x6084, and stays in QUICK STOP ACTIVE"),
    (6, "0x6085, and stays in QUICK STOP ACTIVE"),
):

    @_add(
        f"D62q{_code}",
        "402-2, 6.3 (object 0x605A)",
        f"a quick stop with 0x605A = {_code} uses the ramp {_text}",
        touch=_MOTION,
    )
    def _quick_stop(node: CheckedNode, code: int = _code) -> None:
        is_drive(node)
        with option(node, o.QUICK_STOP_OPTION, code), moving(node, _PV) as motion:
            deceleration = o.QUICK_STOP_DECELERATION if code in (2, 6) else o.PROFILE_DECELERATION
            other = o.PROFILE_DECELERATION if code in (2, 6) else o.QUICK_STOP_DECELERATION
            node.put(other, 0, 4 * motion.ramp, 4)
            node.put(deceleration, 0, motion.ramp // 2, 4)
            turn(node, motion, motion.velocity)
            control(node, 0x02)
            stop = until(node, motion, lambda one: still(one, motion.speed), 1.0, "standstill")
            _expect_duration(_seconds(stop), 2 * 0.9 * RAMP_S)
            reaches(node, SOD if code < 5 else QSA, 1.0)


@_add("D31m", "402-2, 6.3 (object 0x605A)", "0x0F does not end a quick stop with 0x605A = 2", touch=_MOTION)
def _not_resumed(node: CheckedNode) -> None:
    is_drive(node)
    with option(node, o.QUICK_STOP_OPTION, 2), moving(node, _PV) as motion:
        node.put(o.QUICK_STOP_DECELERATION, 0, motion.ramp // 3 or 1, 4)
        turn(node, motion, motion.velocity)
        control(node, 0x02)
        reaches(node, QSA, 0.1)
        node.put(o.TARGET_VELOCITY, 0, 0, 4)
        control(node, ENABLE)
        for one in watch(node, motion, 0.1):
            expect(decode_statusword(one.word) is not OE, OE.name, "QUICK_STOP_ACTIVE until standstill")


def _stops(node: CheckedNode, motion: CheckMotion, why: str) -> None:
    until(node, motion, lambda one: still(one, motion.speed), 2.0, f"standstill: {why}")
    state = decode_statusword(statusword(node))
    expect(state is not OE, OE.name, f"no power: {why}")


@_add("D41m", _POWER, "NMT stop stops a turning shaft", touch=_MOTION)
def _nmt_stop(node: CheckedNode) -> None:
    with moving(node, _PV) as motion:
        turn(node, motion, motion.velocity)
        node.nmt(NmtCommand.STOP)
        node.listen(2 * RAMP_S)
        node.nmt(NmtCommand.START)
        node.listen(0.02)
        _stops(node, motion, "0x6007 after NMT stop")


@_add("D67", "402-2, object 0x6007", "the loss of the master's heartbeat stops a turning shaft", touch=_MOTION)
def _master_lost(node: CheckedNode) -> None:
    is_drive(node)
    other = other_node_id(node)
    with option(node, o.ABORT_CONNECTION_OPTION, 1), node.kept(0x1016, 1), moving(node, _PV) as motion:
        node.put(0x1016, 1, other << 16 | 200, 4)
        node.send(ERROR_CONTROL_COB_ID + other, b"\5")
        turn(node, motion, motion.velocity)
        node.listen(0.3)
        node.nmt(NmtCommand.START)
        node.listen(0.02)
        _stops(node, motion, "0x6007 = 1")
        node.put(0x1016, 1, 0, 4)


# -- profile position


@_add("D56m", _PP, "PP: the shaft reaches a set-point, and bit 10 is 1 only there", touch=_MOTION)
def _one_move(node: CheckedNode) -> None:
    with moving(node, _PP_MODE) as motion:
        target, near = motion.start + motion.distance, window(node, motion)
        set_point(node, target)
        for one in watch(node, motion, _time(motion)):
            far = abs(one.position - target) > 4 * near
            expect(not far or not one.word & TARGET_REACHED, f"bit 10 = 1 at {one.position}", f"0 before {target}")
        last = sample(node, motion)
        expect(abs(last.position - target) <= 4 * near, f"position {last.position}", f"{target}")
        expect(bool(last.word & TARGET_REACHED), f"statusword 0x{last.word:04X}", "bit 10 = 1")


def _time(motion: CheckMotion, distances: int = 1) -> float:
    """Return the time in s for which a PP motion is observed: its expected duration, up to a limit."""
    return min(distances * abs(motion.distance) / motion.speed + 2 * RAMP_S, distances * _TIME_S) + 0.1


def _arrives(node: CheckedNode, motion: CheckMotion, target: int, distances: int = 1) -> list[DriveSample]:
    near = 4 * window(node, motion)

    def is_there(one: DriveSample) -> bool:
        return abs(one.position - target) <= near and bool(one.word & TARGET_REACHED)

    return until(node, motion, is_there, distances * _TIME_S + 1.0, f"position {target}, and bit 10 = 1")


@_add("D55s", _PP, "PP: a second set-point is acknowledged while the first one is in progress", touch=_MOTION)
def _set_of_set_points(node: CheckedNode) -> None:
    with moving(node, _PP_MODE) as motion:
        set_point(node, motion.start + motion.distance)
        node.listen(0.05)
        set_point(node, motion.start + motion.distance * 5 // 4)
        _arrives(node, motion, motion.start + motion.distance * 5 // 4, 2)


@_add("D55b", _PP, "PP: a second set-point without bit 5 waits until the first one is reached", touch=_MOTION)
def _buffered(node: CheckedNode) -> None:
    with moving(node, _PP_MODE) as motion:
        near = 4 * window(node, motion)
        set_point(node, motion.start + motion.distance)
        node.listen(0.05)
        set_point(node, motion.start)
        furthest = _furthest(motion, watch(node, motion, 2 * _time(motion)))
        expected = f"{abs(motion.distance)}, the first set-point, and then the second"
        expect(furthest >= abs(motion.distance) - near, f"turned round after {furthest}", expected)
        _arrives(node, motion, motion.start)


@_add("D55i", _PP, "PP: a second set-point with bit 5 takes effect at once", touch=_MOTION)
def _immediately(node: CheckedNode) -> None:
    with moving(node, _PP_MODE) as motion:
        set_point(node, motion.start + motion.distance)
        node.listen(RAMP_S)
        set_point(node, motion.start, IMMEDIATELY)
        furthest = _furthest(motion, _arrives(node, motion, motion.start))
        expected = f"less than {abs(motion.distance)}: the second set-point replaces the first"
        expect(furthest < 0.9 * abs(motion.distance), f"moved by {furthest}", expected)


@_add("D55r", _PP, "PP: a set-point with bit 6 is relative", touch=_MOTION)
def _relative(node: CheckedNode) -> None:
    with moving(node, _PP_MODE) as motion:
        set_point(node, motion.distance // 2, RELATIVE)
        _arrives(node, motion, motion.start + motion.distance // 2)


@_add("D53p", _PP, "PP: halt stops the motion, and its end resumes the motion", touch=_MOTION)
def _halted_move(node: CheckedNode) -> None:
    with option(node, o.HALT_OPTION, 1), moving(node, _PP_MODE) as motion:
        set_point(node, motion.start + motion.distance)
        until(node, motion, lambda one: fast(one, motion.velocity), 0.5, f"velocity {motion.velocity}")
        control(node, ENABLE | HALT_BIT)
        until(node, motion, lambda one: still(one, motion.speed), 1.0, "standstill")
        control(node, ENABLE)
        _arrives(node, motion, motion.start + motion.distance)


@contextmanager
def _limited(node: CheckedNode) -> Iterator[CheckMotion]:
    """Context for PP in which the limits of 0x607D permit only half the distance of the motion."""
    is_drive(node)
    limit = o.SOFTWARE_POSITION_LIMIT
    with node.kept(limit, 1), node.kept(limit, 2), moving(node, _PP_MODE) as motion:
        ends = sorted((motion.start + motion.distance // 2, motion.start - motion.distance))
        for subindex, end in enumerate(ends, 1):
            node.put(limit, subindex, end & 0xFFFFFFFF, 4)
        yield motion


@_add("D57", "402-2, object 0x607D", "PP: a set-point beyond 0x607D ends at the limit", touch=_MOTION)
def _position_limit(node: CheckedNode) -> None:
    with _limited(node) as motion:
        with suppress(SdoAbort):  # a drive may refuse the value
            set_point(node, motion.start + motion.distance)
        furthest = _furthest(motion, watch(node, motion, _time(motion)))
        expected = f"at most {abs(motion.distance) // 2}, the limit in 0x607D"
        expect(furthest <= abs(motion.distance) // 2 + 4 * window(node, motion), f"moved by {furthest}", expected)


@_add("D57b", "402-2, object 0x6041", "bit 11 of 0x6041 is 1 at a limit of 0x607D", _SHOULD, _MOTION)
def _limit_shown(node: CheckedNode) -> None:
    with _limited(node) as motion:
        try:
            set_point(node, motion.start + motion.distance)
        except SdoAbort as error:
            raise NotApplicable(f"the drive refuses a target beyond 0x607D: 0x{error.code:08X}") from None
        until(node, motion, lambda one: bool(one.word & INTERNAL_LIMIT), _TIME_S, "bit 11 = 1")


# -- homing


@contextmanager
def _homing(node: CheckedNode, method: int, state: object = OE) -> Iterator[CheckMotion]:
    """Context with the drive in homing mode with `method`, and with the current position as the home offset."""
    is_drive(node)
    with node.kept(o.HOMING_METHOD), ExitStack() as stack:
        try:
            node.put(o.HOMING_METHOD, 0, method, 1)
        except SdoAbort as error:
            raise NotApplicable(f"0x6098 refuses method {method}: 0x{error.code:08X}") from None
        with suppress(NotApplicable):
            stack.enter_context(node.kept(o.HOME_OFFSET))
            node.write(o.HOME_OFFSET, 0, node.read(o.POSITION_ACTUAL))
        motion = stack.enter_context(moving(node, _HM, OE if state is OE else ON))
        yield motion


def _home_in_place(node: CheckedNode) -> None:
    control(node, ENABLE)
    control(node, ENABLE | NEW_SET_POINT)
    for _ in range(200):
        if statusword(node) & (_BIT_12 | _BIT_13 | TARGET_REACHED):
            break
        node.listen(0.005)


@_add("D65", _HOMING, "method 37 ends with bits 12 and 10 = 1 and bit 13 = 0", touch=_MOTION)
def _homed(node: CheckedNode) -> None:
    with _homing(node, 37) as motion:
        _home_in_place(node)
        done = _BIT_12 | TARGET_REACHED
        until(node, motion, lambda one: one.word & (done | _BIT_13) == done, 1.0, "bits 12 and 10 = 1, bit 13 = 0")


@_add("D65k", _HOMING, "bit 12 stays 1 after homing", touch=_MOTION)
def _stays_homed(node: CheckedNode) -> None:
    with _homing(node, 37):
        _home_in_place(node)
        node.listen(0.5)
        expect_bits(node, _BIT_12, _BIT_12, "bit 12 = 1 until the next homing")


@_add("D65z", _HOMING, "after homing method 37, 0x6064 equals 0x607C", touch=_MOTION)
def _home_position(node: CheckedNode) -> None:
    with _homing(node, 37) as motion:
        offset = motion.start + motion.distance // 10
        node.put(o.HOME_OFFSET, 0, offset & 0xFFFFFFFF, 4)
        _home_in_place(node)
        shown = signed(node, o.POSITION_ACTUAL)
        # back to the old origin, so that the positions are as before
        control(node, ENABLE)
        node.put(o.HOME_OFFSET, 0, motion.start + shown - offset & 0xFFFFFFFF, 4)
        _home_in_place(node)
        expect(abs(shown - offset) <= window(node, motion), f"0x6064 = {shown}", f"{offset}")


@_add("D65o", _HOMING, "homing needs OPERATION ENABLED", touch=_MOTION)
def _homed_without_power(node: CheckedNode) -> None:
    with _homing(node, 37, ON):
        control(node, 0x07)
        control(node, 0x07 | NEW_SET_POINT)
        node.listen(0.1)
        expect_bits(node, _BIT_12, 0, "bit 12 = 0 in SWITCHED ON")


_SEARCH = 17  # method: homing to the negative limit switch, which is interrupted before the switch is reached


@contextmanager
def _searching(node: CheckedNode) -> Iterator[CheckMotion]:
    """Context in which the drive searches for a limit switch at half the speed; on exit, bit 4 = 0 ends the search."""
    with ExitStack() as stack:
        motion = stack.enter_context(_homing(node, _SEARCH))
        for subindex in (1, 2):
            stack.enter_context(node.kept(o.HOMING_SPEEDS, subindex))
            node.put(o.HOMING_SPEEDS, subindex, max(motion.speed // 2, 1), 4)
        with suppress(NotApplicable):
            stack.enter_context(node.kept(o.HOMING_ACCELERATION))
            node.put(o.HOMING_ACCELERATION, 0, motion.ramp, 4)
        control(node, ENABLE | NEW_SET_POINT)
        try:
            until(node, motion, lambda one: abs(one.velocity) >= 0.4 * motion.speed, 0.5, "a search in method 17")
            yield motion
        finally:
            control(node, ENABLE)
            node.listen(2 * RAMP_S)


@_add("D66", _HOMING, "bits 12 and 10 are 0 while homing runs", touch=_MOTION)
def _search_shown(node: CheckedNode) -> None:
    with _homing(node, 37):
        _home_in_place(node)
        control(node, ENABLE)
        node.put(o.HOMING_METHOD, 0, _SEARCH, 1)
        with _searching(node) as motion:
            word = sample(node, motion).word
            expect(not word & (_BIT_12 | TARGET_REACHED), f"statusword 0x{word:04X}", "bits 12 and 10 = 0")


@_add("D66i", _HOMING, "bit 4 = 0 interrupts homing", touch=_MOTION)
def _interrupted(node: CheckedNode) -> None:
    with _searching(node) as motion:
        control(node, ENABLE)
        until(node, motion, lambda one: still(one, motion.speed // 2), 1.0, "standstill")
        expect_bits(node, _BIT_12, 0, "bit 12 = 0")


@_add("D66h", _HOMING, "halt stops homing", touch=_MOTION)
def _homing_halted(node: CheckedNode) -> None:
    with _searching(node) as motion:
        control(node, ENABLE | NEW_SET_POINT | HALT_BIT)
        until(node, motion, lambda one: still(one, motion.speed // 2), 0.5, "standstill by bit 8")


# -- interpolated and cyclic modes


@_add("D58i", "402-2, object 0x60C1", "IP: the shaft follows 0x60C1:01", touch=_MOTION)
def _interpolated(node: CheckedNode) -> None:
    is_drive(node)
    with moving(node, OperationMode.IP) as motion:
        node.optional(o.INTERPOLATION_DATA, 1)
        node.put(o.INTERPOLATION_DATA, 1, motion.start & 0xFFFFFFFF, 4)
        control(node, ENABLE | NEW_SET_POINT)
        distance = motion.distance // 20
        for number in range(1, 11):
            node.put(o.INTERPOLATION_DATA, 1, motion.start + distance * number // 10 & 0xFFFFFFFF, 4)
            node.listen(0.02)
        node.listen(0.2)
        moved = sample(node, motion).position - motion.start
        expect(
            abs(moved - distance) <= max(window(node, motion), abs(distance) // 4), f"moved by {moved}", f"{distance}"
        )


@_add("D58", _CSP, "CSP: the shaft follows set-points sent by RPDO and SYNC", touch=_MOTION)
def _cyclic_position(node: CheckedNode) -> None:
    with streaming(node, OperationMode.CSP, o.TARGET_POSITION) as (motion, stream):
        step = step_of(motion)
        rise = [(1, step * part // 5) for part in range(1, 5)]
        for cycles, size in (*rise, (20, step), *reversed(rise)):
            stream.cycles(cycles, size)
        node.listen(0.1)
        at = sample(node, motion).position
        expect(abs(at - stream.value) <= 2 * abs(step), f"position {at}", f"{stream.value}")


@_add("D58r", _CSP, "CSP: a set-point sent 2 ms before SYNC takes effect at that SYNC", _SHOULD, _MOTION)
def _in_time(node: CheckedNode) -> None:
    with streaming(node, OperationMode.CSP, o.TARGET_POSITION) as (motion, stream):
        step = step_of(motion) // 4 or 1
        for _ in range(5):
            value = stream.value + step
            node.listen((PERIOD_MS - 2) / 1000)
            stream.send(value)
            stream.sync()
            node.listen(0.0005)
            shown = signed(node, o.TARGET_POSITION)
            expect(shown == value, f"0x607A = {shown} after SYNC", f"{value}")


@_add("D58j", _CSP, "CSP: the shaft turns evenly if a SYNC is late by a tenth of its period", _SHOULD, _MOTION)
def _even(node: CheckedNode) -> None:
    late = PERIOD_MS / 10
    with streaming(node, OperationMode.CSP, o.TARGET_POSITION) as (motion, stream):
        step = step_of(motion)
        shares = []
        for number in range(24):
            stream.send(stream.value + step)
            if number % 2 and number > 12:
                node.listen((stream.next_sync - node.reactor.now()) / 1e9 + PERIOD_MS / 1000)
                first = sample(node, motion)
                stream.sync(late)
                last = sample(node, motion)
                shares.append((last.position - first.position) / step * PERIOD_MS / late)
            else:
                stream.sync(late if number % 2 else 0.0)
        least = min(shares)
        expect(least > 0.3, f"{least:.0%} of the velocity until a late SYNC", "about 100 %")


@_add("D59e", _CSP, "CSP: without new set-points the shaft stops at the last one", _SHOULD, _MOTION)
def _ends(node: CheckedNode) -> None:
    with streaming(node, OperationMode.CSP, o.TARGET_POSITION) as (motion, stream):
        step = step_of(motion)
        stream.cycles(15, step)
        node.listen(0.3)
        beyond = (sample(node, motion).position - stream.value) / step
        expect(abs(beyond) <= 0.3, f"{beyond:.1f} steps beyond the last set-point", "at most 0.3 steps")


@_add("D59m", _CSP, "CSP: two missing set-points cause no fault while the shaft turns", _SHOULD, _MOTION)
def _missing(node: CheckedNode) -> None:
    with streaming(node, OperationMode.CSP, o.TARGET_POSITION) as (motion, stream):
        stream.cycles(10, step_of(motion) // 2 or 1)
        stream.sync()
        stream.sync()
        stream.cycles(5, 0)
        reaches(node, OE, 0.0)


@_add("D60s", "402-2, 12 (object 0x1006)", "CSP: the drive is enabled for any value of 0x1006", _SHOULD, _MOTION)
def _period_of_others(node: CheckedNode) -> None:
    with drive_at(node, ON):
        set_mode(node, OperationMode.CSP)
        node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
        control(node, ENABLE)
        reaches(node, OE)
        stays(node, OE, 0.2)


@_add("D61", _CSV, "CSV: the shaft follows the set-points", touch=_MOTION)
def _cyclic_velocity(node: CheckedNode) -> None:
    with streaming(node, OperationMode.CSV, o.TARGET_VELOCITY) as (motion, stream):
        stream.cycles(10, motion.velocity // 20)
        stream.cycles(5, 0)
        velocity = sample(node, motion).velocity
        expect(abs(velocity - stream.value) <= 0.2 * motion.speed, f"0x606C = {velocity}", f"{stream.value}")
        stream.cycles(10, -motion.velocity // 20)


@_add("D61t", _CST, "CST: the demand 0x6074 does not exceed 0x6072", touch=_MOTION)
def _torque_limit(node: CheckedNode) -> None:
    is_drive(node)
    node.optional(o.TORQUE_DEMAND)
    with node.kept(o.TARGET_TORQUE), node.kept(o.MAX_TORQUE):
        node.put(o.TARGET_TORQUE, 0, 0, 2)
        node.put(o.MAX_TORQUE, 0, 10, 2)
        with moving(node, OperationMode.CST) as motion:
            node.put(o.TARGET_TORQUE, 0, 20, 2)
            node.listen(0.005)
            shown = signed(node, o.TORQUE_DEMAND)
            node.put(o.TARGET_TORQUE, 0, 0, 2)
            sample(node, motion)
            expect(abs(shown) <= 10, f"0x6074 = {shown}", "at most 0x6072 = 10")


@_add("D68t", "402-2, object 0x6060", "the mode changes from CST to CSP in OPERATION ENABLED", _SHOULD, _MOTION)
def _torque_to_position(node: CheckedNode) -> None:
    is_drive(node)
    with node.kept(o.TARGET_TORQUE):
        node.put(o.TARGET_TORQUE, 0, 0, 2)
        with moving(node, OperationMode.CST):
            node.write(o.TARGET_POSITION, 0, node.read(o.POSITION_ACTUAL))
            set_mode(node, OperationMode.CSP)
            stays(node, OE, 0.2)
