"""Edits of single objects by a person: what may be written, within which limits, and how it is undone.

An edit reads what is there, writes, and reads back. What would move an axis is refused: a target written so has nobody
who holds a button for it, and nothing that ends it. Undone is only what still holds what was written.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.objects import MOTION, axis_of
from canopen_control.errors import ConfigError, DriveError
from canopen_control.od.codec import decode
from canopen_control.od.model import DataType
from canopen_control.service.object_rows import parse_value
from canopen_control.service.parameter_set import entry_label, same_value, value_text

if TYPE_CHECKING:
    from canopen_control.od.model import Entry, Value
    from canopen_control.service.node_session import NodeSession


_PROGRAM: Final = range(0x1F50, 0x1F58)
_MOST_EDITS: Final = 100


def why_fixed(entry: Entry) -> str:
    """Return why nobody writes an object by hand, "" where one may."""
    if not entry.writable:
        return f"is {'constant' if entry.access == 'const' else 'read-only'}"
    if axis_of(entry.index)[0] in MOTION:
        return "moves the axis: use the buttons that are held, which end it when they are let go"
    if entry.index in _PROGRAM:
        return "is the drive's program: use Firmware"
    return "is a DOMAIN: bytes of any length" if entry.data_type is DataType.DOMAIN else ""


def limits_of(entry: Entry) -> tuple[int | float | None, int | float | None]:
    """Return the least and the greatest value, by the EDS and else by the type; None where there is none."""
    whole = entry.data_type.is_integer
    low = entry.low if entry.low is not None else entry.data_type.minimum if whole else None
    high = entry.high if entry.high is not None else entry.data_type.maximum if whole else None
    return low, high


def limit_words(entry: Entry) -> str:
    """Return the limits as people read them, "" where there are none."""
    low, high = limits_of(entry)
    if low is not None and high is not None:
        return f"{low} to {high}"
    return f"{low} at least" if low is not None else f"{high} at most" if high is not None else ""


def parsed_value(entry: Entry, text: str) -> Value:
    """Return the value of a text; ConfigError for an object that is fixed, and for what is beyond its limits."""
    name = entry_label(entry)
    if why := why_fixed(entry):
        raise ConfigError(f"{name} {why}; nothing was written")
    try:
        value = decode(parse_value(text.strip(), entry.data_type), entry.data_type)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}; nothing was written") from None
    low, high = limits_of(entry)
    if isinstance(value, int | float) and not ((low is None or value >= low) and (high is None or value <= high)):
        raise ConfigError(f"{name} takes {limit_words(entry)} by its EDS, and not {value}; nothing was written")
    return value


@dataclass(frozen=True, slots=True)
class Edit:
    """One write: what was `before` (None: it cannot be read), and what the node held after."""

    entry: Entry
    before: Value | None
    after: Value

    @property
    def words(self) -> str:
        """What it changed."""
        before = "" if self.before is None else f"{value_text(self.entry, self.before)} -> "
        return f"{entry_label(self.entry)}: {before}{value_text(self.entry, self.after)}"


@dataclass(slots=True)
class EditHistory:
    """The edits of one node, the newest last."""

    edits: list[Edit] = field(default_factory=list)

    def write(self, session: NodeSession, entry: Entry, text: str) -> Edit:
        """Write a value and read it back; DriveError where the node has made another one of it."""
        value = parsed_value(entry, text)
        before = session.read_value(entry) if entry.readable else None
        session.write_value(entry, value)
        edit = Edit(entry, before, session.read_value(entry) if entry.readable else value)
        self.edits = [*self.edits[1 - _MOST_EDITS :], edit]
        if not same_value(entry, value, edit.after):
            has = value_text(entry, edit.after)
            raise DriveError(f"{entry_label(entry)}: asked {value_text(entry, value)}, the drive has {has}")
        return edit

    @property
    def last(self) -> Edit | None:
        """The newest edit that can be undone."""
        return next((each for each in reversed(self.edits) if each.before is not None), None)

    def undo(self, session: NodeSession) -> Edit:
        """Write back what the newest edit has changed; DriveError where it holds something else meanwhile."""
        edit = self.last
        if edit is None or edit.before is None:
            raise ConfigError(f"{session}: nothing was written here that could be undone")
        entry, held = edit.entry, session.read_value(edit.entry)
        if not same_value(entry, held, edit.after):
            self.edits.remove(edit)
            raise DriveError(
                f"{entry_label(entry)} holds {value_text(entry, held)} and not {value_text(entry, edit.after)} any "
                "more: somebody else has written it since; nothing was written"
            )
        session.write_value(entry, edit.before)
        self.edits.remove(edit)
        return Edit(entry, edit.after, session.read_value(entry))
