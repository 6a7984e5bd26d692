"""The monitor's looks: textual's CSS, and the colour of each tone. A colour never stands alone (picture.py)."""

from __future__ import annotations

from typing import Final

from canopen_control.monitor.picture import Tone
from canopen_control.trace.decoder import Mark

__all__ = ["CSS", "MARK_STYLES", "TONE_STYLES"]

TONE_STYLES: Final = {
    Tone.PLAIN: "",
    Tone.GOOD: "green",
    Tone.IDLE: "bright_black",
    Tone.WARN: "yellow",
    Tone.BAD: "bold red",
}
MARK_STYLES: Final = {Mark.PLAIN: "", Mark.NOTABLE: "cyan", Mark.WARNING: "yellow", Mark.ERROR: "bold red"}

CSS: Final = """
Screen { layout: vertical; }
#head { height: auto; padding: 0 1; background: $panel; }
#alarm { height: auto; padding: 0 1; background: red; color: white; text-style: bold; display: none; }
#alarm.shown { display: block; }
#drives { height: auto; max-height: 40%; }
#joints { height: auto; max-height: 25%; }
TabbedContent { height: 1fr; }
TabPane { padding: 0; }
RichLog, #identifiers-table { height: 1fr; }
#filter { display: none; height: 3; }
#filter.shown { display: block; }
DataTable { background: $surface; }
"""
