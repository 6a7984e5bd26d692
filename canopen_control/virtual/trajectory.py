"""Motion as a function of time: trajectories of pieces with constant acceleration.

A trajectory is created once, at an event, and evaluated in closed form at any later time. There is no tick, so the
result does not depend on how often it is read, and the position is the exact integral of the velocity. Positions are
in counts, velocities in counts/s, accelerations in counts/s^2; all are floats, whose error at the ends of a 32-bit
range is below a millionth of a count. Times are monotonic nanoseconds.

An acceleration of 0 starts no motion, an infinite acceleration is a step. A deceleration of 0 stops at once.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator


INFINITE = math.inf
_NS = 1e-9


class Piece(NamedTuple):
    """Part of a motion with constant acceleration: duration, initial velocity and acceleration."""

    seconds: float
    velocity: float
    acceleration: float

    def distance(self, seconds: float) -> float:
        """Return the distance in the first `seconds` of the piece."""
        return (self.velocity + 0.5 * self.acceleration * seconds) * seconds


class DemandCurve:
    """Motion over time: pieces of constant acceleration from `start_ns` on, then `final_velocity` forever.

    `final_position` is the position at the end of the pieces. A known exact value (a target) can be given, so that
    rounding in the pieces has no effect.
    """

    __slots__ = ("_pieces", "end_ns", "final_position", "final_velocity", "position", "start_ns")

    def __init__(
        self,
        start_ns: int,
        position: float,
        pieces: tuple[Piece, ...],
        final_velocity: float,
        final_position: float | None = None,
    ) -> None:
        self.start_ns, self.position, self.final_velocity = start_ns, position, final_velocity
        self._pieces = pieces
        seconds = sum(piece.seconds for piece in pieces)
        self.end_ns = start_ns + math.ceil(seconds / _NS)
        distance = sum(piece.distance(piece.seconds) for piece in pieces)
        self.final_position = position + distance if final_position is None else final_position

    def shifted(self, distance: float) -> DemandCurve:
        """Return the same curve shifted by `distance`."""
        position, final = self.position + distance, self.final_position + distance
        return DemandCurve(self.start_ns, position, self._pieces, self.final_velocity, final)

    def at(self, now: int) -> tuple[float, float]:
        """Return the position and velocity at `now`, which must not be before the start."""
        if now >= self.end_ns:
            beyond = (now - self.end_ns) * _NS
            return self.final_position + self.final_velocity * beyond, self.final_velocity
        seconds, position = (now - self.start_ns) * _NS, self.position
        for piece in self._pieces:
            if seconds <= piece.seconds:
                return position + piece.distance(seconds), piece.velocity + piece.acceleration * seconds
            seconds -= piece.seconds
            position += piece.distance(piece.seconds)
        return self.final_position, self.final_velocity

    def steady_until(self, now: int) -> int | None:
        """Return the time until which the velocity is constant: `now` while it changes, None if forever."""
        if now >= self.end_ns:
            return None
        seconds = (now - self.start_ns) * _NS
        for piece in self._pieces:
            if seconds < piece.seconds:
                return now if piece.acceleration else now + int((piece.seconds - seconds) / _NS)
            seconds -= piece.seconds
        return now

    def acceleration_at(self, now: int) -> float:
        """Return the acceleration just after `now`, or 0 after the last piece."""
        for piece in self.slices(now, now + 1):
            return piece.acceleration
        return 0.0

    def slices(self, start_ns: int, end_ns: int) -> Iterator[Piece]:
        """Yield the pieces between two times, cut to fit, including the unlimited motion after the last piece."""
        begin, end = (start_ns - self.start_ns) * _NS, (end_ns - self.start_ns) * _NS
        for piece in self._pieces:
            first, last = max(begin, 0.0), min(end, piece.seconds)
            if last > first:
                yield Piece(last - first, piece.velocity + piece.acceleration * first, piece.acceleration)
            begin -= piece.seconds
            end -= piece.seconds
        if end > max(begin, 0.0):
            yield Piece(end - max(begin, 0.0), self.final_velocity, 0.0)

    def time_of(self, position: float, after_ns: int) -> int | None:
        """Return the first time from `after_ns` on at which the curve is at or crosses `position`, or None if never."""
        here, clock = self.at(after_ns)[0], after_ns
        for piece in self.slices(after_ns, max(self.end_ns, after_ns)):
            seconds = _first_crossing(piece, position - here)
            if seconds is not None:
                return clock + math.ceil(seconds / _NS)
            here += piece.distance(piece.seconds)
            clock += math.ceil(piece.seconds / _NS)
        if here == position:
            return clock
        if self.final_velocity == 0.0 or (position - here) / self.final_velocity < 0.0:
            return None
        return clock + math.ceil((position - here) / self.final_velocity / _NS)


def _first_crossing(piece: Piece, distance: float) -> float | None:
    """Return the time in s at which a piece first covers `distance`, or None if never."""
    if piece.acceleration == 0.0:
        roots = [distance / piece.velocity] if piece.velocity else []
    else:
        square = piece.velocity * piece.velocity + 2.0 * piece.acceleration * distance
        if square < 0.0:
            return None
        root = math.sqrt(square)
        roots = [(-piece.velocity + root) / piece.acceleration, (-piece.velocity - root) / piece.acceleration]
    inside = [seconds for seconds in roots if 0.0 <= seconds <= piece.seconds]
    return min(inside, default=None)


def hold(now: int, position: float) -> DemandCurve:
    """Return a curve that stays at `position`."""
    return DemandCurve(now, position, (), 0.0, position)


def cruise(now: int, position: float, velocity: float) -> DemandCurve:
    """Return a curve that continues from `position` at `velocity`."""
    return DemandCurve(now, position, (), velocity, position)


def ramp_to(
    now: int, position: float, velocity: float, target: float, acceleration: float, deceleration: float
) -> DemandCurve:
    """Return a curve that changes the velocity to `target` along ramps; a reversal passes through standstill."""
    pieces: list[Piece] = []
    if velocity and (velocity * target < 0.0 or abs(target) < abs(velocity)):
        inner = 0.0 if velocity * target < 0.0 else target
        _add_ramp(pieces, velocity, inner, deceleration)
        velocity = inner
    if abs(target) > abs(velocity):
        if acceleration <= 0.0:
            target = velocity
        else:
            _add_ramp(pieces, velocity, target, acceleration)
    return DemandCurve(now, position, tuple(pieces), target)


def _add_ramp(pieces: list[Piece], velocity: float, target: float, rate: float) -> None:
    """Append the ramp from `velocity` to `target`; a rate of 0 or infinity is a step without a piece."""
    if 0.0 < rate < INFINITE and target != velocity:
        pieces.append(Piece(abs(target - velocity) / rate, velocity, math.copysign(rate, target - velocity)))


def move_to(
    now: int,
    position: float,
    velocity: float,
    target: float,
    speed: float,
    acceleration: float,
    deceleration: float,
    end: float = 0.0,
) -> DemandCurve:
    """Return the fastest curve to `target` along ramps, which stops there or passes `target` at the speed `end`.

    Motion in the wrong direction, or too fast to stop at the target, is first braked to standstill. If `speed` or
    `acceleration` is 0, the curve only stops. If the speed `end` cannot be reached before `target`, the curve comes as
    close to that speed as possible.
    """
    deceleration = deceleration if deceleration > 0.0 else INFINITE
    if speed <= 0.0 or acceleration <= 0.0:
        return ramp_to(now, position, velocity, 0.0, 0.0, deceleration)
    end = min(end, speed)
    stop = position + 0.5 * velocity * abs(velocity) / deceleration
    slowed = position + math.copysign(max(0.0, 0.5 * (velocity * velocity - end * end) / deceleration), velocity)
    direction = math.copysign(1.0, target - slowed) if target != slowed else math.copysign(1.0, velocity)
    pieces: list[Piece] = []
    if velocity * direction < 0.0:
        _add_ramp(pieces, velocity, 0.0, deceleration)
        position, velocity, start = stop, 0.0, position
    else:
        start = position
    limits = (speed, acceleration, deceleration)
    end = _approach(pieces, direction, abs(target - position), abs(velocity), limits, end)
    return DemandCurve(now, start, tuple(pieces), direction * end if end else 0.0, target)


def _approach(
    pieces: list[Piece],
    direction: float,
    distance: float,
    velocity: float,
    limits: tuple[float, float, float],
    end: float,
) -> float:
    """Append pieces that cover `distance` from speed `velocity` to speed `end`; return the speed reached at the end."""
    speed, acceleration, deceleration = limits
    if velocity > speed:  # a lower speed was set during the motion
        _add_ramp(pieces, direction * velocity, direction * speed, deceleration)
        distance -= 0.5 * (velocity * velocity - speed * speed) / deceleration
        velocity, distance = speed, max(distance, 0.0)
    fastest = math.sqrt(velocity * velocity + 2.0 * acceleration * distance) if distance else velocity
    end = min(end, fastest)
    peak = min(speed, _peak(distance, velocity, acceleration, deceleration, end))
    _add_ramp(pieces, direction * velocity, direction * peak, acceleration)
    distance -= (
        0.5 * (peak * peak - velocity * velocity) / acceleration + 0.5 * (peak * peak - end * end) / deceleration
    )
    if peak > 0.0 and distance > 0.0:
        pieces.append(Piece(distance / peak, direction * peak, 0.0))
    _add_ramp(pieces, direction * peak, direction * end, deceleration)
    return end


def _peak(distance: float, velocity: float, acceleration: float, deceleration: float, end: float) -> float:
    """Return the maximum speed of a motion over `distance` without a cruise, from speed `velocity` to speed `end`."""
    if acceleration == INFINITE:
        return math.sqrt(2.0 * deceleration * distance + end * end)
    gain = 2.0 * acceleration if deceleration == INFINITE else 2.0 / (1.0 / acceleration + 1.0 / deceleration)
    energy = distance + 0.5 * velocity * velocity / acceleration + 0.5 * end * end / deceleration
    return max(velocity, end, math.sqrt(gain * energy))


def linear_to(now: int, position: float, target: float, seconds: float, onward: float = 0.0) -> DemandCurve:
    """Return a curve to `target` at constant velocity in `seconds`, followed by a stop (for interpolated modes).

    `onward` is the time in s for which the curve continues beyond `target`: the extrapolation for a late set-point.
    """
    if seconds <= 0.0:
        return hold(now, target)
    velocity = (target - position) / seconds
    return DemandCurve(now, position, (Piece(seconds + onward, velocity, 0.0),), 0.0, target + velocity * onward)
