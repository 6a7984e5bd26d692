"""The monitor's tab of one drive: its objects, what may be done with it, and what came of that."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

from rich.text import Text
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.widgets import OptionList, RichLog, Static
from textual.widgets.option_list import Option

from canopen_control.monitor.drive_objects import OBJECT_COLUMNS
from canopen_control.monitor.drive_work import WORKS
from canopen_control.monitor.monitor_content import Tone
from canopen_control.monitor.style import TONE_STYLES
from canopen_control.monitor.tables import LiveTable

if TYPE_CHECKING:
    from textual.app import ComposeResult

    from canopen_control.monitor.drive_objects import DriveObjects
    from canopen_control.monitor.drive_work import WorkRun

__all__ = ["SET", "DrivePane"]

SET: Final = "set"
_KEPT_LINES: Final = 1000
_LISTENS: Final = "this monitor only listens: to read objects is to send"


class WorkChoice(OptionList):
    """What may be done with the drive, hidden until somebody asks; `space` stays STOP."""

    BINDINGS: ClassVar[list[BindingType]] = [Binding("enter", "select", "Choose", show=False)]

    def __init__(self) -> None:
        own = [Option(f"{SET:9} write the object with the cursor", id=SET)]
        super().__init__(*own, *(Option(f"{name:9} {work.does}", id=name) for name, work in WORKS.items()), id="works")


class DrivePane(Vertical):
    """The drive's objects, live; below them the choice of what may be done, and the lines of the verb that does it."""

    def __init__(self) -> None:
        super().__init__()
        self.title, self.objects = Static(id="drive-title"), LiveTable(OBJECT_COLUMNS, id="drive-table")
        self.choice, self.told = WorkChoice(), RichLog(max_lines=_KEPT_LINES, wrap=True, id="work")
        self._run: WorkRun | None = None
        self._ended = False

    def compose(self) -> ComposeResult:
        """Lay it out."""
        yield self.title
        yield self.objects
        yield self.choice
        yield self.told

    def show(self, looking: DriveObjects | None) -> None:
        """Show the objects of the drive that is looked at, and have those in sight read."""
        title = _LISTENS if looking is None else looking.title
        if str(self.title.content) != title:
            self.title.update(Text(title))
        if looking is not None:
            self.objects.show(looking.rows())
            looking.look(self.objects.in_sight)

    def choose(self) -> None:
        """Let the user choose what to do."""
        self.choice.highlighted = 0
        self.choice.add_class("shown")
        self.choice.focus()

    # -- the verb that runs

    @property
    def busy(self) -> bool:
        """Whether a verb runs."""
        return self._run is not None and self._run.code is None

    def follow(self, run: WorkRun) -> None:
        """Show what this verb tells from now on."""
        self._run, self._ended = run, False
        self.told.add_class("shown")
        self._tell(run.title, Tone.IDLE)

    def end(self) -> None:
        """Ask the verb for its end, as Ctrl-C does."""
        if self._run is not None:
            self._run.end()

    def close(self) -> None:
        """End it; waits for a ramp."""
        if self._run is not None:
            self._run.close()

    def show_work(self) -> None:
        """Show what it has told since the last call, and how it has ended."""
        run = self._run
        if run is None or self._ended:
            return
        code = run.code  # before its last lines are taken
        for line in run.fresh():
            self._tell(line, Tone.PLAIN)
        if code is not None:
            self._ended = True
            self._tell("done" if code == 0 else f"ended with {code}", Tone.GOOD if code == 0 else Tone.BAD)

    def _tell(self, line: str, tone: Tone) -> None:
        self.told.write(Text(line, style=TONE_STYLES[tone]))
