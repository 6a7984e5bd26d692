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

__all__ = ["PowerPanel"]

#: what the button says, what the runtime calls it, and its colour
_ACTIONS: Final = (
    ("Enable", "enable", "green-8"),
    ("Disable", "disable", "blue-grey-6"),
    ("Reset fault", "fault-reset", "blue-grey-6"),
)


class PowerPanel:
    """A row of buttons for each drive, and one for all of them; of `node` alone, where one is named."""

    def __init__(self, context: PanelContext, node: str = "") -> None:
        self._context = context
        nodes = context.robot.info.state.nodes
        drives = [name for name, each in nodes.items() if each.axes and node in ("", name)]
        if not drives:
            ui.html("<p class='cc-note'>No drives to enable.</p>", sanitize=False)
        for drive in [*(("all",) if len(drives) > 1 else ()), *drives]:
            self._row(drive)

    def show(self, content: PageContent) -> None:
        """Leave it: nothing here changes with the state."""

    def _row(self, drive: str) -> None:
        with ui.element("div").classes("cc-drive cc-acts"):
            with ui.element("b"):
                ui.label("all drives" if drive == "all" else drive)
            with ui.element("div"):
                for label, action, color in _ACTIONS:
                    outline = "unelevated dense" if drive == "all" else "outline dense"
                    button = ui.button(label, color=color, on_click=partial(self._act, drive, action, label))
                    button.props(outline).props(f'aria-label="{label}"')

    async def _act(self, drive: str, action: str, label: str) -> None:
        refused = await self._context.ask(AxisRequest(action=action, node=drive, source=SOURCE))
        if refused is not None:
            tell(f"{drive}: {label.lower()}", refused)
