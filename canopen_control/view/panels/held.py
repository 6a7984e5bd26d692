"""Widgets of panels that drive: a slider with its value, and buttons that drive while they are held.

What a held button sends is the panel's to say; that it ends, the page's dead man's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.view.elements.nicegui_elements import HoldButton, HoldButtons
from canopen_control.view.panels.panel import tell

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from canopen_control.view.dead_man import Motion
    from canopen_control.view.panels.panel import PanelContext

__all__ = ["LARGEST", "LOOK", "hold_buttons", "value_slider"]

LARGEST: Final = {"velocity": 10.0, "position": 3.14, "effort": 1.0}
"""The end of a slider where no limit is known: rad/s, rad, and the unit of efforts."""
LOOK: Final = "<p class='cc-note'>This page only looks. To drive: <code>canopen-control view --teleop</code></p>"


def value_slider(label: str, low: float, high: float, step: float, value: float) -> ui.slider:
    """Make a slider between its name and its value."""
    with ui.element("div").classes("cc-slider"):
        ui.label(label)
        slider = ui.slider(min=low, max=high, step=step, value=value).props(f'dense aria-label="{label}"')
        ui.label().bind_text_from(slider, "value", lambda at: f"{float(at or 0.0):.2f}")
    return slider


def hold_buttons(
    context: PanelContext, buttons: Sequence[HoldButton], motion: Callable[[str], Motion | None], kind: str = ""
) -> HoldButtons:
    """Make buttons that send `motion(key)` while they are held, nothing for None; the end is the page's."""
    client = ui.context.client

    def told(why: str) -> None:
        with client:
            tell("Not driven", why)

    def hold(key: str) -> None:
        wanted = motion(key)
        if wanted is not None:
            context.hold(client.id, wanted, told)

    return HoldButtons(list(buttons), hold, lambda: context.let_go(client.id), kind)
