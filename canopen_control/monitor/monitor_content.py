"""Content of the monitor as plain data: cells with a level, tables of cells, and log lines.

A symbol before the text also shows the level, so that it can be read without colours. No terminal,
no socket, no clock.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.rpc.messages.health import AXIS_STATES
from canopen_control.rpc.quick_verbs import state_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.rpc.messages.health import StateWords


# the most important columns are first, as a terminal of 80 columns shows only some
DRIVE_COLUMNS: Final = ("drive", "NMT", "CiA 402", "error", "last frame", "mode", "SDO", "statusword")
JOINT_COLUMNS: Final = ("joint", "command", "velocity", "position", "effort")


class Tone(enum.Enum):
    """Level of a status; the value is the symbol shown before the text."""

    PLAIN = ""
    GOOD = "●"
    IDLE = "○"
    WARN = "▲"
    BAD = "✖"


class Cell(NamedTuple):
    """Text of a table cell, with its level."""

    text: str
    tone: Tone = Tone.PLAIN

    def __str__(self) -> str:
        return f"{self.tone.value} {self.text}" if self.tone.value and self.text else self.text


@dataclass(frozen=True, slots=True)
class LogLine:
    """Line of a log, with a level; `time` is in Unix seconds."""

    time: float
    text: str
    tone: Tone = Tone.PLAIN


@dataclass(frozen=True, slots=True)
class MonitorContent:
    """Content of the screen: tables by row name, `facts` for the header, and `alarm`, the main problem or ""."""

    title: str
    state: Cell
    alarm: str = ""
    facts: tuple[str, ...] = ()
    drives: Mapping[str, tuple[Cell, ...]] = field(default_factory=dict)
    joints: Mapping[str, tuple[Cell, ...]] = field(default_factory=dict)


def tone_of(words: StateWords | None) -> Tone:
    """Return the level of a state, or IDLE if the state is unknown."""
    return Tone.IDLE if words is None else Tone[words.tone.upper()]


def state_cell(state: str | None) -> Cell:
    """Return a cell with the name of a CiA 402 state as in the standard, or "-" if unknown."""
    return plain("-") if state is None else Cell(state_name(state), tone_of(AXIS_STATES[state]))


def age_cell(seconds: float | None, *, stale: float, dead: float) -> Cell:
    """Return a cell with the age in s of a node's last frame; a warning from `stale` on, an error from `dead` on."""
    if seconds is None:
        return Cell("never", Tone.BAD)
    text = f"{1e3 * seconds:.0f} ms" if seconds < 1 else f"{seconds:.1f} s"
    if seconds >= dead:
        return Cell(f"{text}, dead", Tone.BAD)
    return Cell(f"{text}, stale", Tone.WARN) if seconds >= stale else Cell(text)


def sdo_cell(reads: int, writes: int, failed: int) -> Cell:
    """Return a cell with the numbers of SDO reads, writes and failures."""
    text = f"{reads}r {writes}w"
    return Cell(f"{text}, {failed} failed", Tone.WARN) if failed else Cell(text)


def plain(text: str) -> Cell:
    """Return a cell with a neutral level."""
    return Cell(text)
