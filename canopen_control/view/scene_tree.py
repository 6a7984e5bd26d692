"""Data for the 3D scene of the robot and its simulated world."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final, NotRequired, TypedDict

from canopen_control.errors import ConfigError
from canopen_control.urdf.geometry import ORIGIN
from canopen_control.urdf.meshes import find_mesh, read_mesh

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.rpc.messages.state import StateSample
    from canopen_control.urdf.joint_element import Joint
    from canopen_control.urdf.robot_model import RobotModel, Visual
    from canopen_control.view.robot_connection import Pose


_TRAIL_POINTS: Final = 1500
_TRAIL_STEP: Final = 0.01  # m
_JUMP: Final = 1.0  # m; more than a robot drives between two samples, so the odometry was set


class _VisualDocument(TypedDict):
    """Shape in the frame of its link, with sizes in m and a quaternion w, x, y, z; `url` is the address of a mesh."""

    shape: str
    size: Sequence[float]
    position: Sequence[float]
    wxyz: Sequence[float]
    color: Sequence[float]
    opacity: float
    url: NotRequired[str]


class _JointDocument(TypedDict):
    """Joint at position zero in the frame of its parent link, with the shapes of its child link."""

    name: str
    kind: str
    parent: str
    child: str
    position: Sequence[float]
    wxyz: Sequence[float]
    axis: Sequence[float]
    visuals: list[_VisualDocument]


class SceneDocument(TypedDict):
    """Tree of joints for the browser, parents before children; `extent` is the size of the robot in m."""

    root: str
    extent: float
    visuals: list[_VisualDocument]
    joints: list[_JointDocument]


class SceneTree:
    """Scene of a robot as data for the browser (`tree`); `notes` describe the parts that cannot be drawn.

    `publish(content, format)` serves a mesh and returns its path on the page's server.
    """

    def __init__(self, model: RobotModel, description: str, publish: Callable[[bytes, str], str]) -> None:
        self.notes = list(model.notes)
        self._description, self._publish = description, publish
        self._urls: dict[str, str] = {}
        self.tree: SceneDocument = {
            "root": model.root,
            "extent": extent_of(model),
            "visuals": self._visuals(model, model.root),
            "joints": [self._joint(model, joint) for joint in model.from_root],
        }

    def _joint(self, model: RobotModel, joint: Joint) -> _JointDocument:
        return {
            "name": joint.name,
            "kind": joint.type,
            "parent": joint.parent,
            "child": joint.child,
            "position": joint.origin.position,
            "wxyz": joint.origin.rotation,
            "axis": joint.axis,
            "visuals": self._visuals(model, joint.child),
        }

    def _visuals(self, model: RobotModel, link: str) -> list[_VisualDocument]:
        visuals = []
        for visual in _visuals_of(model, link):
            try:
                visuals.append(self._visual(visual))
            except ConfigError as error:
                self.notes.append(str(error))
        return visuals

    def _visual(self, visual: Visual) -> _VisualDocument:
        document: _VisualDocument = {
            "shape": visual.shape,
            "size": visual.size,
            "position": visual.pose.position,
            "wxyz": visual.pose.rotation,
            "color": visual.color,
            "opacity": visual.opacity,
        }
        if visual.shape == "mesh":
            document["url"] = self._url(visual.file)
        return document

    def _url(self, file: str) -> str:
        if file not in self._urls:
            mesh = read_mesh(find_mesh(file, self._description))
            self._urls[file] = self._publish(mesh.content, mesh.format)
        return self._urls[file]


def angles_of(model: RobotModel, positions: Mapping[str, float | None]) -> list[float | None]:
    """Return the positions of all joints in rad or m, in the order of the tree; None if unknown."""
    return [_rounded(joint.position_in(positions)) for joint in model.from_root]


def _rounded(angle: float) -> float | None:
    return round(angle, 5) if math.isfinite(angle) else None


class Trail:
    """Path of the base, as points at least a centimetre apart."""

    def __init__(self) -> None:
        self.points: deque[tuple[float, float]] = deque(maxlen=_TRAIL_POINTS)

    def add(self, pose: Pose) -> None:
        """Add a pose of the base; a jump of more than `_JUMP` metres starts a new path."""
        x, y, _ = pose
        last = self.points[-1] if self.points else (math.inf, math.inf)
        moved = math.hypot(x - last[0], y - last[1])
        if self.points and moved > _JUMP:
            self.points.clear()
        if moved >= _TRAIL_STEP - 1e-9:
            self.points.append((round(x, 4), round(y, 4)))


def extent_of(model: RobotModel) -> float:
    """Return the largest distance from the root to the edge of a shape, with all joints at zero; in m, at least 0.1."""
    poses = {model.root: ORIGIN}
    for joint in model.from_root:
        poses[joint.child] = poses[joint.parent].then(joint.pose(0.0))
    reach = 0.1
    for link, pose in poses.items():
        for visual in _visuals_of(model, link):
            size = max(visual.size) / 2 if visual.shape != "mesh" else 0.05
            reach = max(reach, math.hypot(*pose.of(visual.pose.position)) + size)
    return reach


def _visuals_of(model: RobotModel, link: str) -> tuple[Visual, ...]:
    model_link = model.links.get(link)
    return () if model_link is None else model_link.visuals


# Objects in the world of a simulated robot.
#
# The scene is drawn in the odometry frame, but the world has its own frame; the true pose connects both frames.


class _ShapeDocument(TypedDict):
    """Shape in the world, with sizes in m and a quaternion w, x, y, z; `robot` is "" or the robot's name."""

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
        """Update the shapes and the frame; return the new document, or None if unchanged or without pose or shapes."""
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
