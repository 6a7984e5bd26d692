"""Plotted values of the joints, the cycle and the buses, from state samples.

All values come from the runtime. The tracking error is the command minus the actual value of the commanded interface;
the cycle time is the time between two samples divided by the number of cycles between them.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen_control.rpc.messages.state import UNITS
from canopen_control.view.targets import drive_targets

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from canopen_control.rpc.messages.state import ControllerReading, StateSample


# History of the last 30 seconds of a few values, ten samples a second, for pages that are opened later.
#
# Gaps without a sample, and unknown values, are not filled.


SPAN_S: Final = 30.0
RATE: Final = 10  # samples per second
_SIZE: Final = round(SPAN_S * RATE) + 1
Row = list[float | None]
"""Row of a plot: the time, and a value for each name (None: unknown)."""


class History:
    """Values of the last `SPAN_S` seconds under the given `names`, with Unix times in s."""

    def __init__(self, names: Sequence[str]) -> None:
        self.names = tuple(names)
        self._rows: deque[Row] = deque(maxlen=_SIZE)
        self._slot: int | None = None
        self._new = 0

    def add(self, time: float, values: Mapping[str, float | None]) -> None:
        """Add the values of a sample; they replace an earlier sample in the same time slot of 1/`RATE` s."""
        slot = math.floor(time * RATE + 1e-6)
        if self._slot is not None and slot < self._slot:
            self.clear()  # the clock was set back
        if slot == self._slot:
            self._rows.pop()
        else:
            self._new += 1
        self._slot = slot
        self._rows.append([time, *(_finite(values.get(name)) for name in self.names)])

    def rows(self) -> list[Row]:
        """Return all rows, oldest first."""
        return list(self._rows)

    def take_new_rows(self) -> list[Row]:
        """Return the rows completed since the last call, oldest first."""
        rows, count = list(self._rows), min(self._new, len(self._rows))
        if count < 2:
            return []
        self._new = 1
        return rows[-count:-1]

    def clear(self) -> None:
        self._rows.clear()
        self._slot, self._new = None, 0


def _finite(value: float | None) -> float | None:
    return round(value, 6) if value is not None and math.isfinite(value) else None


COMMAND: Final = "#8a94a0"
ACTUAL: Final = "#1d5fd1"
COLORS: Final = ("#1d5fd1", "#e07a00", "#16803c", "#b0188f", "#6b4fbb", "#0f8b8d", "#b01818", "#5b6673")
SHOWN_JOINTS: Final = 12
STILL_S: Final = 1.0
_MOVED: Final = 1e-3  # rad or m: noise of an encoder below this is no motion


@dataclass(frozen=True, slots=True)
class Line:
    """Line of a chart; `row` is the name of the plotted value in the history."""

    row: str
    name: str
    color: str


@dataclass(frozen=True, slots=True)
class Chart:
    """Chart in a group; the vertical range always includes `low` and `high`."""

    key: str
    title: str
    group: str
    lines: tuple[Line, ...]
    low: float = -1.0
    high: float = 1.0


def names(joints: Sequence[str], buses: Sequence[str]) -> list[str]:
    """Return the names of the values that a history stores for the buses and the first `SHOWN_JOINTS` joints."""
    of_joints = [f"{joint} {name}" for joint in joints[:SHOWN_JOINTS] for name in ("command", "actual", "error")]
    return [*of_joints, "work", "cycle", *(f"load {bus}" for bus in buses)]


def charts(joints: Sequence[str], buses: Sequence[str]) -> list[Chart]:
    """Return the charts of a robot; the group "joints" precedes the group "cycle"."""
    shown = joints[:SHOWN_JOINTS]
    plots = [
        Chart(
            joint,
            joint,
            "joints",
            (Line(f"{joint} command", "command", COMMAND), Line(f"{joint} actual", "actual", ACTUAL)),
        )
        for joint in shown
    ]
    errors = tuple(Line(f"{joint} error", joint, COLORS[n % len(COLORS)]) for n, joint in enumerate(shown))
    loads = tuple(Line(f"load {bus}", bus, COLORS[2 + n % 5]) for n, bus in enumerate(buses))
    plots.append(Chart("error", "Tracking error", "joints", errors))
    plots.append(Chart("cycle", "Cycle time, ms", "cycle", (Line("cycle", "between cycles", ACTUAL),), 0.0))
    plots.append(Chart("work", "Work in a cycle, ms", "cycle", (Line("work", "work", COLORS[1]),), 0.0))
    return [*plots, Chart("load", "Bus load, %", "cycle", loads, 0.0)] if loads else plots


def titles(interfaces: Mapping[str, str], linear: frozenset[str]) -> dict[str, str]:
    """Return chart titles with units by chart key; `interfaces` are by joint, `linear` joints are prismatic."""

    def unit(joint: str, interface: str) -> str:
        return UNITS[interface][joint in linear]

    by_joint = {joint: f"{joint} {interface}, {unit(joint, interface)}" for joint, interface in interfaces.items()}
    units = sorted({unit(joint, interface) for joint, interface in interfaces.items()})
    return by_joint | {"error": f"Tracking error{', ' + ' and '.join(units) if units else ''}"}


def commanded_interfaces(controllers: Sequence[ControllerReading], state: StateSample) -> dict[str, str]:
    """Return the commanded interface of each joint that an active controller commands.

    For a drive that takes targets, the mode of operation determines the interface.
    """
    quantities = {drive.joint: drive.quantity for drive in drive_targets(state, controllers) if drive.quantity}
    for controller in controllers:
        for claimed in controller.claims if controller.state == "active" else ():
            joint, _, interface = claimed.rpartition("/")
            if interface in UNITS:
                quantities.setdefault(joint, interface)
    return quantities


class Sampler:
    """Converter of state samples to plotted values."""

    def __init__(self) -> None:
        self._before: tuple[float, int] | None = None

    def take(self, state: StateSample, interfaces: Mapping[str, str]) -> dict[str, float | None]:
        values: dict[str, float | None] = {}
        for name, joint in state.joints.items():
            interface = interfaces.get(name)
            by_interface = {"position": joint.position, "velocity": joint.velocity, "effort": joint.effort}
            actual = by_interface.get(interface or "velocity")
            command = joint.command if interface else None
            if command is None:  # no controller commands the joint: the hardware holds
                command = actual if interface == "position" else 0.0
            values[f"{name} actual"], values[f"{name} command"] = actual, command
            values[f"{name} error"] = 0.0 if actual is None or command is None else command - actual
        values["work"] = 1e3 * state.cycle.work_s
        values["cycle"] = self._cycle(state.time, state.cycle.count)
        for bus, load in state.load.items():
            values[f"load {bus}"] = None if load is None else 100 * load
        return values

    def _cycle(self, time: float, count: int) -> float | None:
        before, self._before = self._before, (time, count)
        if before is None or count <= before[1]:
            return None
        return 1e3 * (time - before[0]) / (count - before[1])


class Stillness:
    """Detector of standstill: no motion and no new command for `STILL_S` seconds of the robot's time."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[float, float | None]] = {}
        self._since = 0.0

    def take(self, state: StateSample) -> bool:
        """Update from a state sample; return True at standstill."""
        for name, joint in state.joints.items():
            place, command = joint.position or 0.0, joint.command
            before = self._known.get(name)
            if before is None or abs(place - before[0]) > _MOVED or command != before[1]:
                self._known[name], self._since = (place, command), state.time
        if state.time < self._since:  # the clock was set back
            self._since = state.time
        return state.time - self._since >= STILL_S
