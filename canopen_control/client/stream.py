"""How often to ask for the state, so that every publication of a controller is in it: for ROS and for bags."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.rpc.messages.robot import STREAM_RATE

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.rpc.messages.state import ControllerReading, CycleTimes

__all__ = ["outpaced", "stream_rate"]

_NEARLY = 1e-6


def stream_rate(cycle: CycleTimes, wanted: float = 0.0) -> float:
    """Return the rate in Hz that a subscription gets: what is wanted, 0 for every cycle and at most STREAM_RATE.

    A sample comes after a whole number of cycles.
    """
    hz = 1.0 / cycle.period_s if cycle.period_s > 0.0 else STREAM_RATE
    every = round(hz / wanted) if wanted else math.ceil(hz / STREAM_RATE - _NEARLY)
    return hz / max(1, every)


def outpaced(controllers: Iterable[ControllerReading], rate: float) -> str | None:
    """Say which controllers publish more often than the state is asked for; None if every publication comes."""
    fast = [each for each in controllers if each.publish_rate > rate * (1.0 + _NEARLY)]
    names = ", ".join(f"{each.name} ({each.publish_rate:g} Hz)" for each in fast)
    return (
        f"{names}: published more often than the state comes, {rate:g} Hz; what is between is left out"
        if fast
        else None
    )
