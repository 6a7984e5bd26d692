"""The interpolation time period (0x60C2) of a plan: the SYNC period exactly, in 1 to 255 units of a power of ten.

The law of this file (CiA 402-2): a drive in CSP moves from one set-point to the next within this time. Shorter than the
SYNC period, it stops in between; longer, it is interrupted. Where bus.yml says another time that is written, and warned
of; what the drive cannot be told exactly, or does not take, is told too.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import INTERPOLATION_TIME_PERIOD

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.master.plan_builder import PlanBuilder

__all__ = ["plan_interpolation"]

_MOST: Final = 0xFF
_EXPONENTS: Final = range(-9, 2)


def plan_interpolation(builder: PlanBuilder, axes: Sequence[int], sync_period_us: int) -> None:
    """Plan it for each axis, given by the offset of its objects."""
    if not sync_period_us:
        return
    for offset in axes:
        index = INTERPOLATION_TIME_PERIOD + offset
        if (index, 1) not in builder.od:
            continue
        if builder.asked_for(index):
            _compare(builder, index, sync_period_us)
        else:
            _add(builder, index, sync_period_us)


def _compare(builder: PlanBuilder, index: int, sync_period_us: int) -> None:
    """Warn of another time than SYNC's; what is not written is as in the EDS."""
    value, exponent = builder.asked_value(index, 1), builder.asked_value(index, 2)
    value = builder.default(index, 1) if value is None else value
    exponent = builder.signed_default(index, 2) if exponent is None else exponent
    if value is None or exponent is None or exponent not in _EXPONENTS:
        return
    if value * Fraction(10) ** exponent != Fraction(sync_period_us, 1_000_000):
        number = next((n for n, entry in enumerate(builder.node.boot.sdo) if entry.index == index), None)
        builder.warn(
            "dcf" if number is None else f"sdo[{number}]",
            f"0x{index:04X} is {value} * 10^{exponent} s, SYNC comes every {sync_period_us / 1e6:g} s: "
            "positions would be interpolated over the wrong time; leave 0x60C2 out, the boot writes it",
        )


def _add(builder: PlanBuilder, index: int, sync_period_us: int) -> None:
    """Add the SYNC period, in the drive's own unit where that cannot be written (it is `ro` in one EDS out of six)."""
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
                f"cannot be told in {unit}; done without ({reason})",
            )
            return
        value = fitting
    elif value * Fraction(10) ** exponent != Fraction(sync_period_us, 1_000_000):
        builder.warn(
            "dcf",
            f"0x{index:04X} holds 1 to {_MOST} units of a power of ten, and {sync_period_us} us is none: "
            f"{value} * 10^{exponent} s is written, and positions tick; take another sync_period",
        )
    builder.write(index, 1, value, "dcf", reason, optional=True)
    if builder.can_write(index, 1) and builder.can_write(index, 2):
        builder.write(index, 2, exponent, "dcf", reason, optional=True)


def _in_unit(period_us: int, exponent: int) -> int | None:
    """Return a period as a whole number of 10^exponent seconds, None where it is none of one byte."""
    if exponent not in _EXPONENTS:
        return None
    value, rest = divmod(period_us * 1000, 10 ** (exponent + 9))
    return value if not rest and 0 < value <= _MOST else None


def _interpolation(period_us: int) -> tuple[int, int]:
    """Return value and power of ten of a period in seconds, the value in one byte."""
    value, exponent = period_us, -6
    while value % 10 == 0 or value > _MOST:
        value, exponent = (value // 10 if value % 10 == 0 else round(value / 10)), exponent + 1
        if exponent == -3 and value <= _MOST:
            break
    return value, exponent
