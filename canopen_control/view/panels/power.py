"""Enable, disable and reset: all drives, and each of them."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.rpc.messages.robot import AxisRequest
from canopen_control.view.dead_man import SOURCE
from canopen_control.view.panels.panel import tell

if TYPE_CHECKING:
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext

__all__ = ["EnableButton", "PowerPanel"]

#: what the button says, what the runtime calls it, and its colour
_ACTIONS: Final = (
    ("Enable", "enable", "green-8"),
    ("Disable", "disable", "blue-grey-6"),
    ("Reset fault", "fault-reset", "blue-grey-6"),
)


_LATCHED: Final = "STOP is latched: release it first, then enable."


class PowerPanel:
    """A row of buttons for each drive, and one for all of them; of `node` alone, where one is named.

    Enable is grey while STOP is latched, and says so: the robot would refuse.
    """

    def __init__(self, context: PanelContext, node: str = "") -> None:
        self._context = context
        self._enable: list[EnableButton] = []
        nodes = context.robot.info.state.nodes
        drives = [name for name, each in nodes.items() if each.axes and node in ("", name)]
        if not drives:
            ui.html("<p class='cc-note'>No drives to enable.</p>", sanitize=False)
        for drive in [*(("all",) if len(drives) > 1 else ()), *drives]:
            self._row(drive)

    def show(self, content: PageContent) -> None:
        """Follow the latch."""
        for button in self._enable:
            button.show(content)

    def _row(self, drive: str) -> None:
        with ui.element("div").classes("cc-drive cc-acts"):
            with ui.element("b"):
                ui.label("all drives" if drive == "all" else drive)
            with ui.element("div"):
                for label, action, color in _ACTIONS:
                    outline = "unelevated dense" if drive == "all" else "outline dense"
                    button = ui.button(label, color=color, on_click=partial(self._act, drive, action, label))
                    button.props(outline).props(f'aria-label="{label}"')
                    if action == "enable":
                        self._enable.append(EnableButton(button, color))

    async def _act(self, drive: str, action: str, label: str) -> None:
        refused = await self._context.ask(AxisRequest(action=action, node=drive, source=SOURCE))
        if refused is not None:
            tell(f"{drive}: {label.lower()}", refused)


class EnableButton:
    """A button that enables: grey and closed while STOP is latched, else in its `color`; `allowed` as far as may be."""

    def __init__(self, button: ui.button, color: str, *, allowed: bool = True) -> None:
        self._button, self._color, self._allowed = button, color, allowed
        self._latched: bool | None = None
        with button:
            self._why = ui.tooltip(_LATCHED)

    def show(self, content: PageContent) -> None:
        """Follow the latch; nothing is sent while it stays as it is."""
        latched = content.state.latched
        if latched is not self._latched:
            self._latched = latched
            self._button.props(f"color={'grey-5' if latched else self._color}")
            self._button.set_enabled(self._allowed and not latched)
            self._why.visible = latched
