"""The commands of the peers in each cycle, chosen so that a listener can check the values on the wire."""

from __future__ import annotations

CONTROLWORDS = (0x00, 0x80, 0x06, 0x07, 0x0F)  # fault reset, shutdown, switch on, enable operation: CiA 402
MODE = 3  # profile velocity
RAMPS = ((0x6081, 100_000), (0x6083, 1_000_000), (0x6084, 1_000_000), (0x6085, 1_000_000))
STEPS = 60  # cycles of enabling: ten with each controlword
_SPAN = 1000


def controlword(step: int) -> int:
    """Return the controlword that enables a drive, step by step."""
    return CONTROLWORDS[min(step // 10, len(CONTROLWORDS) - 1)]


def target(cycle: int, position: int) -> int:
    """Return the target velocity of the drive at `position` in a cycle, in device units: never the same twice."""
    return (cycle % _SPAN) * 2 - _SPAN + position
