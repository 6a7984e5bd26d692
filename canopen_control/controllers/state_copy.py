"""A copy of chosen states as of one moment: the layout of everything that a broadcaster tells."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.hardware.interfaces import StateInterface
    from canopen_control.rpc.messages.samples import Values

__all__ = ["StateCopy", "finite"]


def finite(value: float) -> float | None:
    """Return a value, None for one that is not known."""
    return value if math.isfinite(value) else None


class StateCopy:
    """The values of states by joint and name, each as it was at the last `take`.

    `layout` says by joint and name where a value is read, None for a constant 0.0.
    """

    def __init__(self, layout: Mapping[str, Mapping[str, StateInterface | None]]) -> None:
        places = [(joint, name, source) for joint, names in layout.items() for name, source in names.items()]
        self._places = [(joint, name) for joint, name, _ in places]
        self._values = [0.0] * len(places)
        self._sources = [(index, source) for index, (_, _, source) in enumerate(places) if source is not None]
        self._joints = list(layout)
        self.take()

    @property
    def joints(self) -> list[str]:
        """Its joints in order."""
        return list(self._joints)

    def take(self) -> None:
        """Copy what the states are now; nothing is allocated."""
        values = self._values
        for index, source in self._sources:
            values[index] = source.value

    def by_joint(self) -> dict[str, Values]:
        """Return the copy; None is what is not known."""
        found: dict[str, Values] = {joint: {} for joint in self._joints}
        for (joint, name), value in zip(self._places, self._values, strict=True):
            found[joint][name] = finite(value)
        return found
