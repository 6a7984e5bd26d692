"""Table of the quirks (deviations of real, healthy drives from the standards), and the quirks of a node.

A quirk is written as ``NAME`` or ``NAME=VALUE``, followed by ``@AXIS`` if it applies to one axis of several.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.errors import ConfigError, nearest
from canopen_control.virtual.communication_quirks import COMMUNICATION_QUIRKS
from canopen_control.virtual.motion_quirks import MOTION_QUIRKS
from canopen_control.virtual.node_outbox import QuirkSwitched
from canopen_control.virtual.power_quirks import POWER_QUIRKS
from canopen_control.virtual.quirk_base import QuirkHooks

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from canopen_control.personality import Personality
    from canopen_control.virtual.quirk_base import Quirk
    from canopen_control.virtual.virtual_node import VirtualNode


QUIRKS: Final[dict[str, Quirk]] = {
    quirk.name: quirk for quirk in (*POWER_QUIRKS, *MOTION_QUIRKS, *COMMUNICATION_QUIRKS)
}
"""All quirks by name, in the order in which they are applied."""


@dataclass(frozen=True, slots=True)
class QuirkSetting:
    """Quirk with a strength (0 if it has none), for one axis, or for the node and all axes if `axis` is None."""

    quirk: Quirk
    value: float
    axis: int | None

    @property
    def text(self) -> str:
        """Text form of the setting, as accepted by `parse_quirk`."""
        strength = "" if self.quirk.strength is None else f"={self.value:.10g}"
        return f"{self.quirk.name}{strength}{'' if self.axis is None else f'@{self.axis}'}"

    def meets(self, other: QuirkSetting) -> bool:
        """Whether both settings apply to a common axis."""
        return self.axis is None or other.axis is None or self.axis == other.axis


def parse_quirk(text: str) -> QuirkSetting:
    """Parse ``NAME``, ``NAME=VALUE``, ``NAME@AXIS`` or ``NAME=VALUE@AXIS``; raise ConfigError if invalid."""
    head, at, place = text.partition("@")
    name, equals, number = head.partition("=")
    quirk = QUIRKS.get(name)
    if quirk is None:
        near = nearest(name, QUIRKS, listed=False)
        raise ConfigError(f"no quirk {name!r}{near}; see: canopen-control quirk list (faults: fault list)")
    axis = None
    if at:
        if quirk.axis is None:
            raise ConfigError(f"quirk {text!r}: {name} applies to the whole node; omit @{place}")
        if not place.isdecimal() or int(place) > 7:
            raise ConfigError(f"quirk {text!r}: the text after @ must be an axis number, 0 to 7")
        axis = int(place)
    return QuirkSetting(quirk, _strength(quirk, text, number if equals else None), axis)


def _strength(quirk: Quirk, text: str, number: str | None) -> float:
    strength = quirk.strength
    if strength is None:
        if number is not None:
            raise ConfigError(f"quirk {text!r}: {quirk.name} has no strength; omit ={number}")
        return 0.0
    if number is None:
        return strength.default
    try:
        value = float(int(number, 0)) if strength.whole else float(number)
    except ValueError:
        value = math.nan
    if not strength.low <= value <= strength.high:
        kind = "a whole number" if strength.whole else "a number"
        bounds = f"{strength.low:.10g} to {strength.high:.10g} {strength.unit}"
        raise ConfigError(f"quirk {text!r}: the strength must be {kind}, {bounds}")
    return value


def check_quirks(settings: Sequence[QuirkSetting]) -> None:
    """Raise ConfigError if an axis is given the same quirk twice, or two quirks that exclude each other."""
    for place, setting in enumerate(settings):
        for earlier in settings[:place]:
            if setting.quirk is earlier.quirk and setting.meets(earlier):
                raise ConfigError(
                    f"quirk {setting.text!r}: {setting.quirk.name} is given twice, also as {earlier.text!r}"
                )
            if setting.quirk.group and setting.quirk.group == earlier.quirk.group and setting.meets(earlier):
                names = f"{earlier.quirk.name} and {setting.quirk.name}"
                raise ConfigError(f"quirk {setting.text!r}: {names} exclude each other; use only one")


def quirks_of(personality: Personality) -> list[str]:
    """Return the quirks of a personality in text form; ConfigError lists every invalid line."""
    settings: list[QuirkSetting] = []
    wrong: list[str] = []
    for line in personality.quirks:
        try:
            setting = parse_quirk(line.quirk)
            check_quirks([*settings, setting])
            settings.append(setting)
        except ConfigError as error:
            wrong.append(f"{personality.place(line)}: {error}")
    if wrong:
        raise ConfigError("\n".join(wrong))
    return [setting.text for setting in settings]


class QuirkSwitches:
    """Active quirks of `node`, which can be enabled and disabled.

    Switching a quirk undoes the hooks of all quirks, and then applies the active quirks in the order of `QUIRKS`.
    """

    def __init__(self, node: VirtualNode) -> None:
        self._node, self._hooks = node, QuirkHooks(node)
        self._on: list[QuirkSetting] = []
        node.quirks = self

    @property
    def active(self) -> list[str]:
        return [setting.text for setting in self._on]

    def settings(self, name: str) -> list[str]:
        """Return the active settings of the quirk `name` in text form; several if the axes differ."""
        return [setting.text for setting in self._on if setting.quirk.name == name]

    def start_with(self, texts: Iterable[str]) -> None:
        """Enable quirks at power-on; raise ConfigError if one is invalid, impossible on the node, or excluded."""
        settings = [self._fitting(parse_quirk(text)) for text in texts]
        check_quirks(settings)
        self._hook(settings)

    def set(self, text: str, on: bool, now: int) -> None:
        """Enable or disable a quirk, on all axes unless `text` names one; a new strength replaces the old one."""
        setting = self._fitting(parse_quirk(text))
        remaining = [
            setting_on
            for setting_on in self._on
            if setting_on.quirk is not setting.quirk or not setting_on.meets(setting)
        ]
        settings = [*remaining, setting] if on else remaining
        check_quirks(settings)
        self._node.advance_drives(now)
        self._hook(settings)
        self._node.outbox.publish(QuirkSwitched(setting.text, on))
        self._node.outbox.values_changed()
        self._node.send_changes(now)

    def _fitting(self, setting: QuirkSetting) -> QuirkSetting:
        """Return `setting`; raise ConfigError if the quirk needs a drive or an axis that the node lacks."""
        axes = self._node.drives
        if setting.quirk.axis is not None and not axes:
            raise ConfigError(
                f"quirk {setting.text!r} is only for drives; node {self._node.node_id} is {self._node.name}"
            )
        if setting.axis is not None and setting.axis not in axes:
            problem = f"node {self._node.node_id} has no axis {setting.axis}; it has: {', '.join(map(str, axes))}"
            raise ConfigError(f"quirk {setting.text!r}: {problem}")
        return setting

    def _hook(self, settings: Iterable[QuirkSetting]) -> None:
        hooks, node = self._hooks, self._node
        hooks.undo()
        order = list(QUIRKS)
        self._on = sorted(settings, key=lambda setting: (order.index(setting.quirk.name), setting.axis or 0))
        for setting in self._on:
            if setting.quirk.node is not None:
                setting.quirk.node(hooks, setting.value)
            for axis, drive in node.drives.items():
                if setting.quirk.axis is not None and setting.axis in (None, axis):
                    setting.quirk.axis(hooks, drive, setting.value)
        node.pdos.rules_changed()
        if node.fault_switches is not None:
            node.fault_switches.set_quirks(tuple(hooks.outgoing), tuple(hooks.incoming))


def switches_of(node: VirtualNode) -> QuirkSwitches:
    """Return the quirk switches of a node; the first call creates them."""
    return node.quirks if isinstance(node.quirks, QuirkSwitches) else QuirkSwitches(node)
