"""Plots of the last 30 seconds: command and actual of each joint, following error, cycle and bus.

The law of this file: what is drawn are the runtime's own numbers; the following error is the command minus the actual
value of the interface that is commanded, the cycle time what passed between two samples divided by the cycles in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

from canopen_control.view.history import SPAN_S, History
from canopen_control.view.style import ICONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from viser import GuiUplotHandle, PanelHandle
    from viser.uplot import Axis

    from canopen_control.view.server import PageServer

__all__ = ["Plots", "Sampler", "commanded_interfaces"]

_COMMAND: Final = "#9aa5b1"
_ACTUAL: Final = "#2563eb"
_COLORS: Final = ("#2563eb", "#e07a00", "#16803c", "#b0188f", "#6b4fbb", "#0f8b8d", "#b01818", "#5b6673")
_UNITS: Final = {"velocity": "rad/s", "position": "rad", "effort": "Nm"}
_LINEAR_UNITS: Final = {"velocity": "m/s", "position": "m", "effort": "N"}
_HEIGHT: Final = 104
_LEGEND: Final = (
    f"<div class='cc-box'><p class='cc-note'><b style='color:{_COMMAND}'>&#9473; command</b> &nbsp; "
    f"<b style='color:{_ACTUAL}'>&#9473; actual</b> &nbsp; of the last 30 s</p></div>"
)
_SHOWN_JOINTS: Final = 12
_MARGIN: Final = 1.2


def commanded_interfaces(controllers: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Return the interface that is commanded of each joint, by the active controllers."""
    found: dict[str, str] = {}
    for controller in controllers:
        for claimed in controller["claimed_interfaces"] if controller["state"] == "active" else ():
            joint, _, interface = str(claimed).rpartition("/")
            if interface in _UNITS:
                found.setdefault(joint, interface)
    return found


class Sampler:
    """Makes the numbers that are plotted of the samples of the stream."""

    def __init__(self) -> None:
        self._before: tuple[float, int] | None = None

    def take(self, state: Mapping[str, Any], interfaces: Mapping[str, str]) -> dict[str, float | None]:
        """Return the values of one sample by the name of their row."""
        values: dict[str, float | None] = {}
        for joint, each in state["joints"].items():
            interface = interfaces.get(joint)
            actual = each.get(interface or "velocity")
            command = each.get("command") if interface else None
            if command is None:  # nobody commands it: the hardware holds
                command = actual if interface == "position" else 0.0
            values[f"{joint} actual"], values[f"{joint} command"] = actual, command
            values[f"{joint} error"] = 0.0 if actual is None or command is None else command - actual
        values["work"] = 1e3 * state["cycle"].get("work_s", 0.0)
        values["cycle"] = self._cycle(state["time"], state["cycle"]["count"])
        for bus, load in (state.get("load") or {}).items():
            values[f"load {bus}"] = None if load is None else 100 * load
        return values

    def _cycle(self, time: float, count: int) -> float | None:
        before, self._before = self._before, (time, count)
        if before is None or count <= before[1]:
            return None
        return 1e3 * (time - before[0]) / (count - before[1])


@dataclass(frozen=True, slots=True)
class _Chart:
    handle: Any
    rows: tuple[str, ...]


class Plots:
    """Charts in two tabs of `panel`; `update` sends what has been sampled. `linear` joints go in m, others in rad."""

    def __init__(
        self,
        server: PageServer,
        panel: PanelHandle,
        joints: Sequence[str],
        buses: Sequence[str],
        linear: frozenset[str] = frozenset(),
    ) -> None:
        self._gui, self._linear = server.gui, linear
        self._interfaces: dict[str, str] = {}
        shown = list(joints)[:_SHOWN_JOINTS]
        loads = [f"load {bus}" for bus in buses]
        names = [f"{joint} {what}" for joint in shown for what in ("command", "actual", "error")]
        self.history = History([*names, "work", "cycle", *loads])
        self._charts: list[_Chart] = []
        self._titles: dict[str, Any] = {}
        with panel.add_tab("Joints", ICONS["joints"]):
            self._gui.add_html(_LEGEND)
            for joint in shown:
                lines = (("command", _COMMAND), ("actual", _ACTUAL))
                rows = [f"{joint} command", f"{joint} actual"]
                self._titles[joint] = self._chart(joint, lines, rows)
            colored = [(joint, _COLORS[number % len(_COLORS)]) for number, joint in enumerate(shown)]
            if len(colored) > 1:
                self._gui.add_html(_named(colored))
            self._error = self._chart("Following error", colored, [f"{joint} error" for joint in shown])
        with panel.add_tab("Cycle and bus", ICONS["cycle"]):
            self._chart("Cycle time, ms", (("between cycles", _ACTUAL),), ["cycle"], 0.0)
            self._chart("Work in a cycle, ms", (("work", _COLORS[1]),), ["work"], 0.0)
            if loads:
                named = [(bus, _COLORS[2 + number % 5]) for number, bus in enumerate(buses)]
                self._chart("Bus load, %", named, loads, 0.0)

    def name(self, interfaces: Mapping[str, str]) -> None:
        """Say in the titles what is plotted; a joint that is commanded otherwise begins anew."""
        if dict(interfaces) == self._interfaces:
            return
        self._interfaces = dict(interfaces)
        self.history.clear()
        for joint, handle in self._titles.items():
            interface = interfaces.get(joint, "velocity")
            handle.title = f"{joint} {interface}, {self._unit(joint, interface)}"
        units = {self._unit(joint, interface) for joint, interface in interfaces.items()}
        self._error.title = f"Following error{', ' + ' and '.join(sorted(units)) if units else ''}"

    def _unit(self, joint: str, interface: str) -> str:
        return (_LINEAR_UNITS if joint in self._linear else _UNITS)[interface]

    def update(self) -> None:
        """Send the newest 30 seconds to who looks."""
        for chart in self._charts:
            chart.handle.data = self.history.columns(chart.rows)

    def _chart(
        self, title: str, lines: Sequence[tuple[str, str]], rows: Sequence[str], low: float = -1.0
    ) -> GuiUplotHandle:
        series: list[dict[str, Any]] = [{"label": "s"}]
        series += [{"label": label, "stroke": color, "width": 2, "points": {"show": False}} for label, color in lines]
        handle = self._gui.add_uplot(
            self.history.columns(rows),
            tuple(series),  # type: ignore[arg-type] # TypedDicts of viser
            title=title,
            scales={"x": {"time": False, "range": (-SPAN_S, 0.0)}, "y": {"range": _at_least(low, 1.0)}},
            axes=(_axis(26, 50), _axis(46, 16)),  # pixels
            legend={"show": False},
            height=_HEIGHT,
        )
        self._charts.append(_Chart(handle, tuple(rows)))
        return handle


def _at_least(low: float, high: float) -> dict[str, dict[str, float]]:
    """Return uPlot's range that shows `low` to `high` even if nothing happens, and more when there is more.

    A little more than that: a number at the very edge would be cut in half.
    """
    return {
        "min": {"pad": 0.1 if low else 0.0, "soft": low * _MARGIN, "mode": 1},
        "max": {"pad": 0.1, "soft": high * _MARGIN, "mode": 1},
    }


def _axis(size: int, space: int) -> Axis:
    """Return an axis that takes `size` pixels, with a number every `space` at most, and stays in the background."""
    return {
        "space": space,  # uPlot's own 30 leave a small chart with a single number
        "size": size,
        "stroke": "#5b6673",
        "grid": {"stroke": "#e6e9ee", "width": 1},
        "ticks": {"stroke": "#d5dae0", "width": 1, "size": 4},
    }


def _named(lines: Sequence[tuple[str, str]]) -> str:
    """Say which line is whose."""
    names = " &nbsp; ".join(f"<b style='color:{color}'>&#9473; {escape(label)}</b>" for label, color in lines)
    return f"<div class='cc-box'><p class='cc-note'>{names}</p></div>"
