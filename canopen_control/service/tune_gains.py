"""Gains of a tuning in a drive: where it holds them, set with what undoes them, taken back, and the words for that."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.cia402.loop_gains import GainObject, LoopGain, gain_objects, gain_places
from canopen_control.errors import ConfigError
from canopen_control.service.gain_setting import gain_values, revert_gains, set_gains
from canopen_control.service.kept_parameters import KeptParameters
from canopen_control.service.read_parameters import device_identity, entry_label
from canopen_control.service.restore import store

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from canopen_control.service.gain_setting import GainChange
    from canopen_control.service.loop_design import LoopGains
    from canopen_control.service.node_session import NodeSession

__all__ = ["GAIN_NAMES", "GainPlace", "applied", "parse_gain", "reverted", "settable_gains"]

GAIN_NAMES: Final = {gain.name.lower(): gain for gain in LoopGain}
_GAIN: Final = re.compile(r"(\w+)=0x([0-9a-f]{1,4}):([0-9a-f]{1,2})\*(.+)", re.IGNORECASE)
_OF_SHAFT: Final = (LoopGain.VELOCITY_P, LoopGain.VELOCITY_I)


def parse_gain(text: str) -> tuple[LoopGain, GainObject]:
    """Read `velocity_p=0x3210:01*0.001`; ConfigError. The scale is of the units in which a proposal is printed."""
    match = _GAIN.fullmatch(text.strip())
    if match is None or match[1].lower() not in GAIN_NAMES:
        raise ConfigError(
            f"--gain {text}: say which object holds which gain and what 1 in it is worth, as in "
            f"velocity_p=0x3210:01*0.001; the gains are {', '.join(GAIN_NAMES)}"
        )
    try:
        scale = float(match[4])
    except ValueError:
        scale = 0.0
    if not 0.0 < scale < float("inf"):
        raise ConfigError(f"--gain {text}: {match[4]!r} is no scale; give a number above 0")
    return GAIN_NAMES[match[1].lower()], GainObject(int(match[2], 16), int(match[3], 16), scale)


def settable_gains(
    session: NodeSession, axis: int, named: Iterable[str], units_per_rad: float
) -> Mapping[LoopGain, GainObject]:
    """Return where a drive holds its gains: as named, else as known of it; ConfigError where nobody can tell.

    What is named is worth what it says at the shaft, of which `units_per_rad` user units make a rad.
    """
    od = session.dictionary
    objects = gain_objects(od, axis)
    for gain, place in map(parse_gain, named):
        if (place.index, place.subindex) not in od:
            raise ConfigError(f"--gain: {session} has no 0x{place.index:04X}:{place.subindex:02X} in its EDS")
        scale = place.scale / units_per_rad if gain in _OF_SHAFT else place.scale
        objects[gain] = GainObject(place.index, place.subindex, scale)
    if missing := [gain.name.lower() for gain in _OF_SHAFT if gain not in objects]:
        if places := gain_places(od, axis):
            named_places = (
                f"--gain {gain.name.lower()}=0x{i:04X}:{sub:02X}*SCALE" for gain, (i, sub) in places.items()
            )
            held = ", ".join(f"{entry_label(od[place])} ({gain.name.lower()})" for gain, place in places.items())
            raise ConfigError(
                f"{session}: its maker holds gains in {held}; what 1 in them is worth stands in its manual alone, so "
                f"nothing is set without: {' '.join(named_places)}"
            )
        raise ConfigError(
            f"{session}: nobody knows which of its objects hold {' and '.join(missing)} "
            "or what their numbers are worth, if it has such loops (a stepper has none); leave --apply away, or name "
            "them: --gain velocity_p=0x3210:01*0.001"
        )
    return objects


@dataclass(frozen=True, slots=True)
class GainPlace:
    """Which axis, `named` objects of gains, and the `channel` of a bare bus; `stores`: in the drive too (0x1010)."""

    axis: int = 0
    named: tuple[str, ...] = ()
    channel: str = ""
    stores: bool = False


def applied(session: NodeSession, gains: LoopGains, units_per_rad: float, place: GainPlace) -> Iterator[str]:
    """Set gains; yield what changed."""
    objects = settable_gains(session, place.axis, place.named, units_per_rad)
    values = gain_values(session.dictionary, objects, gains, units_per_rad)
    yield from _told(session, set_gains(session, values, _kept(session, place)), place)


def reverted(session: NodeSession, place: GainPlace) -> Iterator[str]:
    """Take gains back; yield what changed."""
    yield from _told(session, revert_gains(session, _kept(session, place)), place)


def _kept(session: NodeSession, place: GainPlace) -> KeptParameters:
    return KeptParameters("gains", session, device_identity(session), place.channel)


def _told(session: NodeSession, changes: Iterable[GainChange], place: GainPlace) -> Iterator[str]:
    yield from map(str, changes)
    if place.stores:
        store(session)
    yield f"{session}: {'stored' if place.stores else 'not stored: a power cycle undoes it'}"
