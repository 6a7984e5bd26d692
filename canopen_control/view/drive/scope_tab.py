"""Scope tab: plots up to eight objects and joint values over time."""

from __future__ import annotations

import base64
import csv
import tempfile
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from nicegui import background_tasks, ui

from canopen_control.commissioning.jobs import ScopeOptions
from canopen_control.commissioning.scope_capture import Condition, csv_of, parse_csv, write_bag
from canopen_control.commissioning.scope_run import ScopeRun
from canopen_control.commissioning.scope_signals import MAX_SIGNALS
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.rpc.messages.health import BAD, GOOD, IDLE
from canopen_control.view.elements.nicegui_elements import FileUpload
from canopen_control.view.panels.panel import Html, section, show_notice
from canopen_control.view.robot_connection import in_thread
from canopen_control.view.scope_chart import chart_options, cursor_change, height_of
from canopen_control.view.words import sentence

if TYPE_CHECKING:
    from nicegui.events import UploadEventArguments

    from canopen_control.commissioning.scope_capture import NamedShot
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.view.drive.drive_tab import DriveTabContext
    from canopen_control.view.page_content import PageContent


_NONE, _FAULT = "none", Condition.FAULT.value
_TRIGGERS: Final = {
    _NONE: "immediate",
    Condition.RISING.value: "rises through",
    Condition.FALLING.value: "falls through",
    Condition.ABOVE.value: "is above",
    Condition.BELOW.value: "is below",
    _FAULT: "fault occurs",
}
_FIRST: Final = (0x606C, 0x6064)  # initial selection: actual velocity and position (CiA 402)
_LIMITS: Final = (0.05, 600.0)  # limits of the length of a capture in s
_STEPS: Final = 1000  # positions of a cursor
_RATE: Final = 1000.0  # Hz, for polled objects; a robot may limit the rate further
_MAX_BYTES: Final = 16_000_000  # maximum size of an overlay file


class ScopeTab:
    """Tab that starts a scope for the node and shows its captures; the scope continues when the page is closed."""

    def __init__(self, context: DriveTabContext) -> None:
        self._context, self._node_jobs, self._client = context, context.node_jobs, ui.context.client
        self._shown: NamedShot | None = None
        self._overlay: NamedShot | None = None
        self._last_shown: tuple[ScopeRun | None, int] = (None, 0)
        with section("Signals"):
            self._make_form()
            self._state = Html()
        with ui.element("section").classes("cc-panel cc-scope") as self._picture:
            self._chart = ui.echart({}).classes("cc-scope-chart")
            self._make_cursors()
            self._make_files()
        self._picture.visible = False
        background_tasks.create(self._list_signals(), name="signals")

    def _make_form(self) -> None:
        self._signals = ui.select([], multiple=True, value=[], with_input=True, label=f"signals, {MAX_SIGNALS} at most")
        self._signals.props(f"dense use-chips options-dense max-values={MAX_SIGNALS}").style("width: 100%")
        self._signals.on_value_change(lambda _event: self._list_places())
        with ui.element("div").classes("cc-row cc-wish"):
            self._length = ui.number("length, s", value=2.0, min=_LIMITS[0], max=_LIMITS[1], step=0.5).props("dense")
            self._trigger = ui.select(_TRIGGERS, value=_NONE, label="trigger").props("dense options-dense")
            self._trigger.on_value_change(lambda _event: self._arrange())
            self._place = ui.select([], label="signal").props("dense options-dense")
            self._level = ui.number("level", value=0.0).props("dense")
            self._before = ui.number("before the trigger, s", value=0.4, min=0.0, step=0.1).props("dense")
        with ui.element("div").classes("cc-row cc-acts"):
            self._single = ui.button("Single", color="blue-9", on_click=lambda: self._begin(rolling=False))
            self._rolling = ui.button("Rolling", color="blue-9", on_click=lambda: self._begin(rolling=True))
            self._end = ui.button("Abort", color="blue-grey-8", on_click=self._end_it)
            for button in (self._single, self._rolling, self._end):
                button.props("unelevated dense")
        self._arrange()

    def _make_cursors(self) -> None:
        with ui.element("div").classes("cc-slider"):
            ui.label("cursors")
            self._range = ui.range(min=0, max=_STEPS, step=1, value={"min": 200, "max": 800})
            self._range.props('dense aria-label="cursors" color=blue-grey-9')
            self._range.on_value_change(lambda _event: self._move_cursors())
        self._readings = Html("cc-wide")

    def _make_files(self) -> None:
        with ui.element("div").classes("cc-row cc-acts"):
            for title, act in (("CSV", self._save_csv), ("PNG", self._save_png), ("MCAP", self._save_bag)):
                ui.button(title, color="blue-grey-8", on_click=act).props("outline dense")
            self._keep = ui.button("Keep as overlay", color="blue-grey-8", on_click=self._keep_overlay)
            self._drop = ui.button("Drop the overlay", color="blue-grey-8", on_click=self._drop_overlay)
            for button in (self._keep, self._drop):
                button.props("outline dense")
        self._drop.visible = False
        too_long = f"the CSV must have at most {_MAX_BYTES} bytes"
        self._upload = FileUpload(
            "Overlay a CSV", self._take_overlay, lambda: show_notice("Not read", too_long), _MAX_BYTES
        )
        self._upload.props("accept='.csv'")

    async def _list_signals(self) -> None:
        """List the numeric objects of the node and the joints of the robot as selectable signals."""
        try:
            od = await in_thread(self._node_jobs.dictionary)
        except CanopenError as error:
            self._state.show(sentence(str(error), BAD))
            return
        offered = signals_of(od, self._context.node)
        joints = sorted(
            self._context.panel.robot.state.joints, key=lambda joint: joint not in self._context.place.joints
        )
        offered |= {
            f"{joint}:{name}": f"{joint} {name}" for joint in joints for name in ("position", "velocity", "command")
        }
        run = self._node_jobs.scope
        first = [f"{self._context.node}:0x{index:04X}:00" for index in _FIRST]
        chosen = list(run.texts) if run is not None else [signal for signal in first if signal in offered]
        with self._client:
            self._signals.set_options(offered, value=[signal for signal in chosen if signal in offered])
        self._list_places()

    def _list_places(self) -> None:
        """Offer the chosen signals as trigger sources."""
        options: Any = self._signals.options
        names = {number + 1: str(options[value]) for number, value in enumerate(self._signals.value or [])}
        self._place.set_options(
            names, value=self._place.value if self._place.value in names else next(iter(names), None)
        )

    def _arrange(self) -> None:
        has_level = self._trigger.value not in (_NONE, _FAULT)
        self._place.visible = self._level.visible = has_level
        self._before.visible = self._trigger.value != _NONE

    # ------------------------------------------------------------------------------------ calls of the frame

    def show(self, content: PageContent) -> None:
        run = self._node_jobs.scope
        running = run is not None and not run.over
        for button in (self._single, self._rolling):
            button.set_enabled(not running and not content.lost)
        self._end.set_enabled(running)
        if run is None:
            return
        tone = IDLE if running else GOOD if run.good else BAD
        self._state.show(sentence(run.words if not running else f"{run.words}; {run.captures} taken", tone))
        if (run, run.captures) != self._last_shown and run.shots:
            self._last_shown = run, run.captures
            self._draw(run.shots[-1])

    def leave(self) -> None:
        """Do nothing, because the scope waits for its trigger even if no page is open."""

    # ------------------------------------------------------------------------------------ what the user does

    def _begin(self, *, rolling: bool) -> None:
        if self._node_jobs.scope is not None and not self._node_jobs.scope.over:
            return
        try:
            self._node_jobs.scope = ScopeRun(self._node_jobs, self._signals.value or [], self._options(rolling=rolling))
        except ConfigError as error:
            self._state.show(sentence(str(error), BAD))
            return
        self._node_jobs.scope.start()

    def _options(self, *, rolling: bool) -> ScopeOptions:
        kind = str(self._trigger.value)
        trigger = {_NONE: "", _FAULT: _FAULT}.get(kind, f"{self._place.value}:{kind}:{self._level.value or 0.0}")
        length = min(max(float(self._length.value or 0.0), _LIMITS[0]), _LIMITS[1])
        before = float(self._before.value or 0.0) if trigger else None
        return ScopeOptions(_RATE, length, trigger, before, rolling=rolling)

    def _end_it(self) -> None:
        if self._node_jobs.scope is not None:
            self._node_jobs.scope.end()

    def _keep_overlay(self) -> None:
        self._overlay = self._shown
        self._drop.visible = True
        self._state.show(sentence("kept as overlay for the next captures", GOOD))

    async def _take_overlay(self, event: UploadEventArguments) -> None:
        """Read a saved CSV file and draw it behind the capture."""
        self._upload.reset()
        name = event.file.name
        try:
            overlay = read_overlay(await event.file.read(), name, self._shown)
        except ConfigError as error:
            show_notice("Not read", str(error))
            return
        self._overlay, self._drop.visible = overlay, True
        if self._shown is not None:
            self._draw(self._shown)

    def _drop_overlay(self) -> None:
        self._overlay, self._drop.visible = None, False
        if self._shown is not None:
            self._draw(self._shown)

    # ------------------------------------------------------------------------------------ the picture

    def _draw(self, named: NamedShot) -> None:
        self._shown, self._picture.visible = named, True
        overlay = self._overlay if self._overlay is not named else None
        self._chart.style(f"height: {height_of(named)}px")
        self._chart.options.clear()
        self._chart.options.update(chart_options(named, overlay, self._cursors(named)))
        self._chart.update()
        self._show_cursors(named)

    def _cursors(self, named: NamedShot) -> tuple[float, float]:
        low, high = named.shot.time_range
        value = self._range.value
        return low + (high - low) * value["min"] / _STEPS, low + (high - low) * value["max"] / _STEPS

    def _move_cursors(self) -> None:
        if (named := self._shown) is not None:
            self._chart.run_chart_method("setOption", cursor_change(named, self._cursors(named)))
            self._show_cursors(named)

    def _show_cursors(self, named: NamedShot) -> None:
        self._readings.show(cursor_table(named, self._cursors(named)))

    # ------------------------------------------------------------------------------------ files

    def _save_csv(self) -> None:
        if self._shown is not None:
            ui.download.content(csv_of(self._shown).encode(), f"{self._context.node}.csv")

    async def _save_png(self) -> None:
        """Save the chart as a PNG as shown in the browser, with zoom and cursors."""
        options = {"type": "png", "pixelRatio": 2, "backgroundColor": "#ffffff"}
        try:
            address = await self._chart.run_chart_method("getDataURL", options, timeout=5.0)
        except TimeoutError:
            address = ""
        head, _, data = str(address).partition(",")
        if head != "data:image/png;base64":
            show_notice("Not saved", "the browser has not drawn the chart")
            return
        ui.download.content(base64.b64decode(data), f"{self._context.node}.png")

    async def _save_bag(self) -> None:
        run, named = self._node_jobs.scope, self._shown
        if run is None or named is None:
            return

        def written() -> bytes:
            with tempfile.TemporaryDirectory(prefix="canopen-control-scope-") as folder:
                place = Path(folder) / "scope"
                write_bag(place, named.shot, run.signals)
                return next(place.glob("*.mcap")).read_bytes()

        try:
            data = await in_thread(written)
        except CanopenError as error:
            show_notice("Not saved", str(error))
            return
        ui.download.content(data, f"{self._context.node}.mcap")


def read_overlay(data: bytes, name: str, shown: NamedShot | None) -> NamedShot:
    """Parse a saved capture; raise ConfigError if the file is invalid or contains none of the shown signals."""
    try:
        overlay = parse_csv(data.decode("utf-8-sig"), name)
    except (UnicodeDecodeError, csv.Error):
        raise ConfigError(f"{name} is not a text file; choose a CSV file that was saved by a scope") from None
    if shown is not None and not any(overlay.place(signal_name) is not None for signal_name in shown.names):
        raise ConfigError(f"{name} has the signals {', '.join(overlay.names)}, but none of {', '.join(shown.names)}")
    return overlay


def signals_of(od: ObjectDictionary | None, node: str) -> dict[str, str]:
    """Return a label for each readable numeric object of a node, by signal text; empty without an EDS."""
    if od is None:
        return {}
    return {
        f"{node}:0x{entry.index:04X}:{entry.subindex:02X}": (
            f"0x{entry.index:04X}{f':{entry.subindex:02X}' if entry.subindex else ''} {entry.name}"
        )
        for entry in od
        if entry.readable and (entry.data_type.is_integer or entry.data_type.is_real)
    }


def cursor_table(named: NamedShot, cursors: tuple[float, float]) -> str:
    """Return an HTML table with each signal's values at the two cursors, their difference, and the RMS between them."""
    first, second = cursors
    apart = second - first
    often = f" ({1 / apart:.4g} Hz)" if apart else ""
    rows = []
    for place, name in enumerate(named.names):
        read = named.shot.cursors(place, first, second)
        values = [] if read is None else [read.first, read.second, read.difference, read.rms]
        cells = "".join(f"<td>{value:.6g}</td>" for value in values) or "<td>-</td>" * 4
        unit = named.units[place] if place < len(named.units) else ""
        rows.append(f"<tr><td>{escape(name)}</td>{cells}<td>{escape(unit)}</td></tr>")
    heads = "".join(
        f"<th>{title}</th>" for title in ("signal", f"at {first:.4f} s", f"at {second:.4f} s", "dv", "RMS", "")
    )
    return (
        f"<p class='cc-line'>dt {apart:.6g} s{often}</p><table class='cc-table'><tr>{heads}</tr>{''.join(rows)}</table>"
    )
