"""Teleoperation panel: a button drives the robot while it is held; requires `--teleop`.

The active controllers determine what can be driven: a base by its twist, joints by values, and an arm by a trajectory
to the positions of the sliders.
"""

from __future__ import annotations

import math
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from canopen_control.rpc.messages.robot import SwitchControllers
from canopen_control.urdf.joint_element import UrdfLimits
from canopen_control.view.elements.nicegui_elements import HoldButton
from canopen_control.view.panels.panel import LARGEST, READ_ONLY, hold_buttons, show_notice, value_slider
from canopen_control.view.robot_connection import joint_motion, trajectory_motion, twist_motion
from canopen_control.view.targets import TargetSliders, drive_targets
from canopen_control.view.trajectory_player import follows_trajectories

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.rpc.messages.state import ControllerReading
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext
    from canopen_control.view.robot_connection import TeleopCommands


# button, symbol, keyboard key, and the factors of the speeds forward, to the left, and around
_PAD: Final = {
    "forward": ("Forward", "▲", "ArrowUp", 1, 0, 0),
    "left": ("Left", "◀", "ArrowLeft", 0, 0, 1),
    "back": ("Back", "▼", "ArrowDown", -1, 0, 0),
    "right": ("Right", "▶", "ArrowRight", 0, 0, -1),
}
# the same for the additional buttons of a base that can drive sideways
_SIDEWAYS: Final = {
    "slide_left": ("Slide left", "⇐", "", 0, 1, 0),
    "slide_right": ("Slide right", "⇒", "", 0, -1, 0),
}
_LINEAR: Final = (0.0, 1.0, 0.05, 0.2)  # m/s: lowest, highest, step, initial value
_ANGULAR: Final = (0.0, 3.0, 0.1, 0.8)  # rad/s
_SHARE: Final = (5.0, 100.0, 5.0, 25.0)  # percent of the joints' velocity limits
_UNLIMITED: Final = 1.0  # rad/s or m/s: assumed for a joint without a velocity limit
_ACCELERATION: Final = 1.0  # rad/s^2 or m/s^2, of an arm during teleoperation
_SHORTEST_S: Final = 0.2
_NOTHING: Final = "<p class='cc-note'>No active controller accepts commands.</p>"
_INACTIVE: Final = "<p class='cc-note'>{} accepts commands, but is not active.</p>"


class TeleopPanel:
    """Panel with the inputs for the first active controller; rebuilt when the controllers change."""

    def __init__(self, context: PanelContext) -> None:
        self._context, self._client = context, ui.context.client
        self._joints = context.robot.model.joints
        self._positions: dict[str, float | None] = {}
        self._targets: TargetSliders | None = None
        self._arm: TeleopCommands | None = None  # motion of the held button, until a slider is changed
        self._requested: object = None
        self._sliders: dict[str, ui.slider] = {}
        self._shown: object = None
        self._frame = ui.context.slot.parent
        self._whole = ui.element("div").classes("cc-acts")

    def show(self, content: PageContent) -> None:
        if content.lost:
            return
        self._positions = {name: joint.position for name, joint in content.state.joints.items()}
        candidates = tuple(
            controller
            for controller in content.controllers
            if controller.is_base or controller.topic == "commands" or follows_trajectories(controller)
        )
        drives = drive_targets(content.state, content.controllers)  # shown in `TargetPanel`
        self._frame.visible = bool(candidates) or not drives
        key = tuple((candidate.name, candidate.state) for candidate in candidates)
        if key != self._shown:
            self._shown = key
            self._build(candidates)
        self._whole.classes(**{"remove" if content.banner.tone == "good" else "add": "cc-off"})
        if self._targets is not None:
            for joint, at in self._targets.follow(self._positions).items():
                self._sliders[joint].value = at

    def _build(self, candidates: tuple[ControllerReading, ...]) -> None:
        self._context.release(self._client.id)
        self._whole.clear()
        self._targets, self._arm, self._sliders = None, None, {}
        active = [candidate for candidate in candidates if candidate.state == "active"]
        with self._whole:
            if not self._context.teleop:
                ui.html(READ_ONLY, sanitize=False)
            elif not active:
                names = escape(", ".join(candidate.name for candidate in candidates))
                ui.html(_INACTIVE.format(names) if names else _NOTHING, sanitize=False)
            elif active[0].is_base:
                self._pad(active[0])
            elif follows_trajectories(active[0]):
                self._reach(active[0])
            else:
                self._values(active[0])
            self._choice(candidates, active)

    def _choice(self, candidates: tuple[ControllerReading, ...], active: list[ControllerReading]) -> None:
        """Create the selection of the controller if there are several candidates."""
        names = [candidate.name for candidate in candidates]
        if len(names) < 2:
            return
        chosen = active[0].name if active else None
        ui.select(
            names, label="controller", value=chosen, on_change=lambda event: self._switch(str(event.value), active)
        ).props("dense").style("width: 100%")

    async def _switch(self, name: str, active: list[ControllerReading]) -> None:
        names = tuple(reading.name for reading in active if reading.name != name)
        refused = await self._context.ask(SwitchControllers(activate=(name,), deactivate=names))
        if refused is not None:
            show_notice(f"{name} is not active", refused)
            self._shown = None  # rebuild the panel with the active controller

    def _pad(self, controller: ControllerReading) -> None:
        """Create four direction buttons (six for a base that drives sideways) and sliders for the speeds."""
        pad = {**_PAD, **(_SIDEWAYS if controller.drives_sideways else {})}
        buttons = [HoldButton(key, label, sign, keyboard) for key, (label, sign, keyboard, *_) in pad.items()]

        def motion(key: str) -> TeleopCommands:
            ahead, aside, around = pad[key][3:]
            speed, turn = float(linear.value), float(angular.value)
            return twist_motion(controller.name, ahead * speed, around * turn, aside * speed)

        hold_buttons(self._context, buttons, motion, "cc-pad")
        linear = value_slider("speed, m/s", *_LINEAR)
        angular = value_slider("turn, rad/s", *_ANGULAR)

    def _values(self, controller: ControllerReading) -> None:
        """Create a slider for each joint of the controller, and a button that sends the values while held."""
        limits = {joint: self._range(joint, controller.interface or "") for joint in controller.joints}
        if controller.interface == "position":
            self._targets = TargetSliders(limits)
            self._targets.follow(self._positions)
        for joint, (low, high) in limits.items():
            value = self._targets.values[joint] if self._targets is not None else min(max(0.0, low), high)
            slider = self._sliders[joint] = value_slider(joint, low, high, (high - low) / 200, value)
            if self._targets is not None:
                slider.on("update:model-value", partial(self._on_set, joint))
        hold_buttons(self._context, [HoldButton("drive", "Hold to drive")], lambda _key: self._motion(controller))

    def _reach(self, controller: ControllerReading) -> None:
        """Create a slider for each joint of an arm, and a button that moves the arm to the sliders' positions."""
        limits = {joint: self._range(joint, "position") for joint in controller.joints}
        targets = self._targets = TargetSliders(limits)
        targets.follow(self._positions)
        for joint, (low, high) in limits.items():
            slider = self._sliders[joint] = value_slider(joint, low, high, (high - low) / 400, targets.values[joint])
            slider.on("update:model-value", partial(self._on_set, joint))
        share = value_slider("speed, %", *_SHARE)

        def motion(_key: str) -> TeleopCommands | None:
            begins = not targets.driven
            positions = targets.targets(self._positions), float(share.value)
            if begins or positions != self._requested:  # a changed slider needs a new trajectory
                self._requested = positions
                self._arm = self._trajectory(controller, *positions)
            return self._arm

        hold_buttons(self._context, [HoldButton("drive", "Hold to move")], motion)

    def _trajectory(
        self, controller: ControllerReading, positions: Sequence[float], percent: float
    ) -> TeleopCommands | None:
        """Return the trajectory to the sliders' positions within the velocity limits; None if a position is unknown.

        On a cubic from standstill to standstill, velocity peaks at 1.5 times its mean, acceleration at 6 d/T^2.
        """
        longest = _SHORTEST_S
        for joint, to in zip(controller.joints, positions, strict=True):
            at = self._positions.get(joint)
            if at is None:
                return None
            limits = self._joints.get(joint)
            limit = limits.limits.velocity if limits is not None else math.inf
            velocity = percent / 100 * (limit if math.isfinite(limit) and limit > 0.0 else _UNLIMITED)
            longest = max(longest, 1.5 * abs(to - at) / velocity, math.sqrt(6.0 * abs(to - at) / _ACCELERATION))
        return trajectory_motion(controller.name, controller.joints, positions, longest)

    def _on_set(self, joint: str, event: Any) -> None:  # noqa: ANN401 - what a browser sends
        if self._targets is not None and isinstance(event.args, (int, float)):
            self._targets.set(joint, float(event.args))

    def _motion(self, controller: ControllerReading) -> TeleopCommands:
        if self._targets is None:
            values = [float(slider.value) for slider in self._sliders.values()]
            return joint_motion(controller.name, values, [0.0] * len(values))
        return joint_motion(
            controller.name, self._targets.targets(self._positions), self._targets.rest(self._positions)
        )

    def _range(self, joint: str, interface: str) -> tuple[float, float]:
        """Return the range of a slider: the joint's limits in the URDF or, without limits, a range from `LARGEST`."""
        own_limits = self._joints.get(joint)
        limits = own_limits.limits if own_limits is not None else UrdfLimits()
        if interface == "position" and math.isfinite(limits.lower) and math.isfinite(limits.upper):
            return limits.lower, limits.upper if limits.lower < limits.upper else limits.lower + 1.0
        largest = LARGEST.get(interface, 1.0)
        limit = min({"velocity": limits.velocity, "effort": limits.effort}.get(interface) or largest, largest)
        return -limit, limit
