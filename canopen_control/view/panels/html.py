"""A piece of HTML on the page that is sent when it changes. What is in it has been escaped by `words`."""

from __future__ import annotations

from nicegui import ui

__all__ = ["Html", "tell"]


class Html:
    """A piece of HTML, empty until it is given one."""

    def __init__(self, classes: str = "") -> None:
        self._html = ""
        self._element = ui.html("", sanitize=False).classes(classes)

    def show(self, html: str) -> None:
        """Show this; nothing is sent when it is shown already."""
        if html != self._html:
            self._html = html
            self._element.content = html


def tell(title: str, text: str) -> None:
    """Show a notice on the page that asked."""
    ui.notify(f"{title}: {text}", type="negative", position="top", timeout=12_000, multi_line=True, close_button="OK")
