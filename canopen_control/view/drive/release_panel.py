"""Whether a node may be written as a whole: without torque, and taken out of its robot; and the way there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from nicegui import ui

from canopen_control.rpc.messages.robot import NmtRequest
from canopen_control.view.dead_man import SOURCE
from canopen_control.view.panels.panel import Html, tell
from canopen_control.view.words import BAD, GOOD, IDLE, WARN, sentence

if TYPE_CHECKING:
    from canopen_control.rpc.messages.state import NodeReading
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.words import Banner

__all__ = ["ReleasePanel", "release_words"]

_CONFIRMED: Final = ("PRE_OPERATIONAL", "STOPPED")  # the NMT states that a node is taken out by
_TORQUE: Final = ("OPERATION_ENABLED", "QUICK_STOP_ACTIVE", "FAULT_REACTION_ACTIVE")


class ReleasePanel:
    """Says what the robot does with the node, takes it out, and gives it back."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context = context
        self._words = Html()
        with ui.element("div").classes("cc-row cc-acts"):
            self._take = ui.button("Take it out of the robot", color="blue-grey-8", on_click=self._take_out)
            self._give = ui.button("Give it back", color="green-8", on_click=self._give_back)
        self._take.props("unelevated dense")
        self._give.props("unelevated dense")
        self._take.visible = self._give.visible = False

    def show(self, content: PageContent) -> None:
        """Follow what the robot says of the node."""
        reading = self._context.reading(content)
        words, tone = release_words(reading, content.banner)
        self._words.show(sentence(words, tone))
        out = reading is not None and reading.taken_out
        powered = reading is not None and any(axis.state in _TORQUE for axis in reading.axes)
        free = self._context.panel.teleop and reading is not None and not self._context.desk.busy
        self._take.visible, self._give.visible = not out, out
        self._take.set_enabled(free and not powered)
        self._give.set_enabled(free)

    async def _take_out(self) -> None:
        await self._ask("preop", "not taken out")

    async def _give_back(self) -> None:
        await self._ask("start", "not given back")

    async def _ask(self, command: str, problem: str) -> None:
        request = NmtRequest(command=command, node=self._context.node, source=SOURCE)
        refused = await self._context.panel.ask(request)
        if refused is not None:
            tell(f"{self._context.node}: {problem}", refused)


def release_words(reading: NodeReading | None, robot: Banner) -> tuple[str, str]:
    """Say whether a node may be written as a whole, and with which tone; `robot` is how the robot as a whole is."""
    if reading is None:
        return "No connection: nobody knows what the drive does.", WARN
    powered = [axis.joint for axis in reading.axes if axis.state in _TORQUE]
    if powered:
        names = ", ".join(powered)
        return f"{names} is enabled: parameter sets cannot be written to an enabled drive. Disable it first.", WARN
    if not reading.taken_out:
        return "The robot controls this node. To write into it as a whole, take it out first.", IDLE
    state = (reading.nmt_state or "unknown").replace("_", "-").lower()
    if reading.age is None or reading.nmt_state not in _CONFIRMED:
        return f"It was asked to leave the robot, and has not confirmed that: its NMT state is {state}.", WARN
    if robot.tone == BAD and robot.action == "fault-reset":
        return f"It is taken out of the robot ({state}), and the robot is in fault: {robot.cause}", BAD
    return "It is taken out of the robot, which leaves it alone until it is given back.", GOOD
