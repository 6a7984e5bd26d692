"""Invariants of targets: drives receive the clients' commands, and shafts follow the targets.

The first invariant compares targets on the bus with the values commanded per joint, scaled as in bus.yml; a target
between the command and standstill is valid too, because of stops and limits. The second compares the shaft with the
targets on the bus, in modes with a target velocity (PV, CSV) or a position at every SYNC (CSP): it may lag by some
cycles and by the drive's own ramps, and never exceeds the targets. Drives disturbed since their last enable, and drives
on a floor, are not checked.

In every mode a target stays within the drive's own limits (0x607D, 0x607F) and does not push against a limit switch, a
renewed command is followed, and a disabled drive has standstill as its target. Times are in ns.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects as o
from canopen_control.cia402.modes import OperationMode
from canopen_control.simulation.wire_view import watched_joints
from canopen_control.urdf.joint_element import VELOCITY
from canopen_control.virtual.axis_motion import wrap32

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.simulation.answer_invariants import AnswerInvariants
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.wire_view import DisturbedNodes, ObservedNode, WireView
    from canopen_control.virtual.scenario import ScenarioEvent
    from canopen_control.virtual.virtual_drive import VirtualDrive


_MS: Final = 1_000_000
_RENEWED_NS: Final = 1000 * _MS  # two commands with more time between them are two motions
_LAG_NS: Final = 120 * _MS  # delay from a target on the bus to the shaft, or from a command to its target; some cycles
_SETTLED_NS: Final = 300 * _MS  # time after an enable, or a switch of controllers
_KEPT: Final = 64  # number of commands kept per joint
_PV, _CSV, _CSP = int(OperationMode.PV), int(OperationMode.CSV), int(OperationMode.CSP)
_VELOCITY: Final = o.TARGET_VELOCITY
_SLACK: Final = 0.02  # relative tolerance of a target for rounding and clock errors
_CALM_NS: Final = 1000 * _MS  # time since a disturbance or boot of the drive
_OFF_NS: Final = 500 * _MS  # time since the drive was last enabled
_LIMIT: Final = 0x800  # statusword bit of an active limit
_UNLIMITED_ABOVE: Final = 1 << 31
_STOPS: Final = ("stop", "latch", "axis", "activate", "deactivate")
_AT_ONCE: Final = 1e12  # counts/s^2
_MIN: Final = 5.0  # counts/s, or counts


class _Followed:
    """Axis with the range of its permitted shaft speeds."""

    def __init__(self, view: ObservedNode) -> None:
        self.view = view
        self.low = self.high = 0.0
        self.at = 0  # time of the last check, 0: none since its enable
        self.followed_at = 0  # time at which it last followed targets, undisturbed since its enable
        self.reported = False
        self.wrong = ""  # the currently violated rule, of those valid in every mode
        self._limits_of: tuple[VirtualDrive | None, int] = None, -1
        self._limits = (0, 0, 0)
        self._slope_of: tuple[VirtualDrive | None, int] = None, -1  # drive and version of its values used for the slope
        self._slope = 0.0

    def slope(self, drive: VirtualDrive) -> float:
        """Return the smaller of profile acceleration and deceleration in counts/s^2; cached until an object changes."""
        objects = drive.objects
        version = objects.store.version
        if self._slope_of[1] != version or self._slope_of[0] is not drive:
            indices = (o.PROFILE_ACCELERATION, o.PROFILE_DECELERATION)
            ramps = [objects.ramp(index) for index in indices if objects.has(index)]
            self._slope_of, self._slope = (drive, version), min(ramps, default=_AT_ONCE) or _AT_ONCE
        return self._slope

    def limits(self, drive: VirtualDrive, now: int) -> tuple[int, int, int]:
        """Return the limits of 0x607D and the maximum velocity of 0x607F (0: none); cached for a second."""
        if self._limits_of != (version := (drive, now // _CALM_NS)):
            objects = drive.objects
            low, high = (objects.number(o.SOFTWARE_POSITION_LIMIT, sub) for sub in (1, 2))
            most = objects.number(o.MAX_PROFILE_VELOCITY)
            ends = (low, high) if low < high else (0, 0)
            self._limits_of, self._limits = version, (*ends, most if most < _UNLIMITED_ABOVE else 0)
        return self._limits

    def rest(self) -> None:
        """Reset the check; it restarts at the next sample in which the axis can be checked."""
        self.at, self.reported = 0, False

    def ramp(self, low: float, high: float, slope: float, now: int, speed: float) -> None:
        """Permit speeds from `low` to `high`, and narrow the earlier range at `slope`; at first, permit `speed` too."""
        if not self.at:
            self.low, self.high = min(speed, low), max(speed, high)
        else:
            way = slope * max(now - self.at, 0) / 1e9
            self.low = min(low, self.low + way)
            self.high = max(high, self.high - way)
        self.at = now


class _Commanders:
    """Times of a controller's last commands, with and without dead-man function."""

    def __init__(self) -> None:
        self._leaving = self._staying = 0

    def command(self, at: int, *, leaves: bool) -> None:
        """Record a command; with `leaves` the command ends with the client's connection."""
        if leaves:
            self._leaving = at
        else:
            self._staying = at

    @property
    def go_on(self) -> bool:
        """Whether commands continue after the dead-man client has left, because another client's command is newer."""
        return self._staying > self._leaving + _LAG_NS


class TargetInvariants:
    """Checks the targets on the bus and the motion of the shafts; violations are passed to `report(rule, text)`."""

    def __init__(
        self,
        robot: RobotUnderTest,
        views: Mapping[str, WireView],
        motions: Sequence[SampleMotion],
        disturbed: DisturbedNodes,
        answers: AnswerInvariants,
        report: Callable[[str, str], None],
    ) -> None:
        self._robot, self._disturbed, self._answers, self._report = robot, disturbed, answers, report
        self._axes = [_Followed(node) for view in views.values() for node in view.nodes.values()]
        self._interfaces = {motion.controller: motion.interfaces for motion in motions}
        self._scales = _velocity_scales(robot)
        self._commanded: dict[str, deque[tuple[int, float]]] = {}  # joint -> its last commands
        self._stopped_at = 0  # time of the last request that may end a command
        self._commanders: dict[str, _Commanders] = {}  # state of each controller
        self._others_until = 0  # until when a command other than values per joint may be active
        self._wrong: set[str] = set()
        self._lost: set[str] = set()

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Record a client request that commands joints or may end commands."""
        reception = max(now, self._robot.host.stalled_until)
        commanders = self._commanders.setdefault(act.target, _Commanders())
        if act.kind in _STOPS or (act.kind == "leave" and not commanders.go_on):
            self._stopped_at = reception
        elif act.kind == "command":
            commanders.command(reception, leaves=bool(act.name))
        if act.kind != "command" or not self._interfaces.get(act.target):
            if act.kind in ("command", "trajectory", "activate", "deactivate"):
                self._others_until = 1 << 62
                self._commanded.clear()
            return
        self._others_until = min(self._others_until, reception + _SETTLED_NS)
        for name, value in zip(self._interfaces[act.target], act.values, strict=False):
            joint, _, interface = name.partition("/")
            if interface == VELOCITY:
                self._commanded.setdefault(joint, deque(maxlen=_KEPT)).append((reception, value))

    def on_sample(self, now: int) -> None:
        """Check the targets and the motion of all drives."""
        if self._robot.floor is not None:
            return
        for axis in self._axes:
            view = axis.view
            device = self._robot.drives[view.node_id].device
            drive = None if device is None else device.drives.get(0)
            if drive is not None and view.plan.axes:
                self._judge_command(axis, drive, now)
            if drive is None or not view.plan.axes or not self._may_judge(view, now):
                axis.rest()
                continue
            axis.followed_at = now
            self._judge_shaft(axis, drive, now)
        if now > self._others_until:
            self._judge_targets(now)

    def _may_judge(self, view: ObservedNode, now: int) -> bool:
        """Whether an axis follows targets, was enabled some time ago, and has not been disturbed since its enable."""
        return view.follows and self._disturbed.last(view.node_id) < view.enabled_at < now - _SETTLED_NS

    # -- all modes

    def _judge_command(self, axis: _Followed, drive: VirtualDrive, now: int) -> None:
        """Check that the target of an enabled drive respects its limits, and that of a disabled drive is standstill."""
        view = axis.view
        into_limit = ""
        if view.enabled:
            into_limit = self._commands_into_limit(view, drive, now)
            wrong = into_limit or self._beyond(axis, drive, now)
        elif (
            view.shown_enabled_at < now - _OFF_NS and now - view.controlword_at < _LAG_NS < now - view.target_changed_at
        ):
            wrong = self._not_at_rest(view, drive, now)
        else:
            wrong = ""
        if wrong and not axis.wrong and (into_limit or self._disturbed.is_calm(view, now)):
            rule = "limit_ignored" if view.enabled else "target_disabled"
            self._report(rule, f"node {view.node_id} is commanded {wrong}")
            axis.wrong = wrong
        elif not wrong:
            axis.wrong = ""

    def _all_calm(self, now: int) -> bool:
        """Whether no disturbance, start or client request can have stopped the robot recently."""
        disturbed = max((self._disturbed.last(axis.view.node_id) for axis in self._axes), default=0)
        return max(disturbed, self._stopped_at, self._robot.started_ns) < now - 3 * _CALM_NS

    def _beyond(self, axis: _Followed, drive: VirtualDrive, now: int) -> str:
        """Return a text if the target of an enabled drive is beyond the drive's limits, else ""."""
        low, high, most = axis.limits(drive, now)
        targets, mode = axis.view.targets, drive.modes.number
        if mode == _CSP:
            target = targets.get(o.TARGET_POSITION)
            if low == high or target is None or low <= target <= high:
                return ""
            place = float(drive.objects.units.user(drive.mover.plant.position))
            inside = low - _MIN <= place <= high + _MIN  # otherwise it may hold its position
            return f"to move to {target}, beyond its software position limits {low} and {high}" if inside else ""
        if mode not in (_PV, _CSV):
            return ""
        target = targets.get(_VELOCITY, 0)
        if most and abs(target) > most + 1:
            return f"to move at {target}, above its maximum velocity {most}"
        return ""

    def _commands_into_limit(self, view: ObservedNode, drive: VirtualDrive, now: int) -> str:
        """Return a text if the target pushes an enabled drive against an active limit, else "".

        The blocked direction is the direction in which the target points while the shaft is at standstill.
        """
        if not view.statusword & _LIMIT or view.limited_at > now - _OFF_NS or drive.modes.number not in (_PV, _CSV):
            return ""
        if not self._robot.up:  # nobody commands
            return ""
        targets = view.targets_since(_VELOCITY, now - _LAG_NS)
        into_limit = bool(targets) and all(targets) and abs(drive.mover.plant.velocity) < _MIN
        return f"to move at {targets[-1]}, against its active limit" if into_limit else ""

    def _not_at_rest(self, view: ObservedNode, drive: VirtualDrive, now: int) -> str:
        """Return a text if the target of a disabled drive is not standstill, else ""."""
        if view.commanded or now - view.status_at > _LAG_NS:
            return ""
        if target := view.targets.get(_VELOCITY, 0):
            return f"to move at {target} while disabled"
        place = view.targets.get(o.TARGET_POSITION)
        plant, units = drive.mover.plant, drive.objects.units
        if place is None or abs(plant.velocity) > _MIN:
            return ""
        here = float(units.user(plant.position))
        off = abs(wrap32(place - round(here)))
        return f"to move to {place} while disabled at {here:.0f}" if off > _MIN + _reach(drive) else ""

    # -- the shaft follows the targets

    def _judge_shaft(self, axis: _Followed, drive: VirtualDrive, now: int) -> None:
        mode, plant, units = drive.modes.number, drive.mover.plant, drive.objects.units
        if mode not in (_PV, _CSV, _CSP):
            axis.rest()
            return
        targets = axis.view.targets_since(o.TARGET_POSITION if mode == _CSP else o.TARGET_VELOCITY, now - _LAG_NS)
        if not targets:
            axis.rest()
        elif mode == _CSP:
            least, most = min(targets), max(targets)
            place, reach = float(units.user(plant.position)), most - least + _reach(drive)
            self._within(axis, drive, place, targets, 1.0, (least - reach, most + reach), "is at {} position units")
        else:
            limited, unit = drive.limits.velocity, units.velocity
            low = high = limited(targets[0] * unit)
            if len(targets) > 1:
                ends = limited(min(targets) * unit), limited(max(targets) * unit)
                low, high = min(ends), max(ends)
            moved_at = drive.mover.time or now  # a drive that computes late still has an earlier speed
            slope = axis.slope(drive) if mode == _PV else _AT_ONCE
            if _near_limit(drive, max(-low, high), slope):
                axis.rest()
                return
            axis.ramp(low, high, slope, moved_at, plant.velocity)
            bounds = axis.low, axis.high
            self._within(axis, drive, plant.velocity, targets, unit, bounds, "turns at {} counts/s")

    def _within(
        self,
        axis: _Followed,
        drive: VirtualDrive,
        value: float,
        targets: Sequence[int],
        unit: float,
        bounds: tuple[float, float],
        does: str,
    ) -> None:
        """Report a position or speed outside its bounds; `unit` converts the targets for the text.

        A drive that ignores set-points, or takes them from elsewhere, is healthy, but the robot must report this.
        """
        low, high = bounds
        slack = _MIN + _SLACK * max(abs(low), abs(high))
        if low - slack <= value <= high + slack:
            axis.reported = False
        elif not axis.reported:
            axis.reported = True
            motion = does.format(round(value))
            commanded = ", ".join(f"{unit * target:.0f}" for target in targets)
            text = f"the shaft of node {axis.view.node_id} {motion}, commanded were {commanded}"
            if drive.modes.gate is not None and drive.modes.gate.closed_by:
                self._answers.unless_reported(axis.view.node_id, "target_missed", text, axis.view.enabled_at)
            else:
                self._report("target_missed", text)

    # -- the targets follow the commands

    def _judge_targets(self, now: int) -> None:
        for axis in self._axes:
            view = axis.view
            for joint, scale in self._scales.get(view.node_id, ()):
                target = view.targets.get(o.TARGET_VELOCITY)
                commands = self._commanded.get(joint)
                if target is None or not commands or axis.followed_at != now:
                    self._wrong.discard(joint)
                    continue
                recent = _recent(commands, now)
                self._judge_target(joint, float(target), [scale * value for value in recent])
                if not target or joint in self._lost:
                    self._judge_life(joint, view, recent, now)

    def _judge_target(self, joint: str, target: float, commanded: list[float]) -> None:
        low, high = min(0.0, *commanded), max(0.0, *commanded)
        slack = 1.0 + _SLACK * max(-low, high)
        if low - slack <= target <= high + slack:
            self._wrong.discard(joint)
        elif joint not in self._wrong:
            self._wrong.add(joint)
            self._report(
                "target_wrong",
                f"the drive of {joint} gets the target {target:.0f} instead of the commanded {commanded[-1]:.0f}",
            )

    def _judge_life(self, joint: str, view: ObservedNode, recent: Sequence[float], now: int) -> None:
        """Report a standstill command to a drive while a client renews a motion command."""
        commands, value = self._commanded[joint], recent[-1]
        earlier = max((at for at, _ in commands if at < now - _LAG_NS), default=-_RENEWED_NS)
        going_on = now - _RENEWED_NS < earlier < now - _LAG_NS < commands[-1][0]
        renewed = going_on and all(number == value != 0.0 for number in recent)
        # a limit closes one direction, and stops the drives of its group until they are enabled
        closed = view.limited_at > view.booted_at or any(axis.view.limited_at > view.enabled_at for axis in self._axes)
        if view.targets[_VELOCITY] or closed or not renewed or not self._all_calm(now):
            self._lost.discard(joint)
        elif joint not in self._lost:
            self._lost.add(joint)
            text = f"the drive of {joint} is commanded to stand still while a client keeps commanding {value:g}"
            device = self._robot.drives[view.node_id].device
            if device is not None and device.drives[0].modes.number not in (_PV, _CSV):  # the robot waits for the mode
                self._answers.unless_reported(view.node_id, "command_lost", text, view.enabled_at)
            else:
                self._report("command_lost", text)


def _recent(commands: deque[tuple[int, float]], now: int) -> list[float]:
    """Return the latest commanded value, after earlier values that the drive may still have."""
    values = []
    for at, value in reversed(commands):
        values.append(value)
        if at < now - _LAG_NS:
            break
    return values[::-1]


def _velocity_scales(robot: RobotUnderTest) -> dict[int, list[tuple[str, float]]]:
    """Return the joints of each node's first axis with their velocity scales."""
    scales: dict[int, list[tuple[str, float]]] = {}
    for joint, node, units in watched_joints(robot.setup):
        scales.setdefault(node.node_id, []).append((joint, units["vel_to_dev"]))
    return scales


def _reach(drive: VirtualDrive) -> float:
    """Return the permitted distance of a shaft from its target: 0x6065, or 0 if the window is disabled."""
    window = drive.objects.number(o.FOLLOWING_ERROR_WINDOW)
    return float(window) if 0 < window < 1 << 30 else 0.0


def _near_limit(drive: VirtualDrive, speed: float, slope: float) -> bool:
    """Whether a drive brakes for a position limit, or stands at one before its statusword shows that (bit 11)."""
    (low, high), place = drive.limits.bounds(), drive.mover.plant.position
    way = speed * speed / (2.0 * slope) + speed * _LAG_NS / 1e9 + _MIN
    return not low + way < place < high - way
