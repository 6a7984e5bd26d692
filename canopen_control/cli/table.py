"""Plain columns: as wide as their widest cell, numbers to the right."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Table"]


class Table:
    """Rows of text under headings."""

    def __init__(self, headings: Sequence[str]) -> None:
        self._rows: list[Sequence[str]] = [headings]

    def add(self, row: Sequence[str]) -> None:
        """Append a row of as many cells as there are headings."""
        self._rows.append(row)

    def lines(self) -> list[str]:
        """Return the finished lines, the headings first."""
        widths = [max(len(row[column]) for row in self._rows) for column in range(len(self._rows[0]))]
        return [
            "  ".join(_cell(text, width) for text, width in zip(row, widths, strict=True)).rstrip()
            for row in self._rows
        ]


def _cell(text: str, width: int) -> str:
    number = text.lstrip("-")[:1].isdigit()
    return text.rjust(width) if number else text.ljust(width)
