"""The robot in the page's 3D scene: a tree of frames as the URDF has it, a grid, and the trail of the base.

The law of this file: only what changed is sent. The world moves under the robot when the camera follows it, so that a
user's hand on the camera and the robot's way never fight; where no controller knows the way, the base stands.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canopen_control.errors import ConfigError
from canopen_control.view.meshes import find_mesh, read_mesh
from canopen_control.view.model import joint_pose
from canopen_control.view.pose import IDENTITY, about, multiply, rotate

if TYPE_CHECKING:
    from collections.abc import Mapping

    from canopen_control.view.model import Joint, Model, Visual
    from canopen_control.view.pose import Quaternion, Vector
    from canopen_control.view.server import PageServer

__all__ = ["RobotScene", "extent_of"]

BASE: Final = "/world/robot"
_FAULT: Final = (214, 40, 40)
_TRAIL: Final = (38, 110, 200)
_TRAIL_POINTS: Final = 1500
_TRAIL_STEP: Final = 0.01  # m
_TRAIL_Z: Final = 0.002  # m
_GRID_Z: Final = -0.001  # m; wheels stand on it, not in it


class RobotScene:
    """Draws `model` once, then moves it; `notes` says what could not be drawn."""

    def __init__(self, server: PageServer, model: Model, description: str) -> None:
        self.follow = True
        self.notes = list(model.notes)
        self._scene, self._model, self._description = server.scene, model, description
        self._frames: dict[str, Any] = {}
        self._joints: dict[str, Joint] = {joint.name: joint for joint in model.joints}
        self._angles: dict[str, float] = {}
        self._shapes: dict[str, list[tuple[Any, tuple[int, int, int]]]] = {}
        self._tinted: set[str] = set()
        self._pose: tuple[float, float, float] | None = None
        self._trail: deque[tuple[float, float]] = deque(maxlen=_TRAIL_POINTS)
        self._trail_handle: Any = None
        self._trail_news = 0
        self._draw()
        self._aim(server)

    def _draw(self) -> None:
        scene, extent = self._scene, extent_of(self._model)
        cell = 0.1 if extent < 1.0 else 0.5
        self._world = scene.add_frame("/world", show_axes=False)
        scene.add_grid(
            "/world/grid",
            infinite_grid=True,
            cell_size=cell,
            section_size=10 * cell,
            cell_color=(222, 226, 232),
            section_color=(168, 178, 192),
            fade_distance=40 * extent,
            position=(0.0, 0.0, _GRID_Z),
        )
        self._base = scene.add_frame(BASE, show_axes=False)
        paths = {self._model.root: f"{BASE}/{self._model.root}"}
        self._draw_link(self._model.root, paths[self._model.root])
        for joint in self._model.joints:
            paths[joint.child] = path = f"{paths[joint.parent]}/{joint.child}"
            position, wxyz = joint_pose(joint, 0.0)
            self._frames[joint.name] = scene.add_frame(path, show_axes=False, position=position, wxyz=wxyz)
            self._draw_link(joint.child, path)

    def _draw_link(self, link: str, path: str) -> None:
        for number, visual in enumerate(self._model.visuals.get(link, ())):
            try:
                handle = self._draw_visual(visual, f"{path}/visual_{number}")
            except ConfigError as error:
                self.notes.append(str(error))
                continue
            if hasattr(handle, "color"):
                self._shapes.setdefault(link, []).append((handle, visual.color))

    def _draw_visual(self, visual: Visual, path: str) -> Any:  # noqa: ANN401 - a handle of viser
        placed: dict[str, Any] = {"position": visual.position, "wxyz": visual.wxyz}
        painted = placed | {"color": visual.color, "opacity": None if visual.opacity >= 1.0 else visual.opacity}
        if visual.shape == "box":
            return self._scene.add_box(path, dimensions=_three(visual.size), **painted)
        if visual.shape == "cylinder":
            return self._scene.add_cylinder(path, radius=visual.size[0], height=visual.size[1], **painted)
        if visual.shape == "sphere":
            return self._scene.add_icosphere(path, radius=visual.size[0], **painted)
        mesh, placed["scale"] = read_mesh(find_mesh(visual.file, self._description)), _three(visual.size)
        if mesh.visual.kind is None:
            color, opacity = painted["color"], painted["opacity"]
            return self._scene.add_mesh_simple(
                path, mesh.vertices, mesh.faces, color=color, opacity=opacity, flat_shading=True, **placed
            )
        return self._scene.add_mesh_trimesh(path, mesh, **placed)

    def _aim(self, server: PageServer) -> None:
        """Look at the whole robot from behind its left side, so that left and forward are the driver's own."""
        extent = extent_of(self._model)
        server.initial_camera.look_at = (0.0, 0.0, 0.3 * extent)
        server.initial_camera.position = (-2.7 * extent, 1.9 * extent, 2.2 * extent)
        server.initial_camera.near = 0.01

    # ------------------------------------------------------------------------------------------------- what moves

    def move(self, positions: Mapping[str, float | None], pose: tuple[float, float, float] | None) -> None:
        """Show joints (rad or m by name) and base (x and y in m, heading in rad; None where nobody knows)."""
        for name, joint in self._joints.items():
            angle = self._model.angle(joint, positions)
            if angle is not None and joint.kind != "fixed" and angle != self._angles.get(name):
                self._angles[name] = angle
                position, wxyz = joint_pose(joint, angle)
                frame = self._frames[name]
                frame.wxyz = wxyz
                if joint.kind == "prismatic":
                    frame.position = position
        if pose is not None and pose != self._pose:
            self._move_base(pose)

    def _move_base(self, pose: tuple[float, float, float]) -> None:
        x, y, heading = pose
        self._pose = pose
        self._base.position = (x, y, 0.0)
        self._base.wxyz = about((0.0, 0.0, 1.0), heading)
        self._place_world()
        last = self._trail[-1] if self._trail else (math.inf, math.inf)
        jump = math.hypot(x - last[0], y - last[1])
        if self._trail and jump > 100 * _TRAIL_STEP:
            self.clear_trail()  # the odometry was set anew
        if jump > _TRAIL_STEP - 1e-9:
            self._trail.append((x, y))
            self._trail_news += 1

    def follow_robot(self, follow: bool) -> None:
        """Keep the robot in the middle of the picture, or let it drive out of it."""
        self.follow = follow
        self._place_world()

    def _place_world(self) -> None:
        x, y, _ = self._pose if self.follow and self._pose is not None else (0.0, 0.0, 0.0)
        self._world.position = (-x, -y, 0.0)

    def draw_trail(self) -> None:
        """Send what was added to the trail; a few times a second is enough."""
        if self._trail_news == 0 or len(self._trail) < 2 or self._pose is None:
            return
        self._trail_news = 0
        way = np.array([*self._trail, self._pose[:2]], dtype=np.float32)
        points = np.column_stack((way, np.full(len(way), _TRAIL_Z, dtype=np.float32)))
        segments = np.stack((points[:-1], points[1:]), axis=1)
        if self._trail_handle is None:
            self._trail_handle = self._scene.add_line_segments(
                "/world/trail", segments, _TRAIL, thickness=3.0, thickness_units="screen"
            )
        else:
            self._trail_handle.points = segments

    def clear_trail(self) -> None:
        """Forget the way so far."""
        self._trail.clear()
        self._trail_news = 0
        if self._trail_handle is not None:
            self._trail_handle.remove()
            self._trail_handle = None

    def tint(self, joints: set[str]) -> None:
        """Show in red what hangs on these joints: their drive is in a fault or lost."""
        for name in joints ^ self._tinted:
            joint = self._joints.get(name)
            for handle, color in self._shapes.get(joint.child, ()) if joint is not None else ():
                handle.color = _FAULT if name in joints else color
        self._tinted = set(joints)


def extent_of(model: Model) -> float:
    """Return how far the robot reaches from its root with all joints at zero, in m; at least 0.1."""
    places: dict[str, Vector] = {model.root: (0.0, 0.0, 0.0)}
    turns: dict[str, Quaternion] = {model.root: IDENTITY}
    reach = 0.1
    for joint in (None, *model.joints):
        link = model.root if joint is None else joint.child
        if joint is not None:
            position, wxyz = joint_pose(joint, 0.0)
            places[link] = _plus(places[joint.parent], rotate(turns[joint.parent], position))
            turns[link] = multiply(turns[joint.parent], wxyz)
        for visual in model.visuals.get(link, ()):
            center = _plus(places[link], rotate(turns[link], visual.position))
            size = max(visual.size) / 2 if visual.shape != "mesh" else 0.05
            reach = max(reach, math.hypot(*center) + size)
    return reach


def _plus(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def _three(size: tuple[float, ...]) -> tuple[float, float, float]:
    return size[0], size[1], size[2]
