"""A cap on how fast joints move, whatever interface they are commanded by; for first contact with real drives.

The law of this file: what cannot be limited is named, never passed over. A velocity is bounded where it becomes the
drive's target, and so are the speeds that a drive has by itself (0x6081, 0x6099). A position follows its command in
steps of at most speed times cycle, from where the joint is. An effort has no speed: it is taken away as
long as the joint is faster than the cap and would be driven further that way.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

from canopen_control.hardware.interfaces import EFFORT, POSITION, TARGET, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Mapping

    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.hardware.joint import JointDrive

__all__ = ["SpeedCap"]

_LAG_S = 0.5  # a joint that is further behind than this at the cap has not followed: it was disabled, or is blocked


class Limiter(Protocol):
    """Another limiter, such as enforce_command_limits."""

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; `period` in s. Return which, when that begins."""


class _Position:
    """A position that goes to its command at the cap; `last` is where it has got to, nan before any command."""

    __slots__ = ("_command", "_here", "_last", "_limit", "_wanted")

    def __init__(self, command: CommandInterface, here: StateInterface, limit: float) -> None:
        self._command, self._here, self._limit = command, here, limit
        self._last = self._wanted = math.nan

    def enforce(self, period: float) -> None:
        value, here = self._command.value, self._here.value
        if self._command.owner is None or not math.isfinite(value):
            self._last = math.nan
            return
        if value != self._last:  # else no controller was due, and the way to what it said goes on
            self._wanted = value
        followed = abs(self._last - here) <= self._limit * _LAG_S  # False for nan
        start, step = self._last if followed else here, self._limit * period
        self._command.value = self._last = max(start - step, min(start + step, self._wanted))


class _Effort:
    """An effort that is taken away above the cap."""

    __slots__ = ("_command", "_limit", "_speed")

    def __init__(self, command: CommandInterface, speed: StateInterface, limit: float) -> None:
        self._command, self._speed, self._limit = command, speed, limit

    def enforce(self, period: float) -> None:  # noqa: ARG002 - as with a position
        speed = self._speed.value
        if self._command.value * speed > 0.0 and abs(speed) > self._limit:
            self._command.value = 0.0


class _Target:
    """What the present mode takes: a velocity within the cap, or a position or an effort as they are capped."""

    __slots__ = ("_command", "_effort", "_limit", "_position")

    def __init__(self, command: CommandInterface, here: StateInterface, speed: StateInterface, limit: float) -> None:
        self._command, self._limit = command, limit
        self._position, self._effort = _Position(command, here, limit), _Effort(command, speed, limit)

    def enforce(self, period: float) -> None:
        command, quantity = self._command, self._command.quantity
        if quantity == VELOCITY:
            if abs(command.value) > self._limit:  # False for nan
                command.value = math.copysign(self._limit, command.value)
        elif quantity == EFFORT:
            self._effort.enforce(period)
        else:
            self._position.enforce(period)


_NEEDS: dict[str, tuple[str, Callable[[CommandInterface, StateInterface, float], _Position | _Effort]]] = {
    POSITION: (POSITION, _Position),
    EFFORT: (VELOCITY, _Effort),
}


class SpeedCap:
    """Caps the `joints` at `limit` rad/s, or m/s, after another limiter; `unlimited` are the commands it cannot cap."""

    def __init__(
        self, registry: InterfaceRegistry, joints: Container[str], limit: float, before: Limiter | None = None
    ) -> None:
        self.unlimited: list[str] = []
        self._before, self._limit = before, limit
        self._capped: list[_Position | _Effort | _Target] = []
        states = {each.name: each for each in registry.state_interfaces}
        for command in registry.command_interfaces:
            if command.joint in joints and command.interface == TARGET:
                self._cap_target(command, states)
            if command.joint not in joints or command.interface not in _NEEDS:
                continue
            needed, make = _NEEDS[command.interface]
            state = states.get(f"{command.joint}/{needed}")
            if state is None:
                self.unlimited.append(command.name)
            else:
                self._capped.append(make(command, state, limit))

    def _cap_target(self, command: CommandInterface, states: Mapping[str, StateInterface]) -> None:
        here, speed = (states.get(f"{command.joint}/{each}") for each in (POSITION, VELOCITY))
        if here is None or speed is None:
            self.unlimited.append(command.name)
        else:
            self._capped.append(_Target(command, here, speed, self._limit))

    def bound(self, drives: Iterable[JointDrive], reductions: Mapping[str, float]) -> None:
        """Bound the velocity targets of drives, and what they do by themselves, for as long as they live.

        `reductions` are the turns of the motor for one of the joint, by joint, where a transmission lies between.
        """
        for drive in drives:
            most = self._limit * abs(reductions.get(drive.joint, 1.0))
            drive.axis.limits.lower(most, "the speed limit of this run")
            command = drive.commands.get(VELOCITY)
            if command is not None:
                command.minimum = max(command.minimum, -most)
                command.maximum = min(command.maximum, most)

    def enforce(self, period: float) -> str | None:
        """Change commands that are too fast; `period` in s. Return what the other limiter tells."""
        told = None if self._before is None else self._before.enforce(period)
        for each in self._capped:
            each.enforce(period)
        return told
