"""Invariants of targets: a drive is told what its client commanded, and its shaft does what the drive is told.

The first holds the targets on the wire against the values that clients have commanded joint by joint, scaled as bus.yml
says; a target between them and standstill is one too, since stops and limits lead there. The second holds the shaft
against the targets on the wire, in the modes whose target is a velocity (PV, CSV) or a place at every SYNC (CSP): it
may lag by a few cycles and along the drive's own ramps, and never goes beyond. Who was disturbed since its last enable
is not judged, nor what stands on a floor. Times in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.hardware.interfaces import VELOCITY
from canopen_control.simulation.wire_view import watched_joints

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.simulation.acts import Act
    from canopen_control.simulation.disturbed_nodes import DisturbedNodes
    from canopen_control.simulation.motions import Motion
    from canopen_control.simulation.simulated_robot import SimulatedRobot
    from canopen_control.simulation.wire_view import NodeView, WireView
    from canopen_control.virtual.virtual_drive import VirtualDrive

__all__ = ["TargetRules"]

_MS: Final = 1_000_000
_LAG_NS: Final = 120 * _MS  # between a target on the wire and the shaft, or a command and its target; some cycles
_SETTLED_NS: Final = 300 * _MS  # after an enable, or another controller
_KEPT: Final = 64  # commands of a joint that are looked back at
_COMMAND, _FOLLOWS = 0x18F, 0x0F  # of a controlword: operation enabled, no halt
_SHOWN, _UNLIMITED = 0x86F, 0x27  # of a statusword: OPERATION ENABLED, no limit active (bit 11)
_PV, _CSV, _CSP = int(OperationMode.PV), int(OperationMode.CSV), int(OperationMode.CSP)
_SLACK: Final = 0.02  # of a target, by which it may be rounded or a clock be off
_AT_ONCE: Final = 1e12  # counts/s^2
_LEAST: Final = 5.0  # counts/s, or counts


class _Followed:
    """One axis, and between which speeds its shaft has to be."""

    def __init__(self, view: NodeView) -> None:
        self.view = view
        self.low = self.high = 0.0
        self.at = 0  # when it was judged last, 0: not since its enable
        self.told = False
        self._slope_of: tuple[VirtualDrive | None, int] = None, -1  # with which version of its values
        self._slope = 0.0

    def slope(self, drive: VirtualDrive) -> float:
        """Return the slower one of the drive's two ramps, in counts/s^2; those of a stop count too."""
        version = drive.objects.store.version
        if self._slope_of[1] != version or self._slope_of[0] is not drive:
            self._slope_of, self._slope = (drive, version), _slope(drive)
        return self._slope

    def rest(self) -> None:
        """Begin anew with the next enable."""
        self.at, self.told = 0, False

    def ramp(self, low: float, high: float, slope: float, now: int, speed: float) -> None:
        """Bring the bounds of the speed nearer to those of the targets, as fast as the drive's ramp at least."""
        if not self.at:
            self.low, self.high = min(speed, low), max(speed, high)
        else:
            way = slope * (now - self.at) / 1e9
            self.low = min(low, self.low + way)
            self.high = max(high, self.high - way)
        self.at = now


class TargetRules:
    """Judges targets; `tell(rule, text)` takes breaches. `asked` and `sampled` are called as time passes."""

    def __init__(
        self,
        robot: SimulatedRobot,
        views: Mapping[str, WireView],
        motions: Sequence[Motion],
        disturbed: DisturbedNodes,
        tell: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._tell = robot, disturbed, tell
        self._axes = [_Followed(node) for view in views.values() for node in view.nodes.values()]
        self._ends = {each.controller: each.ends for each in motions}
        self._scales = _velocity_scales(robot)
        self._commanded: dict[str, deque[tuple[int, float]]] = {}  # joint -> what it was commanded last
        self._others_until = 0  # until when something else than values joint by joint may lead
        self._wrong: set[str] = set()

    def asked(self, now: int, act: Act) -> None:
        """Take what a client asks for."""
        heard = max(now, self._robot.host.stalled_until)
        if act.kind != "command" or not self._ends.get(act.target):
            if act.kind in ("command", "trajectory", "activate", "deactivate"):
                self._others_until = 1 << 62
                self._commanded.clear()
            return
        self._others_until = min(self._others_until, heard + _SETTLED_NS)
        for name, value in zip(self._ends[act.target], act.values, strict=False):
            joint, _, interface = name.partition("/")
            if interface == VELOCITY:
                self._commanded.setdefault(joint, deque(maxlen=_KEPT)).append((heard, value))

    def sampled(self, now: int) -> None:
        """Judge what drives are told and do now."""
        if self._robot.floor is not None:
            return
        for axis in self._axes:
            view = axis.view
            device = self._robot.drives[view.node_id].device
            drive = None if device is None else device.drives.get(0)
            if drive is None or not view.plan.axes or not self._may_judge(view, now):
                axis.rest()
                continue
            self._judge_shaft(axis, drive, now)
        if now > self._others_until:
            self._judge_targets(now)

    def _may_judge(self, view: NodeView, now: int) -> bool:
        """Whether an axis follows targets undisturbed since its enable."""
        if view.controlword & _COMMAND != _FOLLOWS or view.statusword & _SHOWN != _UNLIMITED:
            return False
        return self._disturbed.last(view.node_id) < view.enabled_at < now - _SETTLED_NS

    # -- a shaft does what its drive is told

    def _judge_shaft(self, axis: _Followed, drive: VirtualDrive, now: int) -> None:
        mode, plant, units = drive.modes.number, drive.mover.plant, drive.objects.units
        if mode not in (_PV, _CSV, _CSP):
            axis.rest()
            return
        told = axis.view.targets_since(o.TARGET_POSITION if mode == _CSP else o.TARGET_VELOCITY, now - _LAG_NS)
        if not told:
            axis.rest()
        elif mode == _CSP:
            least, most = min(told), max(told)
            place, reach = float(units.user(plant.position)), most - least + _reach(drive)
            self._within(axis, place, told, 1.0, (least - reach, most + reach), "is at {} of its units")
        else:
            limited, unit = drive.limits.velocity, units.velocity
            low = high = limited(told[0] * unit)
            if len(told) > 1:
                ends = limited(min(told) * unit), limited(max(told) * unit)
                low, high = min(ends), max(ends)
            axis.ramp(low, high, axis.slope(drive) if mode == _PV else _AT_ONCE, now, plant.velocity)
            self._within(axis, plant.velocity, told, unit, (axis.low, axis.high), "turns at {} counts/s")

    def _within(
        self, axis: _Followed, value: float, told: Sequence[int], unit: float, bounds: tuple[float, float], does: str
    ) -> None:
        """Tell of a value that is not between bounds, and what the drive was told: targets in a unit."""
        low, high = bounds
        slack = _LEAST + _SLACK * max(abs(low), abs(high))
        if low - slack <= value <= high + slack:
            axis.told = False
        elif not axis.told:
            axis.told = True
            said = does.format(round(value))
            text = (
                f"the shaft of node {axis.view.node_id} {said}, told {', '.join(f'{unit * each:.0f}' for each in told)}"
            )
            self._tell("target_missed", text)

    # -- a drive is told what was commanded

    def _judge_targets(self, now: int) -> None:
        for axis in self._axes:
            view = axis.view
            for joint, scale in self._scales.get(view.node_id, ()):
                told = view.targets.get(o.TARGET_VELOCITY)
                commands = self._commanded.get(joint)
                if told is None or not commands or not self._may_judge(view, now):
                    self._wrong.discard(joint)
                    continue
                self._judge_target(joint, float(told), [scale * each for each in _recent(commands, now)])

    def _judge_target(self, joint: str, told: float, commanded: list[float]) -> None:
        low, high = min(0.0, *commanded), max(0.0, *commanded)
        slack = 1.0 + _SLACK * max(-low, high)
        if low - slack <= told <= high + slack:
            self._wrong.discard(joint)
        elif joint not in self._wrong:
            self._wrong.add(joint)
            self._tell("target_wrong", f"the drive of {joint} is told {told:.0f}, commanded was {commanded[-1]:.0f}")


def _recent(commands: deque[tuple[int, float]], now: int) -> list[float]:
    """Return the value that counts, and those before that may still be told."""
    found = []
    for at, value in reversed(commands):
        found.append(value)
        if at < now - _LAG_NS:
            break
    return found[::-1]


def _velocity_scales(robot: SimulatedRobot) -> dict[int, list[tuple[str, float]]]:
    """Return of each node the joints of its first axis with their scales, as the files have them."""
    found: dict[int, list[tuple[str, float]]] = {}
    for joint, node in watched_joints(robot.setup):
        found.setdefault(node.node_id, []).append((joint, node.units.of_axis(0)["vel_to_dev"]))
    return found


def _slope(drive: VirtualDrive) -> float:
    """Return the slower one of a drive's two ramps, in counts/s^2; those of a stop count too."""
    objects = drive.objects
    ramps = [objects.ramp(index) for index in (o.PROFILE_ACCELERATION, o.PROFILE_DECELERATION) if objects.has(index)]
    return min(ramps, default=_AT_ONCE) or _AT_ONCE


def _reach(drive: VirtualDrive) -> float:
    """Return how far a shaft may be from its target: the window of 0x6065, where that bounds it."""
    window = drive.objects.number(o.FOLLOWING_ERROR_WINDOW)
    return float(window) if 0 < window < 1 << 30 else 0.0
