"""Keeps commands within the limits of the description: the controller_manager's `enforce_command_limits`.

The law of the file (ros2_control jazzy): a URDF <limit>, tightened by `min` and `max` of the command interfaces, is
enforced by a `joint_limiter`, with a <safety_controller> by a `soft_limiter`. Accelerations and jerks are limited by
their <command_interface name="acceleration"> and "jerk" alone. Nothing is limited where `<limits enable="false"/>`
stands. A command that is nan stays nan.

Ours, and safer: a joint outside of its range is led back by its velocity limit and not at once, and a velocity may lead
it back too; one that has no velocity state begins from standstill; no velocity changes by more than the acceleration.

What is limited is told once for each occasion: what was asked for, and the limit as the description has it. An occasion
goes on until nothing has been limited for a second, which is how often ros2_control tells it.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import ACCELERATION, POSITION, VELOCITY
from canopen_control.hardware.joint_limiter import JERK, QUANTITIES
from canopen_control.hardware.limited_commands import PlainCommand, limited_joint
from canopen_control.urdf.declared_interface import InterfaceInfo
from canopen_control.urdf.joint_element import HardLimits

if TYPE_CHECKING:
    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry
    from canopen_control.hardware.limited_commands import Commands, Limited, States
    from canopen_control.urdf.description import Description
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = ["CommandLimits", "hard_limits"]

_TOLD_AT_ONCE = 3  # joints named in a sentence
_NO_BOUNDS: Final = InterfaceInfo("")


class CommandLimits:
    """The limits of all joints of a description."""

    def __init__(self, description: Description, registry: InterfaceRegistry) -> None:
        self._limited: list[Limited] = []
        self._clock = 0.0
        states = {each.name: each for each in registry.state_interfaces}
        commands = {each.name: each for each in registry.command_interfaces}
        for part in (one for tag in description.hardware for one in tag.joints):
            limited = []
            for name, info in part.command_interfaces.items():
                command = commands.get(f"{part.name}/{name}")
                if command is not None and info.limited:
                    command.minimum, command.maximum = info.minimum, info.maximum
                    limited.append(command)
            found = [states[each] for name in QUANTITIES if (each := f"{part.name}/{name}") in states]
            self._add(description.joints[part.name], part, limited, found)

    def _add(self, joint: Joint, part: ControlJoint, commands: Commands, states: States) -> None:
        known = [each for each in commands if each.interface in QUANTITIES]
        bounded = (each for each in commands if each.interface not in QUANTITIES and _is_bounded(each))
        self._limited += [PlainCommand(each) for each in bounded]
        if known:
            speeds = VELOCITY in {each.interface for each in states} | {each.interface for each in known}
            limits = hard_limits(joint, part, speeds=speeds)
            if joint.soft is not None or limits != HardLimits() or any(map(_is_bounded, known)):
                self._limited.append(limited_joint(joint, limits, known, states))

    def enforce(self, period: float) -> str | None:
        """Change commands that exceed a limit; return which, when that begins. `period` in s."""
        self._clock = clock = self._clock + period
        judged = period > 0.0
        told: list[str] | None = None
        for each in self._limited:
            if judged and each.passes(period):
                continue
            if (text := each.enforce(period, clock)) is not None:
                told = [text] if told is None else [*told, text]
        return None if told is None else _summary(told)


def _is_bounded(command: CommandInterface) -> bool:
    return math.isfinite(command.minimum) or math.isfinite(command.maximum)


def _summary(told: list[str]) -> str:
    more = [f"and {len(told) - _TOLD_AT_ONCE} more"] if len(told) > _TOLD_AT_ONCE else []
    return "; ".join(told[:_TOLD_AT_ONCE] + more)


def hard_limits(joint: Joint, part: ControlJoint, *, speeds: bool = True) -> HardLimits:
    """Return the limits of a joint by its <limit> and its command interfaces.

    Without `speeds` nobody knows how fast it is, and no acceleration of its positions can be limited.
    """
    limits, interfaces = joint.limits, part.command_interfaces
    position = interfaces.get(POSITION, _NO_BOUNDS)
    lower, upper = (position.minimum, position.maximum) if position.limited else (-math.inf, math.inf)
    faster, slower = _accelerations(interfaces.get(ACCELERATION, _NO_BOUNDS)) if speeds else (math.inf, math.inf)
    return HardLimits(
        max(limits.lower, lower),
        min(limits.upper, upper),
        min(limits.speed, _smaller(interfaces.get(VELOCITY, _NO_BOUNDS))),
        limits.effort,
        faster,
        slower,
        _smaller(interfaces.get(QUANTITIES[JERK], _NO_BOUNDS)),
    )


def _smaller(info: InterfaceInfo) -> float:
    """Return the smaller one of the magnitudes that an interface bounds."""
    return min(abs(info.minimum), info.maximum)


def _accelerations(info: InterfaceInfo) -> tuple[float, float]:
    """Return what speeds up and what slows down at most: `max` and |`min`|, each for both where it stands alone."""
    faster, slower = info.maximum, abs(info.minimum)
    return (faster if math.isfinite(faster) else slower), (slower if math.isfinite(slower) else faster)
