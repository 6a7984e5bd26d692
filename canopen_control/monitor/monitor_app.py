"""Screen of the monitor: tables, logs and keys. Its STOP key is not a safety function (ISO 13850).

The screen is drawn five times a second and never blocks; threads send the requests of keys to the robot, and the
answers are shown. STOP has priority over the widget that has the focus.

The screen is drawn when a sample of the robot arrives, which is right after a cycle: a computer shared by both is then
idle for most of the period. The whole screen is laid out again only if necessary.
"""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import os
import re
import threading
import time
from collections import deque
from typing import TYPE_CHECKING, Any, ClassVar, Final

from rich.cells import cell_len
from rich.text import Text
from textual.app import App
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widgets import DataTable, Footer, Input, OptionList, RichLog, Static, TabbedContent, TabPane
from textual.widgets.data_table import ColumnKey
from textual.widgets.option_list import Option

from canopen_control.commissioning.jobs import JOBS
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.monitor.drive_objects import OBJECT_COLUMNS
from canopen_control.monitor.frame_tables import parse_filter
from canopen_control.monitor.monitor_content import DRIVE_COLUMNS, JOINT_COLUMNS, Cell, Tone, plain
from canopen_control.monitor.sources import SOURCE
from canopen_control.rpc.messages.robot import AxisRequest, Release, Stop
from canopen_control.trace.decoder import Mark
from canopen_control.trace.frame_lines import LineWriter, identifier_text

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from textual.app import ComposeResult
    from textual.notifications import SeverityLevel

    from canopen_control.bus.port import Port
    from canopen_control.monitor.drive_objects import DriveObjects, WorkRun
    from canopen_control.monitor.frame_tables import BusTap, FrameTable
    from canopen_control.monitor.monitor_content import LogLine, MonitorContent
    from canopen_control.monitor.sources import ScreenSource
    from canopen_control.rpc.messages.declare import Request


# Style of the monitor: Textual's CSS, and the colour of each level. A colour is never the only sign of a level.


_COLOURS: Final = {
    Tone.PLAIN: "",
    Tone.GOOD: "green",
    Tone.IDLE: "bright_black",
    Tone.WARN: "yellow",
    Tone.BAD: "bold red",
}
# without colours, red would become a dark grey, but errors must stand out
_PLAIN: Final = {Tone.PLAIN: "", Tone.GOOD: "", Tone.IDLE: "", Tone.WARN: "bold", Tone.BAD: "bold reverse"}


def tone_styles(environment: Mapping[str, str]) -> dict[Tone, str]:
    """Return the text style of each level; the styles have no colours if NO_COLOR is set."""
    return _PLAIN if environment.get("NO_COLOR") else _COLOURS


TONE_STYLES: Final = tone_styles(os.environ)
MARK_STYLES: Final = {
    Mark.PLAIN: TONE_STYLES[Tone.PLAIN],
    Mark.NOTABLE: "bold",
    Mark.WARNING: TONE_STYLES[Tone.WARN],
    Mark.ERROR: TONE_STYLES[Tone.BAD],
}

CSS: Final = """
Screen { layout: vertical; }
#head { height: auto; padding: 0 1; background: $panel; }
#alarm { height: auto; padding: 0 1; background: red; color: white; text-style: bold; display: none; }
#alarm.shown { display: block; }
#drives { height: auto; max-height: 40%; }
#joints { height: auto; max-height: 25%; }
TabbedContent { height: 1fr; }
TabPane { padding: 0; }
RichLog, #identifiers-table, #drive-table { height: 1fr; }
#drive-title { height: auto; padding: 0 1; }
#works, #work { display: none; height: auto; max-height: 50%; border-top: solid $panel; }
#work { height: 10; }
#works.shown, #work.shown { display: block; }
#filter { display: none; height: 3; }
#filter.shown { display: block; }
DataTable { background: $surface; }
"""


# Table that redraws only the cells that have changed.


_SLACK: Final = 4  # number of characters by which a column may stay too wide
FRAME_COLUMNS: Final = ("id", "count", "period ms", "node", "what", "data", "text")


class LiveTable(DataTable[Text]):
    """Table with rows by name; `show` updates the rows, `written` counts the updated cells."""

    def __init__(self, columns: Sequence[str], **options: Any) -> None:  # noqa: ANN401 - textual's own keywords
        super().__init__(cursor_type="row", zebra_stripes=False, **options)
        self._titles = columns
        self._shown: dict[str, tuple[Cell, ...]] = {}
        self.written = 0

    def on_mount(self) -> None:
        for title in self._titles:
            self.add_column(title, key=title)

    def show(self, rows: Mapping[str, tuple[Cell, ...]]) -> None:
        """Show exactly these rows; new rows are added at the end, in the order of `rows`."""
        for removed in [key for key in self._shown if key not in rows]:
            self.remove_row(removed)
            del self._shown[removed]
        for key, cells in rows.items():
            before = self._shown.get(key)
            if before is None:
                self.add_row(*(_text(cell) for cell in cells), key=key)
                self.written += len(cells)
            elif before != cells:
                self._change(key, before, cells)
            self._shown[key] = cells

    @property
    def selected(self) -> str | None:
        """Name of the row with the cursor, or None if there are no rows."""
        if not self._shown:
            return None
        return self.coordinate_to_cell_key(self.cursor_coordinate).row_key.value

    @property
    def visible_rows(self) -> list[str]:
        """Names of the rows that are visible in the window."""
        first = max(0, int(self.scroll_y))
        keys = [row.key.value or "" for row in self.ordered_rows[first : first + max(0, self.size.height)]]
        return [key for key in keys if key]

    def _change(self, key: str, before: tuple[Cell, ...], after: tuple[Cell, ...]) -> None:
        for title, old, new in zip(self._titles, before, after, strict=True):
            if old != new:
                self.update_cell(key, title, _text(new), update_width=self._resizes(title, old, new))
                self.written += 1

    def _resizes(self, title: str, old: Cell, new: Cell) -> bool:
        """Whether a new text changes a column's width, which redraws the screen; small decreases are ignored."""
        width, before, after = self.columns[ColumnKey(title)].content_width, cell_len(str(old)), cell_len(str(new))
        return after > width or (before >= width and after < before - _SLACK)


def _text(cell: Cell) -> Text:
    return Text(str(cell), style=TONE_STYLES[cell.tone], no_wrap=True)


def frame_rows(table: FrameTable) -> dict[str, tuple[Cell, ...]]:
    """Return a table row for each CAN identifier, in ascending order; the key is the identifier as a decimal text."""
    rows = {}
    for can_id, row in sorted(table.rows.items()):
        last = row.last
        node = last.node or ("" if last.node_id is None else f"node {last.node_id}")
        period = "" if row.period_ns is None else f"{row.period_ns / 1e6:.0f}"
        words = (identifier_text(can_id), str(row.count), period, node, last.subject, last.data.hex(" "), last.text)
        rows[str(can_id)] = tuple(plain(word) for word in words)
    return rows


# Tab for one drive: its objects, the actions on the drive, and their output.


SET: Final = "set"
_KEPT_LINES: Final = 1000
_LISTENS: Final = "listening only: reading objects would require sending"


class WorkChoice(OptionList):
    """Menu of actions on the drive, hidden until requested; the space key still means STOP."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select", "Choose", show=False)]

    def __init__(self) -> None:
        options = [Option(f"{SET:9} write the object with the cursor", id=SET)]
        super().__init__(*options, *(Option(f"{name:9} {job.does}", id=name) for name, job in JOBS.items()), id="works")


class DrivePane(Vertical):
    """Objects of the drive, with the menu of actions and the output of the running command."""

    def __init__(self) -> None:
        super().__init__()
        self.title, self.objects = Static(id="drive-title"), LiveTable(OBJECT_COLUMNS, id="drive-table")
        self.choice, self.output = WorkChoice(), RichLog(max_lines=_KEPT_LINES, wrap=True, id="work")
        self._run: WorkRun | None = None
        self._ended = False

    def compose(self) -> ComposeResult:
        yield self.title
        yield self.objects
        yield self.choice
        yield self.output

    def show(self, drive: DriveObjects | None) -> None:
        """Show the objects of the selected drive and read the visible rows; None if the monitor only listens."""
        title = _LISTENS if drive is None else drive.title
        if str(self.title.content) != title:
            self.title.update(Text(title))
        if drive is not None:
            self.objects.show(drive.rows())
            drive.watch(self.objects.visible_rows)

    def choose(self) -> None:
        self.choice.highlighted = 0
        self.choice.add_class("shown")
        self.choice.focus()

    # -- running command

    @property
    def busy(self) -> bool:
        return self._run is not None and self._run.code is None

    def follow(self, run: WorkRun) -> None:
        self._run, self._ended = run, False
        self.output.add_class("shown")
        self._report(run.title, Tone.IDLE)

    def end(self) -> None:
        if self._run is not None:
            self._run.end()

    def close(self) -> None:
        """End the command, and wait a few seconds at most until it has stopped the drive."""
        if self._run is not None:
            self._run.close()

    def show_work(self) -> None:
        """Show the output since the last call, and the result if the command has ended."""
        run = self._run
        if run is None or self._ended:
            return
        code = run.code  # read before the lines, so that the last lines are not missed
        for line in run.fresh():
            self._report(line, Tone.PLAIN)
        if code is not None:
            self._ended = True
            self._report("done" if code == 0 else f"ended with {code}", Tone.GOOD if code == 0 else Tone.BAD)

    def _report(self, line: str, tone: Tone) -> None:
        self.output.write(Text(line, style=TONE_STYLES[tone]))


PERIOD_S: Final = 0.2
TRACE_LINES: Final = 60  # new lines at a time; a busy bus has more than a user can read
KEPT_LINES: Final = 1000
_COMMANDS: Final = ("release", "axis", "work", "undo", "end_work")
_WORDS: Final = "pdo, sdo, a node's name, 0x181, 0x180-0x1FF, changes; empty: everything"
_FONT_FACES: Final = re.compile(r"@font-face\s*\{[^}]*\}\s*")
_SCROLLBAR: Final = 2
_MARGIN: Final = 2  # left and right of the head
_TABS: Final = ("events", "emergencies", "identifiers", "trace", "drive")
_TABLES: Final = ("identifiers", "drive")
_DRIVE_TAB: Final = "tab-drive"
_OBJECT_WORDS: Final = "search objects: 0x6081, 0x60*, velocity; several with commas; empty: everything"
_SET_WORDS: Final = "an object and its value, as in 0x6081=1000"
_KEYS: Final = """space STOP, r release; q quit
e d f enable, disable, fault-reset the selected drive; E D F all drives
1 to 5 tabs, Tab next table, left and right other columns
/ filter, Escape closes it and messages; p pauses the frames
w work with the drive, u undo, x end the work"""
_FRAME_TABS: Final = ("tab-identifiers", "tab-trace")
_LATE_S: Final = 0.9 * PERIOD_S


class MonitorApp(App[None]):
    """Screen of the monitor for a robot or for a bare bus."""

    CSS = CSS
    TITLE = "canopen-control monitor"
    ENABLE_COMMAND_PALETTE = False
    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "stop", "STOP", priority=True),
        Binding("question_mark", "keys", "Keys"),
        Binding("q", "quit", "Quit"),
        Binding("r", "release", "Release"),
        Binding("e", "axis('enable')", "Enable"),
        Binding("d", "axis('disable')", "Disable"),
        Binding("f", "axis('fault-reset')", "Reset"),
        Binding("E", "axis('enable', 'all')", "Enable all", show=False),
        Binding("D", "axis('disable', 'all')", "Disable all", show=False),
        Binding("F", "axis('fault-reset', 'all')", "Reset all", show=False),
        Binding("slash", "filter", "Filter"),
        Binding("p", "pause", "Pause"),
        Binding("w", "work", "Work"),
        Binding("u", "undo", "Undo", show=False),
        Binding("x", "end_work", "End work", show=False),
        *(Binding(str(number), f"tab('{tab}')", tab, show=False) for number, tab in enumerate(_TABS, 1)),
        Binding("escape", "leave_filter", "Back", show=False),
        Binding("ctrl+c", "quit", "Quit", show=False, priority=True),
    ]

    def __init__(self, source: ScreenSource) -> None:
        super().__init__()
        self.source = source
        self.paused = False
        self._drives = LiveTable(DRIVE_COLUMNS, id="drives")
        self._joints = LiveTable(JOINT_COLUMNS, id="joints")
        self._frames = LiveTable(FRAME_COLUMNS, id="identifiers-table")
        self._drive = DrivePane()
        self._head, self._alarm = Static(id="head"), Static(id="alarm")
        self._head_lines = 0
        self._logs = {
            name: RichLog(max_lines=KEPT_LINES, wrap=name != "trace", id=name) for name in _TABS if name not in _TABLES
        }
        self._messages: deque[tuple[str, SeverityLevel]] = deque()  # messages of threads, until they are shown
        self._watched: list[BusTap] = []
        self._drawn = 0.0
        self._lines: LineWriter | None = None
        self._objects: DriveObjects | None = None
        self._chosen = ""  # action whose input line is open

    # -- screen

    def compose(self) -> ComposeResult:
        yield self._head
        yield self._alarm
        yield self._drives
        yield self._joints
        yield FilterLine(placeholder=_WORDS, select_on_focus=False, id="filter")
        with TabbedContent(id="tabs"):
            for number, name in enumerate(_TABS, 1):
                with TabPane(f"{number} {name}", id=f"tab-{name}"):
                    yield {"identifiers": self._frames, "drive": self._drive}.get(name) or self._logs[name]
        yield Footer(compact=True)

    def on_mount(self) -> None:
        self._drives.focus()
        loop, context = asyncio.get_running_loop(), contextvars.copy_context()

        def on_sample() -> None:
            with contextlib.suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self.refresh_picture, context=context)

        self.source.start(on_sample)
        self.refresh_picture()
        self.set_interval(PERIOD_S, self._refresh_if_late)

    def on_unmount(self) -> None:
        self._drive.close()
        self.source.close()

    def _refresh_if_late(self) -> None:
        """Redraw if no sample has arrived lately because the robot is missing or silent."""
        if time.monotonic() - self._drawn > _LATE_S:
            self.refresh_picture()

    def refresh_picture(self) -> None:
        """Update all parts of the screen; unchanged parts are not redrawn."""
        if not self.is_running:
            return
        self._drawn = time.monotonic()
        self.source.listen(self.query_one("#tabs", TabbedContent).active in _FRAME_TABS)
        self.source.tick()
        while self._messages:
            text, severity = self._messages.popleft()
            self.notify(text, severity=severity, markup=False)
        self._watch(self.source.taps)
        content = self.source.content()
        self._show_head(content)
        self._drives.show(content.drives)
        self._show_drives(bool(content.drives))
        self._joints.show(content.joints)
        self._joints.display = bool(content.joints)
        self._write("events", self.source.log())
        self._write("emergencies", self.source.emergencies())
        self._show_frames()
        self._show_objects()
        self._drive.show_work()

    def _show_head(self, content: MonitorContent) -> None:
        state = content.state
        head = Text.assemble((content.title, "bold"), "  ", (str(state), TONE_STYLES[state.tone]))
        problems = [tap.problem for tap in self.source.taps if tap.problem]
        lost = sum(tap.lost for tap in self.source.taps)
        facts = [*content.facts, *problems, *([f"{lost} frames were lost by the monitor"] if lost else [])]
        head.append(f"  {'  ·  '.join(facts)}")
        if str(self._head.content) != str(head):
            lines = len(head.wrap(self.console, max(self.size.width - _MARGIN, 1)))
            self._head.update(head, layout=lines != self._head_lines)  # another height needs a new layout
            self._head_lines = lines
        self._alarm.set_class(bool(content.alarm), "shown")
        if str(self._alarm.content) != content.alarm:
            self._alarm.update(Text(content.alarm))

    def _show_drives(self, shown: bool) -> None:
        """Hide the table of drives while it is empty, as with a simulated robot."""
        if shown and not self._drives.display and not isinstance(self.focused, FilterLine):
            self._drives.display = True
            self._drives.focus()
        self._drives.display = shown

    def _write(self, name: str, lines: Iterable[LogLine]) -> None:
        for line in lines:
            clock = time.strftime("%H:%M:%S", time.localtime(line.time)) + f".{int(line.time * 1000) % 1000:03d}"
            sign = f"{line.tone.value or ' '} "
            text = Text(f"{clock} {sign}{line.text}", style=TONE_STYLES[line.tone])
            self._logs[name].write(text, width=max(self.size.width - _SCROLLBAR, 1))  # a hidden tab has no width yet

    def _show_frames(self) -> None:
        active = self.query_one("#tabs", TabbedContent).active
        if self.paused:
            return
        if active == "tab-identifiers":
            self._frames.show(frame_rows(self.source.frames))
        elif active == "tab-trace":
            self._show_trace()

    def _show_objects(self) -> None:
        """Show the objects of the selected drive while the drive tab is open; otherwise stop reading."""
        if self.query_one("#tabs", TabbedContent).active != _DRIVE_TAB:
            if self._objects is not None:
                self._objects.leave()
                self._objects = None
            return
        self._objects = self.source.choose(self._selected)
        self._drive.show(self._objects)

    def _show_trace(self) -> None:
        fresh = self.source.trace.fresh()
        writer = self._lines = self._lines or LineWriter(self.source.network)
        if len(fresh) > TRACE_LINES:
            self._logs["trace"].write(Text(f"... {len(fresh) - TRACE_LINES} frames not shown; / filters", style="dim"))
        for decoded in fresh[-TRACE_LINES:]:
            self._logs["trace"].write(Text(writer.line(decoded), style=MARK_STYLES[decoded.mark]))

    def _watch(self, taps: list[BusTap]) -> None:
        """Register the ports with the event loop, so that frames are read before the small kernel buffers overflow."""
        for tap in taps:
            if not any(tap is watched for watched in self._watched):
                tap.watch(_Reader(tap))
        self._watched = list(taps)

    def picture_svg(self) -> str:
        """Return the screen as an SVG image, without references to web fonts."""
        return _FONT_FACES.sub("", self.export_screenshot())

    # -- keys

    def check_action(self, action: str, parameters: tuple[object, ...]) -> bool | None:  # noqa: ARG002 - textual's
        """Hide the command keys if the source accepts no commands."""
        return self.source.can_command or action not in _COMMANDS

    def action_keys(self) -> None:
        """Show a list of all keys, for narrow terminals."""
        self.notify(_KEYS, title="Keys", timeout=20, markup=False)

    def action_stop(self) -> None:
        """Request a latched STOP, which ramps all joints to a standstill and disables the drives."""
        if self.source.can_command:
            self._ask("STOP", Stop(latch=True, source=SOURCE))
        else:
            self.notify("listening only: this monitor sends nothing, so it cannot stop anything", severity="warning")

    def action_release(self) -> None:
        self._ask("release", Release(source=SOURCE))

    def action_axis(self, action: str, node: str = "") -> None:
        """Enable, disable or fault-reset the selected drive, or the drive `node` ("all" for all drives)."""
        target = node or self._selected
        if target:
            self._ask(f"{action} {target}", AxisRequest(action=action, node=target, source=SOURCE))

    def action_tab(self, name: str) -> None:
        self.query_one("#tabs", TabbedContent).active = f"tab-{name}"

    def action_pause(self) -> None:
        self.paused = not self.paused
        self.notify("frames are paused; p resumes" if self.paused else "frames are shown", timeout=2)

    @property
    def _selected(self) -> str:
        """Name of the node whose row has the cursor, or "" if there are no rows."""
        return (self._drives.selected or "").partition("/")[0]

    def action_filter(self) -> None:
        """Prompt for a filter of the trace, or for a search if the drive tab is open."""
        on_objects = self.query_one("#tabs", TabbedContent).active == _DRIVE_TAB
        if not on_objects:
            self.action_tab("trace")
        self._chosen = ""
        self._ask_for(_OBJECT_WORDS if on_objects else _WORDS)

    def _ask_for(self, words: str, value: str = "") -> None:
        """Show the input line with a hint and an initial value."""
        field = self.query_one(FilterLine)
        field.placeholder, field.value = words, value
        field.cursor_position = len(value)
        field.add_class("shown")
        field.focus()

    def action_leave_filter(self) -> None:
        """Hide the input line, the menu of actions and the messages."""
        self._close_input()
        self.clear_notifications()

    def _close_input(self) -> None:
        self._chosen = ""
        for widget in (self.query_one(FilterLine), self._drive.choice):
            widget.remove_class("shown")
        (self._drives if self._objects is None else self._drive.objects).focus()

    def action_work(self) -> None:
        self.action_tab("drive")
        self._drive.choose()

    def action_end_work(self) -> None:
        self._drive.end()

    def action_undo(self) -> None:
        """Undo the latest write to an object of the shown drive."""
        if (objects := self._objects) is not None:
            self._on_thread("undo", objects.undo)

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Open the input line for the chosen action."""
        self._chosen = event.option.id or ""
        self._drive.choice.remove_class("shown")
        if self._chosen == SET:
            row = self._drive.objects.selected
            self._ask_for(_SET_WORDS, f"{row}=" if row else "")
        else:
            self._ask_for(JOBS[self._chosen].asks)

    def _begin(self, chosen: str, text: str) -> None:
        """Start the chosen action with the input; raise CanopenError if it cannot start."""
        if chosen == SET:
            if (objects := self._objects) is not None:
                self._on_thread("set", lambda: objects.write(text))
            return
        if self._drive.busy:
            raise ConfigError("a command is already running; x ends it")
        self._drive.follow(self.source.begin(chosen, text, self._selected))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Apply the input; if this fails, keep the input line open for a correction."""
        try:
            if self._chosen:
                self._begin(self._chosen, event.value)
            elif self._objects is not None:
                self._objects.search(event.value)
            else:
                self.source.trace.choose(parse_filter(event.value, self.source.network))
                self._logs["trace"].clear()
        except CanopenError as error:
            self.notify(str(error), severity="error", markup=False)
            return
        self._close_input()

    def _ask(self, title: str, request: Request[Any]) -> None:
        """Send a request on a thread and show the result."""

        def ask() -> str:
            self.source.command(request)
            return "done"

        self._on_thread(title, ask)

    def _on_thread(self, title: str, work: Callable[[], str]) -> None:
        """Run a blocking function on a thread, and show the returned text or the error."""

        def run() -> None:
            try:
                self._messages.append((f"{title}: {work()}", "information"))
            except CanopenError as error:
                self._messages.append((f"{title}: {error}", "error"))

        # Not a worker of Textual, because their number is limited, and a STOP must not wait for other requests.
        threading.Thread(target=run, name=title, daemon=True).start()


class FilterLine(Input):
    """Input line that leaves the space key to STOP; by default Textual gives inputs precedence over key bindings."""

    def check_consume_key(self, key: str, character: str | None) -> bool:
        """Leave the space key, which means STOP, to the screen."""
        return key != "space" and super().check_consume_key(key, character)


class _Reader:
    """Registration of a bus tap's port with the running event loop."""

    def __init__(self, tap: BusTap) -> None:
        self._tap, self._loop = tap, asyncio.get_running_loop()
        self._fd: int | None = None

    def port_changed(self, port: Port | None) -> None:
        """Read from this port from now on; None ends reading."""
        if self._fd is not None:
            self._loop.remove_reader(self._fd)
        self._fd = None if port is None else port.fileno()
        if self._fd is not None:
            self._loop.add_reader(self._fd, self._tap.receive)
