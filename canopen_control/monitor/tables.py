"""A table that is drawn again only where something changed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from rich.cells import cell_len
from rich.text import Text
from textual.widgets import DataTable
from textual.widgets.data_table import ColumnKey

from canopen_control.monitor.monitor_content import Cell, plain
from canopen_control.monitor.style import TONE_STYLES
from canopen_control.trace.frame_lines import identifier_text

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.monitor.frame_tables import FrameTable

__all__ = ["FRAME_COLUMNS", "LiveTable", "frame_rows"]

_SLACK: Final = 4  # characters that a column stays too wide
FRAME_COLUMNS: Final = ("id", "count", "period ms", "node", "what", "data", "text")


class LiveTable(DataTable[Text]):
    """Rows of cells by name; `show` makes them so and `written` counts the cells that this has cost."""

    def __init__(self, columns: Sequence[str], **how: Any) -> None:  # noqa: ANN401 - textual's own keywords
        super().__init__(cursor_type="row", zebra_stripes=False, **how)
        self._titles = columns
        self._shown: dict[str, tuple[Cell, ...]] = {}
        self.written = 0

    def on_mount(self) -> None:
        """Make the columns."""
        for title in self._titles:
            self.add_column(title, key=title)

    def show(self, rows: Mapping[str, tuple[Cell, ...]]) -> None:
        """Make the rows those, in that order where they are new."""
        for gone in [key for key in self._shown if key not in rows]:
            self.remove_row(gone)
            del self._shown[gone]
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
        """The name of the row with the cursor."""
        if not self._shown:
            return None
        return self.coordinate_to_cell_key(self.cursor_coordinate).row_key.value

    @property
    def in_sight(self) -> list[str]:
        """The names of the rows that the window shows."""
        first = max(0, int(self.scroll_y))
        keys = [row.key.value or "" for row in self.ordered_rows[first : first + max(0, self.size.height)]]
        return [key for key in keys if key]

    def _change(self, key: str, before: tuple[Cell, ...], after: tuple[Cell, ...]) -> None:
        for title, old, new in zip(self._titles, before, after, strict=True):
            if old != new:
                self.update_cell(key, title, _text(new), update_width=self._resizes(title, old, new))
                self.written += 1

    def _resizes(self, title: str, old: Cell, new: Cell) -> bool:
        """Whether a column gets another width: a new one has the whole screen laid out, so not for a digit less."""
        width, before, after = self.columns[ColumnKey(title)].content_width, cell_len(str(old)), cell_len(str(new))
        return after > width or (before >= width and after < before - _SLACK)


def _text(cell: Cell) -> Text:
    return Text(str(cell), style=TONE_STYLES[cell.tone], no_wrap=True)


def frame_rows(table: FrameTable) -> dict[str, tuple[Cell, ...]]:
    """Return a row for each identifier, by identifier."""
    found = {}
    for can_id, row in sorted(table.rows.items()):
        last = row.last
        node = last.node or ("" if last.node_id is None else f"node {last.node_id}")
        period = "" if row.period_ns is None else f"{row.period_ns / 1e6:.0f}"
        words = (identifier_text(can_id), str(row.count), period, node, last.subject, last.data.hex(" "), last.text)
        found[str(can_id)] = tuple(plain(word) for word in words)
    return found
