"""Panels of a simulated robot: faults and quirks of virtual drives, inputs of virtual devices, acts on the world.

Acts are payloads, pushes and blocked joints. A panel is hidden if the robot has no virtual nodes, or no physics
simulation that accepts disturbances. The robot's events show the requests.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, Final

from nicegui import background_tasks, ui

from canopen_control.client.drive_client import signal_values
from canopen_control.errors import CanopenError, ConfigError, RemoteError
from canopen_control.rpc.messages.drive import (
    AddPayload,
    BlockJoint,
    PushRobot,
    SetGrip,
    SetSignals,
    SwitchFault,
    SwitchQuirk,
)
from canopen_control.rpc.messages.robot import PublishEvent
from canopen_control.view.panels.panel import Html, show_notice
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.words import active_faults, fault_text, quirk_text

if TYPE_CHECKING:
    from collections.abc import Callable

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import QuirkListing, WorldAct
    from canopen_control.view.page_content import DriveFaults, PageContent
    from canopen_control.view.panels.panel import PanelContext


class FaultPanel:
    """Panel that switches faults and quirks of a virtual drive, and sets the inputs of a virtual device."""

    def __init__(self, context: PanelContext) -> None:
        self._context = context
        self._board: DriveFaults | None = None
        self._whole = ui.expansion("Faults of virtual drives").props("dense").classes("cc-stale w-full")
        self._whole.set_visibility(False)
        with self._whole:
            self._drive = ui.select([], label="drive", on_change=self._follow).props("dense").style("width: 100%")
            self._fault = ui.select([], label="fault", on_change=self._explain).props("dense").style("width: 100%")
            self._text = Html()
            with ui.element("div").classes("cc-row"):
                ui.button("Switch on", color="red-8", on_click=partial(self._switch, True)).props("dense unelevated")
                ui.button("Switch off", color="blue-grey-6", on_click=partial(self._switch, False)).props(
                    "dense outline"
                )
            self._quirk = ui.select([], label="quirk", on_change=self._explain_quirk).props("dense")
            self._quirk.style("width: 100%")
            self._quirk_text = Html()
            with ui.element("div").classes("cc-row"):
                self._strength = ui.input("strength, or @AXIS").props("dense")
                ui.button("Quirk on", color="red-8", on_click=partial(self._switch_quirk, True)).props(
                    "dense unelevated"
                )
                ui.button("Quirk off", color="blue-grey-6", on_click=partial(self._switch_quirk, False)).props(
                    "dense outline"
                )
            self._inputs = ui.element("div").classes("cc-row")
            with self._inputs:
                self._signals = ui.input("inputs, as di0=1,ai0=16384").props("dense")
                ui.button("Set", color="blue-grey-6", on_click=self._set).props("dense outline")
            self._active = Html()

    def show(self, content: PageContent) -> None:
        board = content.faults
        if board is None or board == self._board:
            return
        self._board = board
        drives = list(board.drives)
        self._whole.set_visibility(bool(drives))
        _offer(self._drive, drives)
        self._follow()
        self._active.show(active_faults(board.active) if drives else "")

    def _follow(self) -> None:
        faults = self._board.drives.get(self._drive.value or "", ()) if self._board is not None else ()
        self._inputs.set_visibility(any(fault.acts == "input" for fault in faults))
        _offer(self._fault, [fault.name for fault in faults])
        quirks = [quirk.name for quirk in self._quirks()]
        self._quirk.set_visibility(bool(quirks))
        _offer(self._quirk, quirks)
        self._explain()
        self._explain_quirk()

    def _quirks(self) -> tuple[QuirkListing, ...]:
        return self._board.quirks.get(self._drive.value or "", ()) if self._board is not None else ()

    def _explain_quirk(self) -> None:
        chosen = next((quirk for quirk in self._quirks() if quirk.name == self._quirk.value), None)
        self._quirk_text.show(quirk_text(chosen))

    def _explain(self) -> None:
        faults = self._board.drives.get(self._drive.value or "", ()) if self._board is not None else ()
        self._text.show(fault_text(next((fault for fault in faults if fault.name == self._fault.value), None)))

    async def _set(self) -> None:
        try:
            request = SetSignals(values=signal_values(self._signals.value or ""))
            await in_thread(partial(self._context.robot.drives.ask, self._drive.value or "", request))
        except (ConfigError, RemoteError) as error:
            show_notice("Not set", str(error))

    async def _switch_quirk(self, on: bool) -> None:
        quirk = self._quirk.value
        strength = (self._strength.value or "").strip() if on else ""
        text = f"{quirk}{strength}" if strength.startswith(("@", "=")) or not strength else f"{quirk}={strength}"
        if quirk:
            await self._ask(SwitchQuirk(quirk=text, on=on))

    async def _switch(self, on: bool) -> None:
        if fault := self._fault.value:
            await self._ask(SwitchFault(name=fault, on=on))

    async def _ask(self, request: Request[Any]) -> None:
        drives = self._context.robot.drives
        if drive := self._drive.value:
            try:
                await in_thread(lambda: drives.ask(drive, request))
            except RemoteError as error:
                show_notice("Not switched", str(error))
            self._context.refresh_faults()


def _offer(select: ui.select, names: list[str]) -> None:
    """Set the options of a select element; the selected one remains if it is still an option."""
    if names != select.options:
        select.set_options(names, value=select.value if select.value in names else next(iter(names), None))


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
    """Return the number in a field; if the field is empty, show a notice and return None."""
    if field.value is None:
        show_notice("Not done", "a field is empty")
        return None
    return float(field.value)
