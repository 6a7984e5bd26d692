"""What happens in a world that has physics, as YAML writes it: the keys payload, push, block and friction of a step.

The same in a scenario of drives and in the file of a world; the messages are those of the drives' socket, see
`rpc.messages.drive`. Lengths in m, masses in kg, forces in N.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip
from canopen_control.yamlfile.convert import setting

if TYPE_CHECKING:
    from collections.abc import Iterable

    from canopen_control.rpc.messages.drive import WorldAct

__all__ = ["Happening", "Payload", "Push", "world_words"]


@dataclass(frozen=True)
class Payload:
    """See `AddPayload`."""

    mass: float
    on: str = ""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Push:
    """See `PushRobot`."""

    force: tuple[float, float, float]
    on: str = ""
    seconds: float = setting(0.2, low=1e-3)


def world_words(act: WorldAct) -> list[tuple[str, str]]:
    """Return what happens as the keys of a step have it, with the text of their values."""
    if isinstance(act, BlockJoint):
        return [("block", act.joint)]
    if isinstance(act, SetGrip):
        return [("friction", f"{act.friction:g}")]
    numbers = {"mass": f"{act.mass:g}"} if isinstance(act, AddPayload) else {"force": _list(act.force)}
    if act.on:
        numbers["on"] = act.on
    if isinstance(act, AddPayload):
        numbers["position"] = _list(act.position)
    else:
        numbers["seconds"] = f"{act.seconds:g}"
    text = f"{{{', '.join(f'{key}: {value}' for key, value in numbers.items())}}}"
    return [("payload" if isinstance(act, AddPayload) else "push", text)]


def _list(numbers: Iterable[float]) -> str:
    return f"[{', '.join(f'{each:g}' for each in numbers)}]"


@dataclass(frozen=True, kw_only=True)
class Happening:
    """The keys of a step; a joint that is to `block` may be let go again after a time."""

    payload: Payload | None = None
    push: Push | None = None
    block: str = ""
    friction: float | None = setting(None, low=0.0, high=10.0)

    def acts(self) -> list[WorldAct]:
        """Return what is to happen."""
        found: list[WorldAct] = []
        if self.payload is not None:
            found.append(AddPayload(mass=self.payload.mass, on=self.payload.on, position=self.payload.position))
        if self.push is not None:
            found.append(PushRobot(force=self.push.force, on=self.push.on, seconds=self.push.seconds))
        if self.friction is not None:
            found.append(SetGrip(friction=self.friction))
        if self.block:
            found.append(BlockJoint(joint=self.block))
        return found
