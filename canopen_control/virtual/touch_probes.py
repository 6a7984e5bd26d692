"""The two touch probes of an axis: positions caught at an edge (CiA 402-2, 9.3.4).

0x60B8 arms them, 0x60B9 shows what was caught, 0x60BA to 0x60BD hold the positions. The probe inputs are bits 16 and 17
of 0x60FD; a probe may look at the index pulse of the encoder instead, which has rising edges only. A single probe
catches once until it is armed anew, a continuous one every time.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects as o

if TYPE_CHECKING:
    from canopen_control.virtual.axis_objects import AxisObjects
    from canopen_control.virtual.mover import Mover
    from canopen_control.virtual.node_outbox import NodeOutbox
    from canopen_control.virtual.trajectory import Trajectory

__all__ = ["TouchProbes"]

_ENABLE, _CONTINUOUS, _INDEX, _RISING, _FALLING = 1 << 0, 1 << 1, 1 << 2, 1 << 4, 1 << 5
_CAUGHT_RISING, _CAUGHT_FALLING = 1 << 1, 1 << 2
_SHIFTS = (0, 8)  # of probe 1 and 2 in 0x60B8 and 0x60B9
_FIRST_INPUT = 16
_POSITIONS = (
    (o.TOUCH_PROBE_1_POSITIVE, o.TOUCH_PROBE_1_NEGATIVE),
    (o.TOUCH_PROBE_2_POSITIVE, o.TOUCH_PROBE_2_NEGATIVE),
)


class TouchProbes:
    """The probes of one axis."""

    def __init__(self, objects: AxisObjects, mover: Mover, outbox: NodeOutbox) -> None:
        self._objects, self._mover, self._outbox = objects, mover, outbox
        self._armed = 0

    def reset(self) -> None:
        """Forget everything: power-on."""
        self._armed = 0

    def update(self, now: int) -> None:
        """Take 0x60B8: what is switched on now is armed, what is switched off forgets what it caught."""
        function = self._objects.number(o.TOUCH_PROBE_FUNCTION)
        if function == self._armed:
            return
        status = self._objects.number(o.TOUCH_PROBE_STATUS)
        for shift in _SHIFTS:
            before, after = self._armed >> shift & 0xFF, function >> shift & 0xFF
            if before != after:
                status = status & ~(0xFF << shift) | ((after & _ENABLE) << shift)
        self._armed = function
        self._show(status)
        self._mover.watch_index(now)

    def inputs_changed(self, before: int, after: int) -> None:
        """Look at the edges of the probe inputs."""
        position = self._mover.plant.position
        for probe, shift in enumerate(_SHIFTS):
            bit = 1 << _FIRST_INPUT + probe
            if (before ^ after) & bit and not self._armed >> shift & _INDEX:
                self._catch(probe, position, rising=bool(after & bit))

    def index_passed(self, place: float) -> None:
        """Look at an index pulse, at `place` in plant counts."""
        for probe, shift in enumerate(_SHIFTS):
            if self._armed >> shift & _INDEX:
                self._catch(probe, place, rising=True)

    @property
    def wants_index(self) -> bool:
        """Whether a probe waits for an index pulse."""
        return any(self._armed >> shift & (_ENABLE | _INDEX) == _ENABLE | _INDEX for shift in _SHIFTS)

    def next_index(self, demand: Trajectory, now: int) -> tuple[int, float] | None:
        """Return when `demand` passes the next index pulse, and where; None: it does not, or nobody waits for it."""
        if not self.wants_index:
            return None
        position = demand.at(now)[0]
        period = self._mover.switches.index_period
        ahead = (math.floor(position / period) + 1) * period
        behind = (math.ceil(position / period) - 1) * period
        found = [(due, place) for place in (ahead, behind) if (due := demand.time_of(place, now)) is not None]
        return min(found, default=None)

    def _catch(self, probe: int, place: float, *, rising: bool) -> None:
        shift = _SHIFTS[probe]
        function, status = self._armed >> shift, self._objects.number(o.TOUCH_PROBE_STATUS)
        wanted, caught = (_RISING, _CAUGHT_RISING) if rising else (_FALLING, _CAUGHT_FALLING)
        if not function & _ENABLE or not function & wanted:
            return
        if status >> shift & caught and not function & _CONTINUOUS:
            return
        index = _POSITIONS[probe][0 if rising else 1]
        self._objects.set(index, self._objects.units.user(place))
        self._show(status | caught << shift)

    def _show(self, status: int) -> None:
        self._objects.set(o.TOUCH_PROBE_STATUS, status)
        self._outbox.values_changed()
