"""The words for what is wanted of an axis: by whoever controls it, and by a user.

The law of this file: these are states of mind, not of the drive; what the drive makes of them is read from it.
"""

from __future__ import annotations

import enum

__all__ = ["Action", "Wish"]


class Wish(enum.Enum):
    """What a joint is to do with its drive."""

    OFF = "off"
    ON = "on"
    STOPPING = "stopping"


class Action(enum.Enum):
    """What a user may ask of an axis."""

    ENABLE = "enable"
    DISABLE = "disable"
    HALT = "halt"
    QUICK_STOP = "quick-stop"
    FAULT_RESET = "fault-reset"
    HOME = "home"
    MODE = "mode"
