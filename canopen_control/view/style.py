"""The page's looks: CSS for what viser shows by itself, and for our own pieces of HTML.

The law of this file: it only paints. viser's buttons are known by their icons; where a later viser names those
otherwise, everything still works and is merely plainer. No font and no picture comes from anywhere else.
"""

from __future__ import annotations

from typing import Final

from viser import Icon

__all__ = ["ICONS", "STOP_COLOR", "STYLE"]

STOP_COLOR: Final = (200, 16, 46)
#: what a button is for, and the icon it is known by
ICONS: Final = {
    "stop": Icon.HAND_STOP,
    "release": Icon.LOCK_OPEN,
    "forward": Icon.ARROW_UP,
    "left": Icon.ARROW_BACK_UP,
    "right": Icon.ARROW_FORWARD_UP,
    "back": Icon.ARROW_DOWN,
    "drive": Icon.HAND_FINGER,
    "drives": Icon.ENGINE,
    "joints": Icon.CHART_LINE,
    "cycle": Icon.ACTIVITY,
}

STYLE: Final = """<style>
button:has(.icon-tabler-hand-stop) { height: 5.6em !important; border-radius: 10px !important;
  box-shadow: 0 3px 0 #7d0a1d; letter-spacing: .12em; }
button:has(.icon-tabler-hand-stop) .mantine-Button-label { margin-inline-start: .45em;
  font-size: 2.1em; font-weight: 800 !important; }
button:has(.icon-tabler-hand-stop) .mantine-Button-section > div { width: 2.1em; height: 2.1em; }
button:has(.icon-tabler-hand-stop) svg { width: 2.1em !important; height: 2.1em !important; }
button:has(.icon-tabler-hand-stop):active { transform: translateY(2px); box-shadow: 0 1px 0 #7d0a1d; }
button:has(.icon-tabler-lock-open) { height: 2.8em !important; font-weight: 700; }
div:has(> div > button .icon-tabler-arrow-up) { display: grid; grid-template-columns: 1fr 1fr 1fr;
  column-gap: 0; padding-bottom: .4em; }
div:has(> div > button .icon-tabler-arrow-up) > div { margin-inline: .25em !important; }
div:has(> button .icon-tabler-arrow-up) { grid-area: 1 / 2; }
div:has(> button .icon-tabler-arrow-back-up) { grid-area: 2 / 1; }
div:has(> button .icon-tabler-arrow-down) { grid-area: 2 / 2; }
div:has(> button .icon-tabler-arrow-forward-up) { grid-area: 2 / 3; }
button:has(.icon-tabler-arrow-up), button:has(.icon-tabler-arrow-down), button:has(.icon-tabler-arrow-back-up),
button:has(.icon-tabler-arrow-forward-up), button:has(.icon-tabler-hand-finger) { height: 3.4em !important;
  touch-action: none; user-select: none; }
.cc-head { display: flex; align-items: center; gap: .6em; flex-wrap: wrap; }
.cc-name { font-size: 1.5em; font-weight: 700; color: #16324f; }
.cc-chip { display: inline-block; padding: .1em .6em; border-radius: 1em; font-size: .85em; font-weight: 600;
  line-height: 1.5; }
.cc-chip.cc-good { background: #d9f2e1; color: #14602f; } .cc-chip.cc-idle { background: #e8ebef; color: #4a5460; }
.cc-chip.cc-warn { background: #fdebc8; color: #7a4b00; } .cc-chip.cc-bad { background: #fbd9d9; color: #9c1111; }
.cc-alarm { margin: .5em 0 .2em; padding: .5em .7em; border-radius: 6px; background: #c8102e; color: #fff;
  font-weight: 600; line-height: 1.35; } .cc-alarm.cc-lost { background: #5a2330; }
.cc-facts, .cc-note { color: #5b6673; font-size: .82em; line-height: 1.45; margin: .35em 0; }
.cc-table { width: 100%; border-collapse: collapse; font-size: .88em; }
.cc-table th { text-align: left; font-weight: 600; color: #6b7683; font-size: .85em; padding: .1em .4em; }
.cc-table td { border-top: 1px solid #e6e9ee; padding: .35em .4em; vertical-align: top; }
.cc-many br { display: none; } .cc-many td { padding: .2em .25em; }
.cc-many .cc-chip { font-size: .76em; padding: .15em .45em; white-space: nowrap; }
.cc-many small { margin-left: .4em; white-space: nowrap; }
.cc-table small { color: #7a8592; } .cc-late { color: #b45309; font-weight: 600; }
.cc-error td { border-top: 0 !important; padding-top: 0 !important; color: #b01818; font-size: .93em; }
.cc-log { border-top: 1px solid #e6e9ee; margin-top: .6em; padding-top: .5em; font-size: .82em; line-height: 1.4; }
.cc-event { display: flex; gap: .6em; padding: .16em .4em;
  border-left: 3px solid transparent; } .cc-event time { color: #8a94a0; font-variant-numeric: tabular-nums; }
.cc-event.cc-warn { border-color: #e0a100; background: #fffaf0; }
.cc-event.cc-bad { border-color: #d62828; background: #fff4f4; color: #8c1010; }
.cc-on { color: #9c1111; }
.cc-box { padding: 0 .8em; }
</style>"""
