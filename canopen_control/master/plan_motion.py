"""Writes of a node's plan for cyclic motion: feed-forward, interpolation time period and offsets.

Feed-forward: the velocity and torque offset (0x60B1, 0x60B2) are mapped into the RPDOs of a node with `feed_forward`.
The mapping of bus.yml is kept. An offset is appended to the RPDO of the target position, else to another RPDO of
bus.yml with free space, else to one of the first four that are unused, with the transmission type of the target
position. An offset that cannot be mapped is reported and not used.

Interpolation time period (0x60C2): the SYNC period exactly, in 1 to 255 units of a power of ten. Rules (CiA 402-2): a
drive in CSP moves from one set-point to the next within this time. If it is shorter than the SYNC period, the drive
stops between set-points; if it is longer, each motion is interrupted. Another time in bus.yml is written, with a
warning. A period that the object cannot express, or that the drive refuses, is reported. So is a communication cycle
period (0x1006) other than the SYNC period.

Offsets (0x60B0, 0x60B1, 0x60B2): 0 unless `sdo` sets them, because an offset moves the axis without a command.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING, Final

from canopen_control.cia301.pdo import MAX_BITS
from canopen_control.cia402.objects import (
    INTERPOLATION_TIME_PERIOD,
    POSITION_OFFSET,
    TARGET_POSITION,
    TORQUE_OFFSET,
    VELOCITY_OFFSET,
)
from canopen_control.master.keys import SHORTEST_SYNC_US, PdoConfig, PdoObjectKeys
from canopen_control.master.plan_builder import STORED
from canopen_control.od.indices import CYCLE_PERIOD, RPDO, RPDO_MAPPING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.plan_builder import PlanBuilder


_OFFSETS: Final = {"velocity": VELOCITY_OFFSET, "effort": TORQUE_OFFSET}
_PREDEFINED: Final = range(1, 5)


def add_feed_forward(builder: PlanBuilder, axes: Sequence[int]) -> None:
    """Map the offsets requested by `feed_forward` into the node's RPDOs, for each axis."""
    offsets = [(name, _OFFSETS[name] + offset, offset) for name in builder.node.motion.feed_forward for offset in axes]
    for name, index, offset in offsets:
        rpdos = builder.node.boot.rpdo
        if any(index in _mapped(builder, number, pdo) for number, pdo in rpdos.items() if pdo.is_on):
            continue
        text = _why_not(builder, index) or _add_feed_forward(builder, index, TARGET_POSITION + offset)
        if text:
            builder.warn("feed_forward", f"{text}; feed-forward of {name} is not used")


def _why_not(builder: PlanBuilder, index: int) -> str:
    entry = builder.od.get(index, 0)
    if entry is None:
        return f"0x{index:04X} is not in {builder.file}"
    if not entry.rpdo_mappable or entry.data_type.bits is None:
        return f"0x{index:04X} {entry.name} cannot be mapped into an RPDO"
    return (
        "" if builder.node.boot.rpdo else f"bus.yml configures no RPDO; add one with 0x{index:04X} and the used objects"
    )


def _add_feed_forward(builder: PlanBuilder, index: int, target: int) -> str:
    """Map an object into the first suitable RPDO with enough free space; return the problem, or "" on success."""
    rpdos = builder.node.boot.rpdo
    mapped = [number for number, pdo in rpdos.items() if pdo.is_on and pdo.mapping is not None]
    mapped.sort(key=lambda number: target not in _mapped(builder, number, rpdos[number]))
    for number in mapped:
        pdo = rpdos[number]
        if pdo.mapping is not None and _has_room(builder, number, pdo.mapping, index):
            return _set_rpdo(builder, number, replace(pdo, mapping=[*pdo.mapping, PdoObjectKeys(index)]))
    of_target = next(
        (rpdos[number] for number in mapped if target in _mapped(builder, number, rpdos[number])), PdoConfig()
    )
    for number in _PREDEFINED:
        used = number in rpdos and rpdos[number].is_on
        if not used and _has_room(builder, number, [], index):
            return _set_rpdo(
                builder, number, PdoConfig(transmission=of_target.transmission, mapping=[PdoObjectKeys(index)])
            )
    return f"no RPDO of {builder.file} has room for 0x{index:04X}"


def _set_rpdo(builder: PlanBuilder, number: int, pdo: PdoConfig) -> str:
    boot = builder.node.boot
    builder.node = replace(builder.node, boot=replace(boot, rpdo={**boot.rpdo, number: pdo}))
    return ""


def _has_room(builder: PlanBuilder, number: int, mapping: Sequence[PdoObjectKeys], index: int) -> bool:
    od = builder.od
    entries = [od.get(keys.index, keys.sub_index) for keys in (*mapping, PdoObjectKeys(index))]
    bits = sum((entry.data_type.bits or 0) if entry is not None else MAX_BITS for entry in entries)
    last_slot = (RPDO_MAPPING + number - 1, len(entries))
    return bits <= MAX_BITS and (RPDO + number - 1, 1) in od and last_slot in od


def _mapped(builder: PlanBuilder, number: int, pdo: PdoConfig) -> list[int]:
    """Return the indices of the objects that an RPDO of bus.yml maps."""
    if pdo.mapping is not None:
        return [mapped.index for mapped in pdo.mapping]
    slots = range(1, (builder.default(RPDO_MAPPING + number - 1, 0) or 0) + 1)
    return [(builder.default(RPDO_MAPPING + number - 1, slot) or 0) >> 16 for slot in slots]


_MAX: Final = 0xFF
_EXPONENTS: Final = range(-9, 2)


_IP = 7


def plan_interpolation(builder: PlanBuilder, axes: Sequence[int], sync_period_us: int) -> None:
    """Plan the interpolation time period (0x60C2) of each axis; `axes` are the index offsets of the axes.

    Nothing is planned without SYNC, and for an impossible SYNC period, which is an error of its own.
    """
    if sync_period_us < SHORTEST_SYNC_US:
        return
    if axes:
        _compare_cycle_period(builder, sync_period_us)
    for offset in axes:
        index = INTERPOLATION_TIME_PERIOD + offset
        if (index, 1) not in builder.od:
            continue
        if builder.is_requested(index) and not _is_unset(builder, index):
            _compare(builder, index, sync_period_us)
        else:
            _add_interpolation(builder, index, sync_period_us)


def plan_offsets(builder: PlanBuilder, axes: Sequence[int]) -> None:
    """Plan 0 for offsets (0x60B0, 0x60B1, 0x60B2) that `sdo` does not set; `axes` are the index offsets of the axes.

    An offset is added to the target (CiA 402-2), so that the axis would move without a command. The drive may have
    stored an offset that neither the EDS nor a file contains.
    """
    for offset in axes:
        for index in (POSITION_OFFSET + offset, VELOCITY_OFFSET + offset, TORQUE_OFFSET + offset):
            zeroed = builder.is_requested(index) and not builder.final(index, 0)
            if builder.listed_value(index) is None and builder.can_write(index, 0) and not zeroed:
                reason = "an offset would move the axis without a command" if builder.final(index, 0) else STORED
                builder.write(index, 0, 0, "dcf", reason, optional=True)


def _compare_cycle_period(builder: PlanBuilder, sync_period_us: int) -> None:
    """Report a communication cycle period (0x1006) that differs from the SYNC period.

    Delta's ASDA-A2 reports a SYNC alarm if 0x1006 differs from 0x60C2 (canfestival-rtt, issue 18; canopen, issue 407).
    """
    period, line = builder.requested_value(CYCLE_PERIOD), f"{{index: 0x1006, sub_index: 0, value: {sync_period_us}}}"
    if builder.is_requested(CYCLE_PERIOD):
        if period is not None and period not in (0, sync_period_us):
            number = next((n for n, entry in enumerate(builder.node.boot.sdo) if entry.index == CYCLE_PERIOD), None)
            key = "dcf" if number is None else f"sdo[{number}]"
            builder.warn(key, f"0x1006 is {period} us, but the SYNC period {sync_period_us} us; write `{line}`")
    elif builder.node.motion.position_mode == _IP and builder.can_write(CYCLE_PERIOD, 0):
        period = builder.default(CYCLE_PERIOD, 0)
        if period != sync_period_us:
            builder.remark(
                "position_mode",
                f"0x1006, the SYNC period in us, remains {period or 0}; drives that report a SYNC alarm in IP "
                f"(Delta ASDA-A2) need `{line}` under `sdo:`",
            )


def _is_unset(builder: PlanBuilder, index: int) -> bool:
    """Whether only a file writes 0x60C2, and 0 to it: a saved DCF has every object with its default (maxon EPOS4)."""
    listed = any(entry.index == index for entry in builder.node.boot.sdo)
    return not listed and builder.downloaded_value(index, 1) == 0


def _compare(builder: PlanBuilder, index: int, sync_period_us: int) -> None:
    """Warn about a requested interpolation period that differs from the SYNC period."""
    value, exponent = builder.requested_value(index, 1), builder.requested_value(index, 2)
    value = builder.default(index, 1) if value is None else value
    exponent = builder.signed_default(index, 2) if exponent is None else exponent
    if value is None or exponent is None or exponent not in _EXPONENTS:
        return
    if value * Fraction(10) ** exponent != Fraction(sync_period_us, 1_000_000):
        number = next((n for n, entry in enumerate(builder.node.boot.sdo) if entry.index == index), None)
        builder.warn(
            "dcf" if number is None else f"sdo[{number}]",
            f"0x{index:04X} is {value} * 10^{exponent} s, but the SYNC period {sync_period_us / 1e6:g} s: "
            "positions would be interpolated over the wrong time; remove 0x60C2, the boot writes the SYNC period",
        )


def _add_interpolation(builder: PlanBuilder, index: int, sync_period_us: int) -> None:
    """Plan the SYNC period for 0x60C2, in the drive's unit if the exponent is read-only (one EDS in six)."""
    value, exponent = _interpolation(sync_period_us)
    reason = "interpolation over the SYNC period"
    if not builder.can_write(index, 2):
        fixed = builder.signed_default(index, 2)
        fitting = None if fixed is None else _in_unit(sync_period_us, fixed)
        if fitting is None:
            unit = "an unknown unit" if fixed is None else f"10^{fixed} s"
            builder.warn(
                "dcf",
                f"0x{index:04X}:02, the unit of the interpolation period, cannot be written, and {sync_period_us} us "
                f"cannot be expressed in {unit}; not written ({reason})",
            )
            return
        value = fitting
    elif value * Fraction(10) ** exponent != Fraction(sync_period_us, 1_000_000):
        builder.warn(
            "dcf",
            f"0x{index:04X} can be 1 to {_MAX} units of a power of ten, but not {sync_period_us} us: "
            f"{value} * 10^{exponent} s is written, and motion is not smooth; choose another sync_period",
        )
    builder.write(index, 1, value, "dcf", reason, optional=True)
    if builder.can_write(index, 1) and builder.can_write(index, 2):
        builder.write(index, 2, exponent, "dcf", reason, optional=True)


def _in_unit(period_us: int, exponent: int) -> int | None:
    """Return a period in units of 10^exponent s; None if the number is not whole or does not fit into one byte."""
    if exponent not in _EXPONENTS:
        return None
    value, rest = divmod(period_us * 1000, 10 ** (exponent + 9))
    return value if not rest and 0 < value <= _MAX else None


def _interpolation(period_us: int) -> tuple[int, int]:
    """Return a period as (value, power of ten) in s, rounded so that the value fits into one byte."""
    value, exponent = period_us, -6
    while value % 10 == 0 or value > _MAX:
        value, exponent = (value // 10 if value % 10 == 0 else round(value / 10)), exponent + 1
        if exponent == -3 and value <= _MAX:
            break
    return value, exponent
