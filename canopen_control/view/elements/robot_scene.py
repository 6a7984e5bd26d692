"""The robot in 3D: built once of a tree of links, then moved by the feed. Drawn by the toolkit's own three.js."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import nicegui
from nicegui.element import Element

if TYPE_CHECKING:
    from canopen_control.view.scene_tree import SceneDocument

__all__ = ["RobotScene"]

_THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"


class RobotScene(Element, component="robot_scene.js", esm={"nicegui-scene": str(_THREE)}):
    """Takes from the feed: `scene` {"pose", "angles", "tint"}, and `trail`, the way so far.

    Where the browser has no WebGL it says so in its place.
    """

    def __init__(self, tree: SceneDocument) -> None:
        super().__init__()
        self._props["tree"] = tree
        self.classes("cc-scene")

    def follow(self, follow: bool) -> None:
        """Keep the robot in the middle of the picture, or let it drive out of it."""
        self.run_method("setFollow", follow)
