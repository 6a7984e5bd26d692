"""STOP, its release, and what is done to each drive.

The law of this file: STOP is never disabled, hidden or queued behind anything: its callback runs in the server's own
loop and only writes to a socket. Whatever is refused comes back to the page that asked, in the runtime's own words.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Protocol

from canopen_control.errors import CanopenError
from canopen_control.view.style import ICONS, STOP_COLOR

if TYPE_CHECKING:
    from collections.abc import Sequence

    import viser

__all__ = ["DriveControls", "Robot", "StopControls", "tell"]

ACTIONS: Final = {"Enable": "enable", "Disable": "disable", "Reset fault": "fault-reset"}
_HINT: Final = "Ramps every joint to zero, disables the drives, stays latched (space bar)"
_SECONDS: Final = 12.0  # a notice is read by then


class Robot(Protocol):
    """What a page may do to the robot; see `link.Link`."""

    def stop(self) -> None:
        """STOP, latched, at once; CanopenError if it cannot be reached."""
        ...

    def ask(self, method: str, params: dict[str, Any]) -> str | None:
        """Ask and wait; the reason if it was not done."""
        ...


def tell(client: viser.ClientHandle | None, title: str, text: str) -> None:
    """Show a notice on the page that asked, if it is still there."""
    if client is not None:
        client.add_notification(title, text, color="red", auto_close_seconds=_SECONDS)


class StopControls:
    """The large button, and the one that lets go, which is there while STOP is latched."""

    def __init__(self, gui: viser.GuiApi, robot: Robot) -> None:
        self._robot = robot
        stop = gui.add_button("STOP", icon=ICONS["stop"], color=STOP_COLOR, hint=_HINT)
        self._release = gui.add_button("Release STOP", icon=ICONS["release"], color=(176, 116, 0), visible=False)
        command = gui.add_command("STOP", description="Stop everything, latched", hotkey="space", icon=ICONS["stop"])

        @stop.on_click
        async def _(event: viser.GuiEvent[Any]) -> None:
            self._stop(event.client)

        @command.on_trigger
        async def _(event: viser.CommandEvent) -> None:
            self._stop(event.client)

        @self._release.on_click
        def _(event: viser.GuiEvent[Any]) -> None:
            refused = robot.ask("release", {})
            if refused is not None:
                tell(event.client, "Not released", refused)

    def show(self, *, latched: bool) -> None:
        """Show how to go on."""
        if self._release.visible is not latched:
            self._release.visible = latched

    def _stop(self, client: viser.ClientHandle | None) -> None:
        try:
            self._robot.stop()
        except CanopenError as error:
            tell(client, "STOP has not reached the robot", str(error))


class DriveControls:
    """A row of buttons for each drive, and one for all of them."""

    def __init__(self, gui: viser.GuiApi, robot: Robot, drives: Sequence[str]) -> None:
        self._robot = robot
        if not drives:
            return
        with gui.add_folder("Drives"):
            for drive in [*(("all",) if len(drives) > 1 else ()), *drives]:
                buttons = gui.add_button_group(drive, tuple(ACTIONS))
                buttons.on_click(self._act(drive))

    def _act(self, drive: str) -> Any:  # noqa: ANN401 - a callback of viser
        def act(event: viser.GuiEvent[Any]) -> None:
            refused = self._robot.ask("axis", {"action": ACTIONS[event.target.value], "node": drive})
            if refused is not None:
                tell(event.client, f"{drive}: {event.target.value.lower()}", refused)

        return act
