"""The monitor's looks: textual's CSS, and the colour of each tone. A colour never stands alone (monitor_content.py)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Final

from canopen_control.monitor.monitor_content import Tone
from canopen_control.trace.decoder import Mark

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["CSS", "MARK_STYLES", "TONE_STYLES", "tone_styles"]

_COLOURS: Final = {
    Tone.PLAIN: "",
    Tone.GOOD: "green",
    Tone.IDLE: "bright_black",
    Tone.WARN: "yellow",
    Tone.BAD: "bold red",
}
#: without colours a red would become a dark grey: what is bad must stand out nevertheless
_PLAIN: Final = {Tone.PLAIN: "", Tone.GOOD: "", Tone.IDLE: "", Tone.WARN: "bold", Tone.BAD: "bold reverse"}


def tone_styles(environment: Mapping[str, str]) -> dict[Tone, str]:
    """Return the style of each tone; without colours where NO_COLOR says so."""
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
