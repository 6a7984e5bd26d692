"""Rules about cyclic set-points: causes of rough motion in CSP and CSV.

A drive in a cyclic mode applies one set-point with each SYNC and interpolates over the SYNC period (CiA 402-2; CiA 301,
7.5.2.35). RPDOs that act on arrival pass the host's jitter to the motor; with set-points for every other SYNC the motor
stops in between; feedback that an inhibit time delays is older than a period. 0x60C2 is checked and written by the plan
(`master.plan`). An RPDO deadline (event timer) shorter than two cycles may expire when a cycle is late.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.modes import OperationMode
from canopen_control.od.issues import Severity
from canopen_control.runtime.sync_choice import CyclicAxis, cyclic_axes, joint_words
from canopen_control.urdf.robot_model import WheelGeometry

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from canopen_control.controllers.base import Controller
    from canopen_control.controllers.controllers_file import ControllerConfig, ControllersFile
    from canopen_control.master.config import BusConfig
    from canopen_control.master.keys import NodeConfig
    from canopen_control.master.plan_builder import PlannedPdo
    from canopen_control.runtime.robot_files import RobotFiles
    from canopen_control.urdf.description import UrdfDescription
    from canopen_control.yamlfile.node import Node


# Input and findings of the rules of `check`. The input are the readable files of a robot.
#
# ERROR: the robot cannot be run. WARNING: the robot runs, with surprising results. NOTE: information. Line 0 refers to
# the complete file.


_ORDER = (Severity.ERROR, Severity.WARNING, Severity.NOTE)


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding about a line of a file; `fix` is advice, "" if `text` contains the advice."""

    path: str
    line: int
    severity: Severity
    text: str
    fix: str = ""
    column: int = 0  # 0 if unknown
    source: str = ""  # the line of the file, with a caret below the column, for display

    def __str__(self) -> str:
        place = ":".join([self.path, *(str(number) for number in (self.line, self.column) if number)])
        fix = f"; {self.fix}" if self.fix else ""
        source = f"\n{self.source}" if self.source else ""
        return f"{place}: {self.severity.value}: {self.text}{fix}{source}"


def sorted_findings(findings: list[Finding]) -> list[Finding]:
    """Return findings by file and line without duplicates, the most severe finding of a line first."""
    once = dict.fromkeys(findings)
    return sorted(once, key=lambda finding: (finding.path, finding.line, _ORDER.index(finding.severity), finding.text))


@dataclass
class CheckedRobot:
    """Files of a robot as input of the rules; None stands for a file that could not be read.

    `requested_controllers` are the names of --controller. `mock` and `real` override the plugins of the description.
    `started` are the controllers that a run would activate, None if unknown; `chosen` means that the user named them.
    """

    files: RobotFiles
    bus: BusConfig | None = None
    control: ControllersFile | None = None
    description: UrdfDescription | None = None
    requested_controllers: Sequence[str] = ()
    mock: bool = False
    real: bool = False
    started: frozenset[str] | None = None
    chosen: bool = False
    launch_namespaces: dict[str, str] = field(default_factory=dict)
    configured: dict[str, Controller] = field(default_factory=dict)

    def severity(self, name: str) -> Severity:
        """Return the severity of a controller's errors: WARNING if a run does not activate the controller."""
        waits = (self.chosen or self.mock) and self.started is not None and name not in self.started
        return Severity.WARNING if waits else Severity.ERROR

    def config(self, name: str) -> ControllerConfig:
        assert self.control is not None  # there is no configured controller without a file
        return self.control.controllers[name]

    @property
    def geometry(self) -> WheelGeometry | None:
        """Positions and sizes of the wheels in the description, None without a description."""
        return None if self.description is None else WheelGeometry(self.description.model)


_RATE_HZ = 100  # of the cycle, if neither SYNC nor a readable ros2_controllers.yaml defines it
_ON_ARRIVAL: Final = (254, 255)
_FEEDBACK: Final = (
    objects.STATUSWORD,
    objects.POSITION_ACTUAL,
    objects.VELOCITY_ACTUAL,
    objects.TORQUE_ACTUAL,
)


def check_timing(
    config: BusConfig, control: ControllersFile | None, description: UrdfDescription | None
) -> Iterator[Finding]:
    """Find timing problems of the cyclic set-points, the feedback and the RPDO deadlines on a bus."""
    yield from _never_in_time(config, cycle_ns(config, control))
    if not config.master.sync_period or description is None:
        return
    axes = cyclic_axes(config, description)
    yield from _in_the_middle(config, axes)
    yield from _repeated(config, control, axes)
    yield from _on_arrival(config, axes)
    yield from _held_back(config, axes)


def cycle_ns(config: BusConfig, control: ControllersFile | None) -> int:
    """Return the cycle period in ns: the SYNC period, or without SYNC the controllers' period."""
    rate = control.update_rate if control is not None else _RATE_HZ
    return config.master.sync_period * 1000 or 1_000_000_000 // rate


def _never_in_time(config: BusConfig, period_ns: int) -> Iterator[Finding]:
    """Find RPDO deadlines (event timer, 0x1400:05) shorter than two cycles."""
    settings = _FindingsByPlace(config, "rpdo.{}.event_deadline"), _FindingsByPlace(config, "rpdo.{}.event_timer")
    for name, plan in config.plans.items():
        node = config.nodes[name]
        for layout in plan.rpdos:
            if not 0 < layout.event_ms * 1_000_000 < 2 * period_ns:
                continue
            pdo = node.boot.rpdo.get(layout.number)
            text = (
                f"RPDO {layout.number} of {name}{{more}} has a deadline of {layout.event_ms} ms "
                f"(0x{0x1400 + layout.number - 1:04X}:05), but is sent with a cycle of {period_ns / 1e6:g} ms: "
                "a late cycle causes EMCY 0x8250"
            )
            fix = f"set event_deadline: {math.ceil(3 * period_ns / 1e6)} or more, or 0 for none"
            settings[pdo is not None and pdo.event_timer is not None].add(node, layout, text, fix)
    for setting in settings:
        yield from setting.findings()


def _in_the_middle(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find a cycle half a period after an external SYNC, which loses set-points when late."""
    master = config.master
    if axes and not master.follows_closely and master.sync_producer in ("kernel", "other"):
        text = (
            f"sync_order: last with sync_producer: {master.sync_producer}: the cycle is half a period after SYNC, "
            f"and a cycle that is {master.sync_period / 2000:g} ms late repeats a set-point of {joint_words(axes)} and "
            "loses another"
        )
        yield Finding(config.path, config.period_line, Severity.WARNING, text, "remove sync_order")


def _repeated(config: BusConfig, control: ControllersFile | None, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find controllers that are slower than SYNC, so that each CSP set-point is sent several times."""
    line = 0 if control is None else control.manager_lines.get("update_rate", 0)
    joints = [axis.joint for axis in axes if axis.mode is OperationMode.CSP]
    if control is None or not line or not joints:
        return
    cycle = 1_000_000 / config.master.sync_period
    syncs = max(1, round(cycle / control.update_rate))
    if syncs > 1:
        text = (
            f"controllers run at {control.update_rate} Hz, but the SYNC rate of {config.path} is {cycle:g} Hz: each "
            f"position of {', '.join(joints)} is sent {syncs} times, and in CSP the drive stops in between"
        )
        yield Finding(control.path, line, Severity.WARNING, text, f"set update_rate: {cycle:g}")


def _on_arrival(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find set-points that take effect on reception instead of at SYNC."""
    setting = _FindingsByPlace(config, "rpdo.{}.transmission")
    for axis in axes:
        for layout in config.plans[axis.node.name].rpdos:
            carries = any(mapped.index == axis.target for mapped in layout.objects)
            if carries and layout.transmission_type in _ON_ARRIVAL:
                text = (
                    f"RPDO {layout.number} of {axis.node.name}{{more}} carries 0x{axis.target:04X}, the set-point of "
                    f"{axis.joint} in {axis.mode.name}, with transmission {layout.transmission_type}: it takes effect "
                    "on reception, not with SYNC"
                )
                fix = f"set rpdo: {layout.number}: transmission: 1, otherwise the motor follows the computer's jitter"
                setting.add(axis.node, layout, text, fix)
    yield from setting.findings()


def _held_back(config: BusConfig, axes: list[CyclicAxis]) -> Iterator[Finding]:
    """Find event-driven feedback whose inhibit time exceeds the SYNC period."""
    setting, period_us = _FindingsByPlace(config, "tpdo.{}.inhibit_time"), config.master.sync_period
    for axis in axes:
        node = axis.node
        for layout in config.plans[node.name].tpdos:
            feedback = any(objects.axis_of(mapped.index)[0] in _FEEDBACK for mapped in layout.objects)
            if not feedback or layout.transmission_type not in _ON_ARRIVAL:
                continue
            override = node.boot.tpdo.get(layout.number)
            entry = config.dictionaries[node.name].get(0x1800 + layout.number - 1, 3)
            default = entry.value if entry is not None and isinstance(entry.value, int) else 0
            inhibit = override.inhibit_time if override is not None and override.inhibit_time is not None else default
            if inhibit * 100 > period_us:
                text = (
                    f"TPDO {layout.number} of {node.name}{{more}} is sent every {inhibit / 10:g} ms at most (inhibit "
                    f"time), SYNC every {period_us / 1000:g} ms: feedback is older than a period"
                )
                setting.add(node, layout, text, f"set tpdo: {layout.number}: transmission: 1, or inhibit_time: 0")
    yield from setting.findings()


class _FindingsByPlace:
    """Findings about one PDO key, merged by place: a key in `defaults` is reported once for all nodes."""

    def __init__(self, config: BusConfig, key: str) -> None:
        self._config, self._key = config, key
        self._by_place: dict[tuple[int, int], tuple[Node, str, str, set[str]]] = {}

    def add(self, node: NodeConfig, layout: PlannedPdo, text: str, fix: str) -> None:
        """Add a finding; `{more}` in the text is replaced by the number of other nodes."""
        place = self._config.place(node.name, self._key.format(layout.number))
        self._by_place.setdefault((place.line, place.column), (place, text, fix, set()))[3].add(node.name)

    def findings(self) -> Iterator[Finding]:
        for place, text, fix, names in self._by_place.values():
            more = f" and of {len(names) - 1} more" if len(names) > 1 else ""
            sentence = text.replace("{more}", more)
            yield Finding(place.path, place.line, Severity.WARNING, sentence, fix, column=place.column)
