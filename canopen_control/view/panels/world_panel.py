"""Panel for disturbances of a robot in a physics simulation, such as payloads, pushes and blocked joints.

The panel is hidden if no physics simulation accepts disturbances. The robot's events show the requests.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Final

from nicegui import background_tasks, ui

from canopen_control.errors import CanopenError
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip
from canopen_control.rpc.messages.robot import PublishEvent
from canopen_control.view.panels.panel import show_notice
from canopen_control.view.robot_connection import in_thread

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.drive import WorldAct
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import PanelContext


_HEAVIEST: Final = "the heaviest link"
_BUTTON: Final = "dense unelevated"


class WorldPanel:
    """Panel with a row for each kind of disturbance; payloads and pushes act on the chosen link."""

    def __init__(self, context: PanelContext) -> None:
        self._context = context
        self._drives: frozenset[str] | None = None
        self._whole = ui.expansion("Disturb the simulated world").props("dense").classes("cc-stale w-full")
        self._whole.set_visibility(False)
        robot = context.robot
        with self._whole:
            links = [_HEAVIEST, *robot.model.links]
            self._link = ui.select(links, label="link", value=_HEAVIEST).props("dense").style("width: 100%")
            with ui.element("div").classes("cc-row"):
                self._mass = _number("kg", 5.0)
                _button("Add payload", self._payload)
            with ui.element("div").classes("cc-row"):
                self._force = [_number(f"{axis}, N", value) for axis, value in (("x", 0.0), ("y", 30.0), ("z", 0.0))]
                self._seconds = _number("s", 0.2)
                _button("Push", self._push)
            with ui.element("div").classes("cc-row"):
                joints = list(robot.info.joints)
                self._joint = ui.select(joints, label="joint", value=next(iter(joints), None)).props("dense")
                self._joint.style("min-width: 9em")
                _button("Block", partial(self._block, True))
                _button("Release", partial(self._block, False))
            with ui.element("div").classes("cc-row"):
                self._grip = _number("friction", 0.2)
                _button("Set floor friction", self._friction)

    def show(self, content: PageContent) -> None:
        drives = frozenset(content.faults.drives) if content.faults is not None else frozenset()
        if drives != self._drives:
            self._drives = drives
            background_tasks.create(self._update_visibility())

    async def _update_visibility(self) -> None:
        changeable = await in_thread(self._context.robot.world_client.changeable)
        self._whole.set_visibility(changeable)

    async def _payload(self) -> None:
        if (mass := _read(self._mass)) is not None:
            await self._act(AddPayload(mass=mass, on=self._on()), f"payload of {mass:g} kg on {self._link.value}")

    async def _push(self) -> None:
        x, y, z, seconds = (_read(widget) for widget in (*self._force, self._seconds))
        if x is None or y is None or z is None or seconds is None:
            return
        if seconds <= 0.0:
            show_notice("Not done", f"{seconds:g} s: a push needs a duration above 0")
            return
        push = PushRobot(force=(x, y, z), on=self._on(), seconds=seconds)
        await self._act(push, f"push of {x:g}, {y:g}, {z:g} N on {self._link.value} for {seconds:g} s")

    async def _block(self, on: bool) -> None:
        if joint := self._joint.value:
            await self._act(BlockJoint(joint=joint, on=on), f"{joint} {'blocked' if on else 'released'}")

    async def _friction(self) -> None:
        if (grip := _read(self._grip)) is None:
            return
        if grip < 0.0:
            show_notice("Not done", f"{grip:g}: friction cannot be negative")
            return
        await self._act(SetGrip(friction=grip), f"friction of the floor {grip:g}")

    def _on(self) -> str:
        return "" if self._link.value == _HEAVIEST else str(self._link.value)

    async def _act(self, world_act: WorldAct, text: str) -> None:
        """Apply a disturbance and publish an event, unless the robot itself reports the disturbance."""
        try:
            is_reported = await in_thread(partial(self._context.robot.world_client.act, world_act))
        except CanopenError as error:
            show_notice("Not done", str(error))
            return
        if not is_reported:
            await self._context.ask(PublishEvent(kind="world", text=f"from a page: {text}"))


def _number(label: str, value: float) -> ui.number:
    return ui.number(label, value=value).props("dense").style("width: 3.4em")


def _button(label: str, act: Callable[..., object]) -> None:
    ui.button(label, color="blue-grey-6", on_click=act).props(_BUTTON)


def _read(field: ui.number) -> float | None:
    """Return the number in a field; None, with a notice, if the field is empty."""
    if field.value is None:
        show_notice("Not done", "a field is empty")
        return None
    return float(field.value)
