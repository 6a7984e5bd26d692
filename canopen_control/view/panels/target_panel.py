"""Panels that enable and disable drives, and panels that send a target while a button is held.

Driving requires `--teleop`. A target is sent while the button is held; releasing the button, closing the page or a lost
connection ends the target. A velocity or an effort then becomes zero, a position the present position of the drive.
The user chooses the range of a slider, because the bus does not provide limits.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.rpc.messages.robot import AxisRequest
from canopen_control.view.elements.nicegui_elements import HoldButton
from canopen_control.view.panels.panel import LARGEST, READ_ONLY, hold_buttons, show_notice, value_slider
from canopen_control.view.robot_connection import SOURCE, joint_motion
from canopen_control.view.targets import MODES, DriveTarget, drive_targets

if TYPE_CHECKING:
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext
    from canopen_control.view.robot_connection import TeleopCommands


# Power: enable, disable and reset all drives, or a single drive.


#: label of the button, name of the action in the runtime, colour
_POWER_ACTIONS: Final = (
    ("Enable", "enable", "green-8"),
    ("Disable", "disable", "blue-grey-6"),
    ("Reset fault", "fault-reset", "blue-grey-6"),
)


_LATCHED: Final = "STOP is latched: release it first, then enable."


class PowerPanel:
    """Buttons that enable, disable and reset each drive or all drives; with `node`, only the drives of that node.

    The Enable buttons are disabled with a hint while STOP is latched, because the robot would refuse.
    """

    def __init__(self, context: PanelContext, node: str = "") -> None:
        self._context = context
        self._enable: list[EnableButton] = []
        nodes = context.robot.info.state.nodes
        drives = [name for name, place in nodes.items() if place.axes and node in ("", name)]
        if not drives:
            ui.html("<p class='cc-note'>No drives to enable.</p>", sanitize=False)
        for drive in [*(("all",) if len(drives) > 1 else ()), *drives]:
            self._row(drive)

    def show(self, content: PageContent) -> None:
        for button in self._enable:
            button.show(content)

    def _row(self, drive: str) -> None:
        with ui.element("div").classes("cc-drive cc-acts"):
            with ui.element("b"):
                ui.label("all drives" if drive == "all" else drive)
            with ui.element("div"):
                for label, action, color in _POWER_ACTIONS:
                    outline = "unelevated dense" if drive == "all" else "outline dense"
                    button = ui.button(label, color=color, on_click=partial(self._act, drive, action, label))
                    button.props(outline).props(f'aria-label="{label}"')
                    if action == "enable":
                        self._enable.append(EnableButton(button, color))

    async def _act(self, drive: str, action: str, label: str) -> None:
        refused = await self._context.ask(AxisRequest(action=action, node=drive, source=SOURCE))
        if refused is not None:
            show_notice(f"{drive}: {label.lower()}", refused)


class EnableButton:
    """Button in `color` that is enabled if `allowed`; grey and disabled while STOP is latched."""

    def __init__(self, button: ui.button, color: str, *, allowed: bool = True) -> None:
        self._button, self._color, self._allowed = button, color, allowed
        self._latched: bool | None = None
        with button:
            self._why = ui.tooltip(_LATCHED)

    def show(self, content: PageContent) -> None:
        """Update the button if the stop latch has changed."""
        latched = content.state.latched
        if latched is not self._latched:
            self._latched = latched
            self._button.props(f"color={'grey-5' if latched else self._color}")
            self._button.set_enabled(self._allowed and not latched)
            self._why.visible = latched


#: label of the button, name of the action in the runtime, colour
_ACTIONS: Final = (("Enable", "enable", "green-8"), ("Stop", "disable", "red-8"))
_NO_MODE: Final = "<p class='cc-note'>The present mode of operation takes no target: choose another mode.</p>"
_MAX: Final = 1e6  # largest end of a slider
_SHOWS: Final = {"position": "Hold to go there", "velocity": "Hold to turn", "effort": "Hold to push"}


class TargetPanel:
    """Mode, target and power of each drive that a target controller commands; `node` restricts the drives."""

    def __init__(self, context: PanelContext, node: str = "") -> None:
        self._context, self._node = context, node
        self._frame = ui.context.slot.parent
        self._frame.visible = False
        self._whole = ui.element("div")
        self._rows: dict[str, _Row] = {}
        self._read_only = ui.html(READ_ONLY, sanitize=False)
        self._read_only.visible = not context.teleop

    def show(self, content: PageContent) -> None:
        if content.lost:
            return
        targets = drive_targets(content.state, content.controllers)
        drives = [drive for drive in targets if self._node in ("", drive.node)]
        self._frame.visible = bool(drives)
        if [drive.joint for drive in drives] != list(self._rows):
            self._whole.clear()
            with self._whole:
                self._rows = {drive.joint: _Row(self._context, drive) for drive in drives}
        for drive in drives:
            joint = content.state.joints.get(drive.joint)
            self._rows[drive.joint].enable.show(content)
            self._rows[drive.joint].show(drive, None if joint is None else joint.position)


class _Row:
    """Row of one drive, with buttons and a slider for the target of the current mode."""

    def __init__(self, context: PanelContext, drive: DriveTarget) -> None:
        self._context, self._client = context, ui.context.client
        self._drive, self._shown = drive, "-"
        self._position: float | None = None
        self._slider: ui.slider | None = None
        with ui.element("div").classes("cc-drive cc-target"):
            with ui.element("b"):
                ui.label(drive.joint)
            with ui.element("div").classes("cc-acts"):
                for label, action, color in _ACTIONS:
                    button = ui.button(label, color=color, on_click=partial(self._act, label, action))
                    button.props("unelevated dense").props(f'aria-label="{label} {drive.joint}"')
                    if action == "enable":
                        self.enable = EnableButton(button, color, allowed=context.teleop)
                self._mode = ui.select(list(MODES), on_change=lambda event: self._choose(event.value))
                self._mode.props(f'dense options-dense aria-label="mode of {drive.joint}"').set_enabled(context.teleop)
            self._body = ui.element("div").classes("cc-body")

    def show(self, drive: DriveTarget, position: float | None) -> None:
        """Update the row; the slider is rebuilt if the quantity of the target has changed."""
        self._drive, self._position = drive, position
        if self._mode.value != (drive.mode or None):
            self._mode.value = drive.mode or None
        if drive.quantity != self._shown:
            self._shown = drive.quantity
            self._context.release(self._client.id)
            self._body.clear()
            with self._body:
                self._build(drive)
        self._body.classes(**{"remove" if drive.enabled else "add": "cc-off"})

    def _build(self, drive: DriveTarget) -> None:
        self._slider = None
        if not self._context.teleop:
            return
        if not drive.quantity:
            ui.html(_NO_MODE, sanitize=False)
            return
        end = LARGEST[drive.quantity]
        here = self._position if drive.quantity == "position" and self._position is not None else 0.0
        hold_buttons(self._context, [HoldButton("target", _SHOWS[drive.quantity])], lambda _key: self._motion())
        most = ui.number("up to", value=end, min=0.0, max=_MAX, on_change=lambda event: self._stretch(event.value))
        most.props(f'dense aria-label="end of the slider of {drive.joint}"')
        self._slider = value_slider(f"target, {drive.unit}", -end, end, end / 200, min(max(here, -end), end))

    def _stretch(self, end: float | None) -> None:
        """Set the range of the slider from -`end` to `end`."""
        if self._slider is None or not end or not 0.0 < end <= _MAX:
            return
        self._slider.props(f"min={-end} max={end} step={end / 200}")
        self._slider.value = min(max(float(self._slider.value), -end), end)

    def _motion(self) -> TeleopCommands | None:
        drive, slider = self._drive, self._slider
        if slider is None or not drive.quantity:
            return None
        resting = self._position if drive.quantity == "position" else 0.0
        if resting is None:
            return None  # the position is unknown
        return joint_motion(drive.controller, [float(slider.value)], [resting], drive.quantity)

    async def _act(self, label: str, action: str) -> None:
        await self._ask(label, self._request(action))

    def _request(self, action: str, mode: str | None = None) -> AxisRequest:
        drive = self._drive
        return AxisRequest(action=action, node=drive.node, joint=drive.joint, mode=mode, source=SOURCE)

    async def _choose(self, mode: str | None) -> None:
        if mode and mode != self._drive.mode:
            await self._ask(f"mode {mode}", self._request("mode", mode))

    async def _ask(self, title: str, request: AxisRequest) -> None:
        refused = await self._context.ask(request)
        if refused is not None:
            show_notice(f"{self._drive.joint}: {title}", refused)
