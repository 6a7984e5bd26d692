"""Gains of a tuning, written into a drive so that they can be taken back.

What the objects held is kept before the first of them changes, and stays kept until it is taken back: gains that are
set twice still go back to those before the first time. Writing, proof and undoing of what was half taken are those of
every restore. Sans-IO: who keeps it is `KeptGains`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from canopen_control.cia402.loop_gains import LoopGain
from canopen_control.errors import ConfigError, DriveError
from canopen_control.service.parameter_diff import value_text
from canopen_control.service.read_parameters import entry_label, read_values
from canopen_control.service.restore import Restore, refuse_moving

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.cia402.loop_gains import GainObject
    from canopen_control.od.model import Address, Entry, ObjectDictionary, Value
    from canopen_control.service.loop_design import LoopGains
    from canopen_control.service.node_session import NodeSession

__all__ = ["GainChange", "KeptGains", "gain_values", "revert_gains", "set_gains"]


@dataclass(frozen=True, slots=True)
class GainChange:
    """One object before and after."""

    label: str
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.label}: {self.before} -> {self.after}"


def gain_values(
    od: ObjectDictionary, objects: Mapping[LoopGain, GainObject], gains: LoopGains, units_per_rad: float
) -> dict[Address, Value]:
    """Return what the objects are to hold; ConfigError for a gain that rounds to nothing or does not fit.

    `gains` are those of the shaft in rad, of which `units_per_rad` user units of 0x6064 make one.
    """
    wanted = {
        LoopGain.VELOCITY_P: gains.velocity_p / units_per_rad,
        LoopGain.VELOCITY_I: gains.velocity_i / units_per_rad,
        LoopGain.POSITION_P: gains.position_p,
        LoopGain.VELOCITY_FEED_FORWARD: 1.0,
    }
    return {
        (place.index, place.subindex): _raw(od[place.index, place.subindex], wanted[gain] / place.scale)
        for gain, place in objects.items()
    }


def _raw(entry: Entry, value: float) -> Value:
    if not entry.data_type.is_integer:
        return value
    number = round(value)
    low = entry.data_type.minimum if entry.low is None else entry.low
    high = entry.data_type.maximum if entry.high is None else entry.high
    if number == 0 or not low <= number <= high:
        raise ConfigError(
            f"{entry_label(entry)} would be {value:.4g}, and it holds {max(1, low)} to {high}: the gain cannot be set "
            "with this scale; take another --crossover, or check --counts"
        )
    return number


class KeptGains(Protocol):
    """What a drive held before its gains were set, outlasting this process."""

    def read(self) -> Mapping[Address, Value]:
        """Return it; nothing where no gains were set."""

    def keep(self, od: ObjectDictionary, values: Mapping[Address, Value]) -> None:
        """Keep values of a dictionary; ConfigError where that cannot be."""

    def forget(self) -> None:
        """Keep it no longer."""


def set_gains(session: NodeSession, values: Mapping[Address, Value], kept: KeptGains) -> list[GainChange]:
    """Write gains and prove them; DriveError where the drive is enabled, or refuses one: it is then as it was."""
    refuse_moving(session)
    od = session.dictionary
    held, left_out = read_values(session, [od[address] for address in values])
    if left_out:
        raise DriveError(f"{session} does not tell its gains, so they could not be taken back: {left_out[0]}")
    kept.keep(od, {**held, **kept.read()})
    _write(session, values)
    return _changes(od, held, values)


def revert_gains(session: NodeSession, kept: KeptGains) -> list[GainChange]:
    """Give a drive back the gains from before the first `set_gains`; DriveError where there were none."""
    wanted = kept.read()
    if not wanted:
        raise DriveError(f"{session}: no gains were set on this drive from here, so there is nothing to take back")
    refuse_moving(session)
    od = session.dictionary
    held, _ = read_values(session, [od[address] for address in wanted if address in od])
    _write(session, wanted)
    kept.forget()
    return _changes(od, held, wanted)


def _changes(od: ObjectDictionary, held: Mapping[Address, Value], wanted: Mapping[Address, Value]) -> list[GainChange]:
    return [
        GainChange(entry_label(od[address]), value_text(od[address], held[address]), value_text(od[address], value))
        for address, value in wanted.items()
    ]


def _write(session: NodeSession, values: Mapping[Address, Value]) -> None:
    restore = Restore(session, session.dictionary, values)
    if not restore.run():
        raise DriveError(f"{session} refused gains, and is as it was: {'; '.join(restore.refused)}")
