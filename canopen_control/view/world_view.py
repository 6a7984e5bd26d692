"""Objects of a simulated world for the 3D scene.

The scene is drawn in the odometry frame, but the world has its own frame; the true pose connects both. A real drive has
no socket for such a request.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.rpc.messages.state import StateSample


class _ShapeDocument(TypedDict):
    """Shape in the world, with sizes in m and a quaternion w, x, y, z; `robot` is the name of its robot, if any."""

    shape: str
    size: Sequence[float]
    position: Sequence[float]
    wxyz: Sequence[float]
    moves: bool
    robot: str
    grip: float


class WorldDocument(TypedDict):
    """World for the browser; `place` is the world frame's pose in the odometry frame (x and y in m, angle in rad)."""

    place: list[float]
    shapes: list[_ShapeDocument]


class WorldView:
    """Shapes of a world, and the world frame's pose in the odometry frame."""

    def __init__(self) -> None:
        self.document: WorldDocument | None = None

    def take(self, shapes: Sequence[WorldShape], state: StateSample) -> WorldDocument | None:
        """Update the shapes and the frame; return the new document, None if unchanged or without a true pose."""
        truth = state.true_pose
        if truth is None or truth.odom is None or not (shapes or self.document):
            return None
        x, y, turn = truth.odom
        cosine, sine = math.cos(turn), math.sin(turn)
        place = [-(cosine * x + sine * y), sine * x - cosine * y, -turn]
        drawn = WorldDocument(
            place=[round(number, 4) + 0.0 for number in place], shapes=[_drawn(shape) for shape in shapes]
        )
        if drawn == self.document:
            return None
        self.document = drawn
        return drawn


def _drawn(shape: WorldShape) -> _ShapeDocument:
    return {
        "shape": shape.kind,
        "size": list(shape.size),
        "position": list(shape.position),
        "wxyz": list(shape.rotation),
        "moves": shape.moves,
        "robot": shape.robot,
        "grip": shape.grip,
    }
