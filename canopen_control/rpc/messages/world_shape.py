"""What stands in the world of simulated robots, a part of what their drives and recordings tell."""

from __future__ import annotations

import msgspec


class WorldShape(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A thing in a world beside the robot: `kind` is "box", "cylinder" (along z), "ellipsoid", or "patch" of the floor.

    `size` are its lengths in m along its own axes; `position` of its middle in m and `rotation`, the quaternion w, x,
    y, z, are those in the world; it `moves` where it can be pushed. It is part of another `robot` where that is named;
    `grip` is the friction of a patch.
    """

    name: str
    kind: str
    size: tuple[float, float, float]
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    moves: bool = False
    robot: str = ""
    grip: float = 0.0
