"""Homing (CiA 402-2, 11): methods 1 to 14, 17 to 30, 33 to 35 and 37 on simulated switches and index pulses.

A method is a row of `METHODS`: which switch edge it seeks, from which side the last, slow pass crosses it, and whether
the next index pulse beyond it is home instead. The way there is a list of legs, each a run through a place: fast until
the edge is crossed, then slow, back and forth until the last pass has the right direction. A leg without a switch in
its way ends at a limit switch and turns round there. The bits 13, 12 and 10 are those of the table: 000 running, 001
interrupted, 010 attained and still moving, 011 done, 101 error.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

from canopen_control.cia402 import objects as o
from canopen_control.cia402.options import Reaction
from canopen_control.virtual.fault_seam import Seam
from canopen_control.virtual.mode_base import BIT_12, BIT_13, NEW_SET_POINT, REACHED, Mode
from canopen_control.virtual.trajectory import ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.mode_base import Axis

__all__ = ["METHODS", "Homing", "Method"]

_IN_PLACE = (35, 37)
_LIMITS = ("negative", "positive")  # the edges that are limit switches
FAST, SLOW = 1, 2  # subindices of 0x6099


class Method(NamedTuple):
    """`edge`: a field of `Switches`, empty: none is sought. `direction` of the last pass. `pulse`: seek the index."""

    edge: str
    direction: int
    pulse: bool = False


_EDGES: dict[int, Method] = {
    17: Method("negative", 1),
    18: Method("positive", -1),
    # a home switch that stays active towards the positive (19, 20) or negative (21, 22) end
    19: Method("home_low", -1),
    20: Method("home_low", 1),
    21: Method("home_high", 1),
    22: Method("home_high", -1),
    # a home switch with two edges; 23 to 26 begin in the positive direction, 27 to 30 in the negative one
    23: Method("home_low", -1),
    24: Method("home_low", 1),
    25: Method("home_high", -1),
    26: Method("home_high", 1),
    27: Method("home_high", 1),
    28: Method("home_high", -1),
    29: Method("home_low", 1),
    30: Method("home_low", -1),
}
METHODS: dict[int, Method] = {
    **_EDGES,
    **{number - 16: method._replace(pulse=True) for number, method in _EDGES.items()},
    33: Method("", -1, pulse=True),
    34: Method("", 1, pulse=True),
    35: Method("", 0),
    37: Method("", 0),
}


class _Leg(NamedTuple):
    place: float
    direction: int
    speed: int  # FAST or SLOW


class Homing(Mode):
    """HM of one axis: bit 4 of the controlword starts it, and interrupts it by falling. Seam: `fails`."""

    def __init__(self, axis: Axis) -> None:
        super().__init__(axis)
        self.fails: Seam[bool] = Seam(False)

    def reset(self) -> None:
        """Forget the run; what it found stays in the drive."""
        self._legs: list[_Leg] = []
        self._running = False
        self._attained = False
        self._error = False
        self._home = 0.0

    def start(self, now: int) -> None:
        """Stand until bit 4 rises; after a halt go on with the leg that was interrupted."""
        if self._running and self._legs and self.power.live:
            self._run(now)
        else:
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def control(self, word: int, previous: int, now: int) -> None:
        """Start and interrupt."""
        if word & ~previous & NEW_SET_POINT:
            self._begin(now)
        elif previous & ~word & NEW_SET_POINT and self._running:
            self.reset()
            self._leave_switches()
            self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def bits(self) -> int:
        """Return bits 13, 12 and 10 of the table."""
        still = 0 if self._running and not self._attained else (REACHED if self.mover.standing else 0)
        return still | (BIT_12 if self._attained else 0) | (BIT_13 if self._error else 0)

    def deceleration(self) -> float:
        """Return 0x609A."""
        return self.objects.ramp(o.HOMING_ACCELERATION)

    def can_halt(self) -> bool:
        """Whether the device supports halt in this mode."""
        return self.model.homing_halts

    def control_unpowered(self, word: int, previous: int, now: int) -> None:
        """Take the present position for home, which needs no motion, where the device does that without power."""
        number = self.objects.number(o.HOMING_METHOD)
        if word & ~previous & NEW_SET_POINT and self.model.homes_without_power and number in _IN_PLACE:
            self._begin(now)

    def unpowered_bits(self) -> int:
        """Return bit 12 after a homing without power."""
        return BIT_12 if self._attained and self.model.homes_without_power else 0

    def _begin(self, now: int) -> None:
        self.reset()
        number = self.objects.number(o.HOMING_METHOD)
        allowed = self.model.homing_methods
        method = METHODS.get(number)
        unknown = (allowed is not None and number not in allowed) or (method is None and number != 0)
        if unknown or self.fails.value:
            self._fail(now)
        elif method is None:  # 0: nothing is sought, and nothing moves
            self._attained = True
        elif not method.edge and not method.pulse:
            self._found(self.mover.plant.position)
        elif not (self.objects.number(o.HOMING_SPEEDS, FAST) and self.objects.number(o.HOMING_SPEEDS, SLOW)):
            self._fail(now)
        else:
            self._plan(method, now)
        self.outbox.values_changed()

    def _plan(self, method: Method, now: int) -> None:
        switches, position = self.mover.switches, self.mover.plant.position
        switches.homing = True
        self._home = position
        if method.edge:
            self._home = float(getattr(switches, method.edge))
            self._legs = _legs_to(position, self._home, method.direction, is_limit=method.edge in _LIMITS)
        if method.pulse:
            period = switches.index_period
            count = math.floor(self._home / period) + 1 if method.direction > 0 else math.ceil(self._home / period) - 1
            self._home = count * period
            self._legs.append(_Leg(self._home, method.direction, SLOW))
        self._running = True
        self._run(now)

    def _run(self, now: int) -> None:
        """Run through the place of the first leg."""
        leg = self._legs[0]
        position, velocity = self.mover.state(now)
        speed = self.objects.speed(o.HOMING_SPEEDS, leg.speed) * leg.direction
        acceleration = self.objects.ramp(o.HOMING_ACCELERATION)
        demand = ramp_to(now, position, velocity, speed, acceleration, acceleration)
        self.mover.run(demand, now)
        if velocity * leg.direction < 0.0:  # the turn may swing across the place first
            after = now + int(abs(velocity) / acceleration * 1e9) if acceleration > 0.0 else now
        else:
            after = now
        due = demand.time_of(leg.place, after)
        if due is None:
            self._fail(now)
        else:
            self.mover.at("homing", due, lambda then: self._crossed(then))

    def _crossed(self, now: int) -> None:
        if not self._running or not self.power.live:
            return
        self._legs.pop(0)
        if self._legs:
            self._run(now)
        else:
            self._found(self._home if self.mover.plant.stiff else self.mover.plant.position)
            self.stop(now, Reaction.SLOW_DOWN_RAMP)
        self.outbox.values_changed()

    def _found(self, home: float) -> None:
        self.units.zero = home - self.objects.number(o.HOME_OFFSET) * self.units.position
        self._attained, self._running = True, False
        self._leave_switches()

    def _fail(self, now: int) -> None:
        self.reset()
        self._error = True
        self._leave_switches()
        self.stop(now, Reaction.SLOW_DOWN_RAMP)

    def _leave_switches(self) -> None:
        self.mover.cancel("homing")
        self.mover.switches.homing = False


def _legs_to(position: float, edge: float, direction: int, *, is_limit: bool) -> list[_Leg]:
    """Return the passes over an edge: fast towards it, then slow until one has `direction`.

    A motor that stands exactly on the edge leaves it first. Beyond a limit switch nothing is fast.
    """
    towards = 1 if edge > position else -1
    if edge == position:
        towards = -direction
    legs = [_Leg(edge, towards, SLOW if is_limit and towards == direction else FAST)]
    if towards == direction and legs[0].speed == FAST:
        legs.append(_Leg(edge, -direction, SLOW))
    if legs[-1].direction != direction or legs[-1].speed == FAST:
        legs.append(_Leg(edge, direction, SLOW))
    return legs
