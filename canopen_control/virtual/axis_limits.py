"""What bounds the motion of an axis: software limits, limit switches, velocities, torques, the following error.

A limit is reported once, when the motion ends at it (bit 11, and an EMCY where the device has one for it), and
forgotten with the next demand that leads away. The software limits 0x607D count when the lower one is the lower one; a
pair at the ends of its type is no limit.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from canopen_control.cia301.emcy_codes import ErrorRegister
from canopen_control.cia402 import objects as o
from canopen_control.cia402.state import State
from canopen_control.virtual.trajectory import INFINITE, move_to, ramp_to

if TYPE_CHECKING:
    from canopen_control.virtual.axis_objects import AxisObjects
    from canopen_control.virtual.device_model import Limit
    from canopen_control.virtual.mover import Mover
    from canopen_control.virtual.node_outbox import NodeOutbox
    from canopen_control.virtual.power_machine import PowerMachine

__all__ = ["AxisLimits"]

_MS = 1_000_000
_LOWEST, _HIGHEST = -0x7FFFFFFF, 0x7FFFFFFF
FOLLOWING_ERROR = 0x8611


class AxisLimits:
    """The limits of one axis; `active` is bit 11 of its statusword."""

    def __init__(self, objects: AxisObjects, mover: Mover, outbox: NodeOutbox, power: PowerMachine) -> None:
        self._objects, self._mover, self._outbox, self._power = objects, mover, outbox, power
        self.active = False
        self.following_error = 0.0
        self._bound: float | None = None  # where the present demand ends because of a limit
        self._side = 0

    def reset(self) -> None:
        """Forget what was hit: the power is off."""
        self.active = False
        self.following_error = 0.0
        self._bound = None

    def bounds(self) -> tuple[float, float]:
        """Return how far the axis may go, in plant counts; infinite where nothing stops it."""
        objects, mover = self._objects, self._mover
        low, high = objects.number(o.SOFTWARE_POSITION_LIMIT, 1), objects.number(o.SOFTWARE_POSITION_LIMIT, 2)
        lowest, highest = -INFINITE, INFINITE
        if low < high:
            unit, zero = objects.units.position, objects.units.zero
            lowest = low * unit + zero if low > _LOWEST else math.copysign(INFINITE, -unit)
            highest = high * unit + zero if high < _HIGHEST else math.copysign(INFINITE, unit)
            lowest, highest = min(lowest, highest), max(lowest, highest)
        if mover.switches.wired and not objects.model.switches_disabled(objects.store):
            switch_low, switch_high = mover.switches.bounds(mover.plant.position)
            lowest, highest = max(lowest, switch_low), min(highest, switch_high)
        return lowest, highest

    def velocity(self, target: float) -> float:
        """Return `target` within 0x607F and what the drive can do."""
        most = min(self._objects.speed(o.MAX_PROFILE_VELOCITY) or INFINITE, self._objects.model.max_velocity)
        return max(-most, min(most, target))

    def target_velocity(self) -> float:
        """Return 0x60FF plus 0x60B1 in counts/s, within these limits."""
        number = self._objects.number
        return self.velocity((number(o.TARGET_VELOCITY) + number(o.VELOCITY_OFFSET)) * self._objects.units.velocity)

    def position(self, target: float) -> float:
        """Return `target`, in plant counts, within the bounds; outside them bit 11 is set."""
        low, high = self.bounds()
        within = max(low, min(high, target))
        self.active, self._bound = within != target, None
        if within != target:
            self._bound, self._side = within, 1 if target > within else -1
        return within

    def torque(self, target: float) -> float:
        """Return `target` within 0x6072, 0x60E0 and 0x60E1, in per mille."""
        number = self._objects.number
        most = float(number(o.MAX_TORQUE)) or INFINITE
        high = min(most, float(number(o.POSITIVE_TORQUE_LIMIT)) or INFINITE)
        low = min(most, float(number(o.NEGATIVE_TORQUE_LIMIT)) or INFINITE)
        self.active = not -low <= target <= high
        return max(-low, min(high, target))

    def lead(self, target: float, up: float, down: float, now: int) -> None:
        """Bring the velocity to `target` along ramps; a bound ahead ends the motion there."""
        mover = self._mover
        position, velocity = mover.state(now)
        low, high = self.bounds()
        bound = high if target > 0.0 else low
        self.active, self._bound = False, None
        if target == 0.0 or abs(bound) == INFINITE:
            mover.run(ramp_to(now, position, velocity, target, up, down), now)
            return
        self._bound, self._side = bound, 1 if target > 0.0 else -1
        if (bound - position) * target > 0.0:
            mover.run(move_to(now, position, velocity, bound, abs(target), up, down), now)
        else:
            self.active = True
            mover.run(ramp_to(now, position, velocity, 0.0, up, down), now)

    def arrived(self, now: int) -> None:
        """Report the bound at which a demand ended."""
        demand = self._mover.demand
        if self._bound is not None and demand.end_ns <= now and demand.final_position == self._bound:
            self.active = True
            self._report(self._objects.model.software_limit, self._side)

    def limit_switch_hit(self, side: int) -> None:
        """Report a limit switch."""
        self.active = True
        self._report(self._objects.model.switch_limit, side)

    def _report(self, limit: Limit | None, side: int) -> None:
        if limit is not None:
            data = limit.positive if side > 0 else limit.negative
            self._outbox.report(limit.code, ErrorRegister.MANUFACTURER, data)

    # -- following error

    def judge_following_error(self, error: float, now: int) -> None:
        """Note a following error; outside its window (0x6065) for its time (0x6066) it is fault 0x8611."""
        self.following_error = error
        mover = self._mover
        if not self.exceeded:
            mover.cancel("following error")
        elif "following error" not in mover.timers and self._power.state is State.OPERATION_ENABLED:
            wait = self._objects.number(o.FOLLOWING_ERROR_TIMEOUT) * _MS
            mover.at("following error", now + wait, self._failed)

    @property
    def exceeded(self) -> bool:
        """Whether the following error is outside its window; a window of 0 or 0xFFFFFFFF is none."""
        window = self._objects.number(o.FOLLOWING_ERROR_WINDOW)
        return 0 < window < 0xFFFFFFFF and abs(self.following_error) > window * self._objects.units.length

    def _failed(self, now: int) -> None:
        if self._power.state is State.OPERATION_ENABLED and self.exceeded:
            self._power.fault(FOLLOWING_ERROR, now, register=ErrorRegister.DEVICE_PROFILE)
