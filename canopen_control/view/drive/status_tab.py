"""The Status tab: what the node is and does, the bits of its statusword, its errors, and a target that is held."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Final

from nicegui import background_tasks, ui

from canopen_control.errors import CanopenError, ConfigError
from canopen_control.service.drive_faults import error_history
from canopen_control.service.object_bits import statusword_bits
from canopen_control.view.panels.panel import Html
from canopen_control.view.panels.power import PowerPanel
from canopen_control.view.panels.target_panel import TargetPanel
from canopen_control.view.words import BAD, event_log, sentence

if TYPE_CHECKING:
    from collections.abc import Iterator

    from canopen_control.rpc.messages.state import AxisReading, NodeReading
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent

__all__ = ["StatusTab"]

_NO_ERRORS: Final = "<p class='cc-note'>The drive remembers no error.</p>"
_GONE: Final = "<p class='cc-note'>Nobody knows.</p>"


class StatusTab:
    """Shows the node as the robot knows it; its error history is read once, and again when somebody asks for it."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._client = context, ui.context.client
        self._drives: TargetPanel | None = None
        with ui.element("div").classes("cc-tab-columns"):
            with ui.element("section").classes("cc-panel"):
                ui.html("State", sanitize=False, tag="h2")
                self._facts = Html("cc-stale")
                self._power = PowerPanel(context.panel, context.node) if context.place.axes else None
            with ui.element("section").classes("cc-panel") as bits:
                ui.html("Statusword", sanitize=False, tag="h2")
                self._bits = Html("cc-stale")
            bits.visible = bool(context.place.axes)
            with ui.element("section").classes("cc-panel"):
                ui.html("Teleop by target: hold a button", sanitize=False, tag="h2")
                self._drives = TargetPanel(context.panel, context.node)
            with ui.element("section").classes("cc-panel"):
                ui.html("Controlled by", sanitize=False, tag="h2")
                self._who = Html("cc-stale")
            with ui.element("section").classes("cc-panel"):
                ui.html("Error history (0x1003)", sanitize=False, tag="h2")
                self._errors = Html()
                ui.button("Read again", color="blue-grey-6", on_click=self._read).props("outline dense")
            with ui.element("section").classes("cc-panel"):
                ui.html("Events of this node, newest first", sanitize=False, tag="h2")
                self._events = Html("cc-log")
        background_tasks.create(self._read(), name="errors")

    def show(self, content: PageContent) -> None:
        """Show what is known now."""
        reading = self._context.reading(content)
        if reading is not None:
            self._facts.show(facts_table(reading))
            self._bits.show("".join(_bits(axis) for axis in reading.axes) or _GONE)
            self._who.show(_movers(content, reading))
        if self._power is not None:
            self._power.show(content)
        if self._drives is not None:
            self._drives.show(content)
        self._events.show(event_log(each for each in content.events if each.node == self._context.node))

    def leave(self) -> None:
        """End what is driven from here."""
        self._context.panel.let_go(self._client.id)

    async def _read(self) -> None:
        try:
            found = await self._context.desk.ask(error_history)
        except ConfigError as error:  # a drive need not have one
            self._errors.show(sentence(str(error)))
            return
        except CanopenError as error:
            self._errors.show(sentence(str(error), BAD))
            return
        self._errors.show("".join(f"<p class='cc-line'>{escape(each)}</p>" for each in found) or _NO_ERRORS)


def facts_table(reading: NodeReading) -> str:
    """Return what the robot knows of a node, as HTML."""
    lines = "".join(f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in _facts(reading))
    return f"<table class='cc-table cc-known'>{lines}</table>"


def _facts(reading: NodeReading) -> Iterator[tuple[str, str]]:
    yield "node", f"{reading.node_id} on {reading.bus}" if reading.bus else str(reading.node_id)
    taken = ", taken out of the robot" if reading.taken_out else ""
    yield "NMT", f"{(reading.nmt_state or 'unknown').replace('_', '-').lower()}{taken}"
    for axis in reading.axes:
        name = axis.joint if len(reading.axes) > 1 else "drive"
        yield name, f"{(axis.state or 'unknown').replace('_', ' ').lower()}, mode {axis.mode or '-'}"
    yield "last seen", "never" if reading.age is None else f"{reading.age:.2f} s ago" if reading.age >= 0.25 else "live"
    counts = reading.sdo
    yield "SDO", f"{counts.reads} reads, {counts.writes} writes, {counts.failed} failed"
    for error in dict.fromkeys(filter(None, (reading.error, *(axis.error for axis in reading.axes)))):
        yield "error", error


def _bits(axis: AxisReading) -> str:
    """Return the bits of a statusword as HTML."""
    if axis.statusword is None:
        return _GONE
    bits = "".join(
        f"<span class='{'cc-set' if each.on else ''}'>{each.bit} {escape(each.name)}</span>"
        for each in statusword_bits(axis.statusword, axis.mode)
    )
    return f"<p class='cc-note'>{escape(axis.joint)}: 0x{axis.statusword:04X}</p><div class='cc-bits'>{bits}</div>"


def _movers(content: PageContent, reading: NodeReading) -> str:
    """Say which controllers command the node's joints, as HTML."""
    joints = {axis.joint for axis in reading.axes}
    active = [each for each in content.controllers if each.state == "active"]
    names = [each.name for each in active if any(claim.rpartition("/")[0] in joints for claim in each.claims)]
    if not reading.axes:
        return sentence("It is no drive: nothing moves it.")
    if not names:
        return sentence("No active controller commands it.")
    return sentence(f"{', '.join(names)} command{'s' if len(names) == 1 else ''} it; the page drives through it.")
