"""Which command and state interfaces a joint trajectory controller can have together.

The law of the file (ros2_controllers jazzy): the validators of its parameters, and what it checks when configured.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from canopen_control.hardware.interfaces import ACCELERATION, EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

__all__ = ["COMMANDS", "STATES", "wrong_commands", "wrong_joints", "wrong_states", "wrong_together"]

COMMANDS: Final = (POSITION, VELOCITY, ACCELERATION, EFFORT)
STATES: Final = (POSITION, VELOCITY, ACCELERATION)


def wrong_commands(given: Sequence[str]) -> str | None:
    """Say what is wrong with a list of command interfaces, None if nothing is."""
    if (wrong := _wrong_list("command_interfaces", given, COMMANDS)) is not None:
        return wrong
    if VELOCITY in given and len(given) > 1 and POSITION not in given:
        return "command_interfaces: velocity goes alone or with position; add position"
    if ACCELERATION in given and VELOCITY not in given and POSITION not in given:
        return "command_interfaces: acceleration goes with position or velocity; add one"
    if EFFORT in given and set(given) not in ({EFFORT}, {POSITION, EFFORT}):
        return "command_interfaces: effort goes alone or with position; leave the others out"
    return None


def wrong_states(given: Sequence[str]) -> str | None:
    """Say what is wrong with a list of state interfaces, None if nothing is."""
    if (wrong := _wrong_list("state_interfaces", given, STATES)) is not None:
        return wrong
    if VELOCITY in given and POSITION not in given:
        return "state_interfaces: velocity goes with position; add position"
    if ACCELERATION in given and not {POSITION, VELOCITY}.issubset(given):
        return "state_interfaces: acceleration goes with position and velocity; add both"
    return None


def wrong_together(commands: Collection[str], states: Collection[str]) -> str | None:
    """Say which states the loops over these commands lack, None if none."""
    looped = set(commands) in ({VELOCITY}, {EFFORT}, {POSITION, EFFORT})
    if looped and not {POSITION, VELOCITY}.issubset(states):
        return (
            f"state_interfaces: commanding {' and '.join(commands)} needs position and velocity; "
            f"give state_interfaces: [position, velocity]"
        )
    return None


def wrong_joints(joints: Sequence[str], command_joints: Sequence[str]) -> str | None:
    """Say what is wrong with the joints that are commanded, None if nothing is.

    As many as joints may have any names, those of another hardware; fewer are some of the joints.
    """
    if len(command_joints) > len(joints):
        return f"command_joints: {len(command_joints)} are more than the {len(joints)} joints; leave some out"
    strange = [each for each in command_joints if each not in joints]
    if strange and len(command_joints) != len(joints):
        return f"command_joints: {', '.join(strange)}: not among joints ({', '.join(joints)}); name some of those"
    return None


def _wrong_list(key: str, given: Sequence[str], known: Sequence[str]) -> str | None:
    if not given:
        return f"{key} is empty; give one or more of {', '.join(known)}"
    if len(set(given)) != len(given):
        return f"{key} names one twice: {', '.join(given)}; name each once"
    strange = [each for each in given if each not in known]
    if strange:
        return f"{key}: {', '.join(strange)}: there are {', '.join(known)}"
    return None
