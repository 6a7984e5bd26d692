"""Protocols for panels and their context; common HTML, notices and sliders.

Text within HTML has already been escaped by the functions of `words`.
"""

from __future__ import annotations

import contextlib
from html import escape
from typing import TYPE_CHECKING, Any, Final, Protocol

from nicegui import ui

from canopen_control.view.elements.nicegui_elements import HoldButton, HoldButtons

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from nicegui.element import Element

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.robot_connection import TeleopCommands
    from canopen_control.view.robot_view import RobotView
    from canopen_control.view.trajectory_player import TrajectoryPlayer


class PanelContext(Protocol):
    """Access to the robot for the panels of a page; implemented by `view_app.ViewApp`."""

    teleop: bool

    @property
    def robot(self) -> RobotView:
        """Data of the robot that all pages share."""
        ...

    @property
    def player(self) -> TrajectoryPlayer:
        """Player of trajectories, shared by all pages."""
        ...

    async def ask(self, request: Request[Any]) -> str | None:
        """Send a request to the robot and wait; return the reason for a failure, or None on success."""
        ...

    def hold(self, page: str, motion: TeleopCommands, on_refusal: Callable[[str], None]) -> None:
        """Start or renew the motion of a held button; `on_refusal` receives a sentence if another page drives."""
        ...

    def release(self, page: str) -> None:
        """End the motion that the held button of a page commands, without waiting for the timeout."""
        ...

    def refresh_faults(self) -> None:
        """Request the faults of all virtual drives, which a later `show` displays."""
        ...


class Panel(Protocol):
    """Part of a page, created once and then updated a few times a second; listed in `view_app.PANELS`."""

    def __init__(self, context: PanelContext) -> None: ...

    def show(self, content: PageContent) -> None:
        """Update the widgets; unchanged widgets are not sent again."""
        ...


class Html:
    """Element with HTML content, initially empty."""

    def __init__(self, classes: str = "") -> None:
        self._html = ""
        self._element = ui.html("", sanitize=False).classes(classes)

    def show(self, html: str) -> None:
        """Set the HTML content; unchanged content is not sent again."""
        if html != self._html:
            self._html = html
            self._element.content = html


@contextlib.contextmanager
def section(title: str) -> Iterator[Element]:
    """Create a section with a heading, in which the widgets of the `with` block are placed."""
    with ui.element("section").classes("cc-panel") as whole:
        ui.html(escape(title), sanitize=False, tag="h2")
        yield whole


def show_notice(title: str, text: str) -> None:
    """Show an error notice on the page of the user who sent the request."""
    ui.notify(f"{title}: {text}", type="negative", position="top", timeout=12_000, multi_line=True, close_button="OK")


# Widgets of panels that drive: a slider with its value, and buttons that drive while they are held.
#
# The panel decides what a held button sends; the dead-man control of the view ends it.


LARGEST: Final = {"velocity": 10.0, "position": 3.14, "effort": 1.0}
"""Ends of a slider by quantity if no limit is known, in rad/s, rad, and the unit of efforts."""
READ_ONLY: Final = (
    "<p class='cc-note'>This page is read-only. To drive, start <code>canopen-control view --teleop</code></p>"
)


def value_slider(label: str, low: float, high: float, step: float, value: float) -> ui.slider:
    """Create a slider, with a label before it and the current value after it."""
    with ui.element("div").classes("cc-slider"):
        ui.label(label)
        slider = ui.slider(min=low, max=high, step=step, value=value).props(f'dense aria-label="{label}"')
        ui.label().bind_text_from(slider, "value", lambda at: f"{float(at or 0.0):.2f}")
    return slider


def hold_buttons(
    context: PanelContext, buttons: Sequence[HoldButton], motion: Callable[[str], TeleopCommands | None], kind: str = ""
) -> HoldButtons:
    """Create buttons that command `motion(key)` repeatedly while held; the dead-man control ends the motion."""
    client = ui.context.client

    def on_end(why: str) -> None:
        with client:
            show_notice("Not driven", why)

    def hold(key: str) -> None:
        command = motion(key)
        if command is not None:
            context.hold(client.id, command, on_end)

    return HoldButtons(list(buttons), hold, lambda: context.release(client.id), kind)
