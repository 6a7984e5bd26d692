"""The robot in 3D, driving by its odometry; without WebGL a sentence stands there."""

from __future__ import annotations

from typing import TYPE_CHECKING

from nicegui import ui

from canopen_control.view.elements.robot_scene import RobotScene

if TYPE_CHECKING:
    from canopen_control.view.desk import Desk
    from canopen_control.view.picture import Picture

__all__ = ["ScenePanel"]


class ScenePanel:
    """The robot in 3D; the feed moves it."""

    def __init__(self, desk: Desk) -> None:
        with ui.element("div").classes("cc-stale").style("position: absolute; inset: 0"):
            scene = RobotScene(desk.robot.scene.tree)
        ui.checkbox("Camera follows", value=True, on_change=lambda event: scene.follow(bool(event.value))).props(
            "dense"
        ).classes("cc-follow")

    def show(self, picture: Picture) -> None:
        """Leave it to the feed."""
