"""Invariants of motion: no motion without a command, stops in time, no enable without a request.

They use the bus, the drives' shafts and the requests of clients, never reports of the runtime. A reason to stop is a
requested stop or disable, a drive in fault, a node that boots or falls silent, a silent master. The shafts must then
stand still after the detection time and the ramp, both as computed by `check`, and `GRACE_NS`; afterwards no
controlword may enable a drive. Times are in ns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from canopen_control.check.stop_times import axis_facts, stop_time
from canopen_control.simulation.robot_under_test import MASTER

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from canopen_control.check.stop_times import AxisFacts
    from canopen_control.simulation.motions import SampleMotion
    from canopen_control.simulation.robot_under_test import RobotUnderTest
    from canopen_control.simulation.wire_view import ObservedNode, WireView
    from canopen_control.virtual.scenario import ScenarioEvent


_MS: Final = 1_000_000
GRACE_NS: Final = 200 * _MS  # some cycles, and wake-up delays of processes
CONTROL_RAMP_NS: Final = 1000 * _MS  # time allowed for a controller's ramp after a command has expired
BOOT_NS: Final = 500 * _MS  # time in which a starting robot disables drives that are still turning
PLACE_NS: Final = 8_000 * _MS  # time allowed to reach a position
_UNASKED_NS: Final = 100 * _MS
_STOPS: Final = ("stop", "latch", "axis disable", "axis quick-stop", "axis halt")
_ENABLES: Final = ("axis enable",)
_LATCHES: Final = {"latch": True, "release": False}
_OFF_NS: Final = 300 * _MS  # time in which a drive of a standing group must be disabled
_SEEN_NS: Final = 100 * _MS  # maximum age of a statusword
_NO_DISABLE: Final = ("axis halt was requested", "axis quick-stop was requested")
_STANDING: Final = 0.03  # fraction of the largest speed of a shaft
_MIN: Final = 10.0  # minimum of this largest speed in counts/s
_ON_A_FLOOR: Final = 2.0  # rad/s (m/s) instead with physics, where a robot rocks on its wheels


@dataclass(slots=True)
class _Stop:
    """Reason to stop: time of its detection, cause, and latest time of standstill without the drives' ramps."""

    since: int
    why: str
    until: int


class MotionInvariants:
    """Checks the motion of all shafts; violations are passed to `report(rule, text)`.

    The owner calls `requested` and `on_sample` as time passes.
    """

    def __init__(
        self,
        robot: RobotUnderTest,
        views: Mapping[str, WireView],
        motions: Sequence[SampleMotion],
        report: Callable[[str, str], None],
    ) -> None:
        self._robot, self._views, self._report = robot, views, report
        self._nodes = [node for view in views.values() for node in view.nodes.values()]
        self._lives = {motion.controller: motion.life_ns or PLACE_NS for motion in motions}
        self._fresh: dict[str, int] = {}  # controller -> expiry of its command
        self._held: dict[str, bool] = {}  # controller -> whether its newest command ends with its client
        self._enabled_ns = robot.now_ns
        self._followed_ns = 0  # time at which a drive was first seen enabled since then
        self._stop: _Stop | None = None
        self._latched = False
        self._fastest: dict[int, float] = {}
        joints = robot.core.joints.values() if robot.floor is not None else ()
        self._min = {motion.node.node_id: _ON_A_FLOOR * abs(motion.scale.pos_to_dev) for motion in joints}
        self._moving: set[int] = set()  # nodes whose motion was reported
        self._judged: dict[int, int] = {}  # node -> time of the last checked enable command
        self._excused: dict[int, int] = {}
        self._alone_since: dict[int, int] = {}  # node -> start of the loss of connection to the robot
        self._alone_until: dict[int, int] = {}  # node -> time at which the node detects this loss
        self._still_enabled: set[int] = set()  # nodes that remained enabled after a stop, already reported
        self._facts: dict[int, list[AxisFacts]] = {node.node_id: [] for node in self._nodes}
        for facts in axis_facts(robot.setup):
            if facts.node_id in self._facts:
                self._facts[facts.node_id].append(facts)
        self._ramps: dict[int, tuple[float, int]] = {}  # node -> largest speed, and the ramp from it

    def requested(self, now: int, act: ScenarioEvent) -> None:
        """Record a client request, which a stalled process receives after the stall."""
        reception = max(now, self._robot.host.stalled_until)
        request = f"{act.kind} {act.name}".strip()
        self._latched = _LATCHES.get(act.kind, self._latched)
        if request in _ENABLES and not self._latched:
            self._enabled_ns, self._stop = reception, None
            if self._all_at_standstill():
                self._fresh.clear()  # a command must be newer
        elif request in _STOPS:
            self._stop_by(reception, f"{request} was requested", reception)
        elif act.kind == "activate":
            if not self._latched:  # an activated controller enables the drives that it claims
                self._enabled_ns, self._stop = reception, None
            self._fresh = {name: min(until, reception) for name, until in self._fresh.items()}
        elif act.kind == "command":
            life = self._lives.get(act.target, PLACE_NS)
            self._fresh[act.target] = reception + (life if any(act.values) or life == PLACE_NS else 0)
            self._held[act.target] = bool(act.name)
        # the command of a client that leaves ends with the client
        elif act.kind == "cancel" or (act.kind == "leave" and self._held.get(act.target)):
            self._fresh[act.target] = min(self._fresh.get(act.target, 0), reception)
        elif act.kind == "trajectory":
            self._fresh[act.target] = reception + (act.for_ns or 0) + 2000 * _MS

    def _all_at_standstill(self) -> bool:
        """Whether all shafts are at standstill; always False with physics, where a rocking robot turns its shafts."""
        return self._robot.floor is None and all(
            self._speed(node.node_id) <= self._standstill_speed(node.node_id) for node in self._nodes
        )

    def _speed(self, node_id: int) -> float:
        """Return the shaft speed of a node in counts/s."""
        device = self._robot.drives[node_id].device
        axis = None if device is None else next(iter(device.drives.values()), None)
        return 0.0 if axis is None else abs(axis.mover.plant.velocity)

    def _standstill_speed(self, node_id: int) -> float:
        """Return the maximum speed in counts/s at which a node's shaft is considered at standstill."""
        return _STANDING * self._fastest.get(node_id, self._min.get(node_id, _MIN))

    def on_sample(self, now: int) -> None:
        """Check all shafts and drives."""
        if self._robot.started_ns > self._enabled_ns:  # a start enables the drives once
            self._enabled_ns, self._stop = self._robot.started_ns, None
            if self._latched:  # the robot restarts with STOP latched
                self._stop_by(now, "a start with STOP latched", now + BOOT_NS)
            self._fresh = {"": self._enabled_ns + BOOT_NS}
        for stop in self._reasons(now):
            self._stop_by(stop.since, stop.why, stop.until)
        for node in self._nodes:
            self._judge_reach(node, now)
            self._judge_enable(node)
            self._judge_shaft(node, now)
        self._judge_power(now)

    # -- reasons to stop

    def _stop_by(self, since: int, why: str, until: int) -> None:
        if self._stop is None:
            self._stop = _Stop(since, why, until)

    def _reasons(self, now: int) -> Iterator[_Stop]:
        """Yield new reasons to stop; none until a drive shows that it was enabled by the latest request."""
        if self._stop is not None:
            return
        if self._followed_ns <= self._enabled_ns:
            if any(node.shown_enabled_at > self._enabled_ns for node in self._nodes):
                self._followed_ns = now
            return
        since = self._followed_ns
        for view in self._views.values():
            # heartbeat_multiplier of bus.yml: the consumer time of the drives (0x1016), the longest of the bus
            periods = max((node.supervision.multiplier for node in view.config.nodes.values()), default=0.0)
            watched = round(view.config.master.heartbeat_ms * _MS * periods)
            silent = watched > 0 and 0 < view.master_at < now - watched - GRACE_NS
            for node in view.nodes.values():
                limit = node.timeout_ns
                alive_at = node.alive_at if node.alive_at > since else since
                if node.fault_at > since and node.in_fault:
                    yield _Stop(node.fault_at, f"node {node.node_id} is in fault", node.fault_at)
                if node.booted_at > since:
                    yield _Stop(node.booted_at, f"node {node.node_id} has booted", node.booted_at)
                if limit and alive_at < now - limit - GRACE_NS:
                    yield _Stop(alive_at + limit, f"node {node.node_id} is silent", alive_at + limit)
                if silent:
                    yield _Stop(view.master_at, f"{MASTER} is silent", view.master_at + watched)

    # -- checks

    def _judge_enable(self, node: ObservedNode) -> None:
        """Report a controlword that enables a drive after a stop without a new request."""
        at = node.enabled_at
        if self._judged.get(node.node_id, 0) == at:
            return
        self._judged[node.node_id] = at
        stop = self._stop
        if stop is not None and stop.since + _UNASKED_NS < at:
            late = (at - stop.since) / 1e9
            self._report(
                "enable_unasked", f"node {node.node_id} is enabled {late:.3f} s after {stop.why}, without a request"
            )

    def _judge_power(self, now: int) -> None:
        """Report drives that stay enabled longer than a stop may take."""
        stop = self._stop
        if stop is None or stop.why in _NO_DISABLE or now < self._robot.host.stalled_until + _OFF_NS:
            self._still_enabled.clear()
            return
        deadline = (
            stop.until + max((self._ramp_ns(node.node_id) for node in self._nodes), default=0) + GRACE_NS + _OFF_NS
        )
        if now <= deadline:
            return
        for node in self._nodes:
            is_enabled = node.enabled and now - node.status_at < _SEEN_NS and node.commanded
            is_commanded = (
                is_enabled and node.controlword_at > stop.since and node.enabled_at <= stop.since + _UNASKED_NS
            )
            if is_commanded and node.node_id not in self._still_enabled:
                self._still_enabled.add(node.node_id)
                late = (now - stop.since) / 1e9
                self._report("enabled_still", f"node {node.node_id} is still enabled {late:.3f} s after {stop.why}")

    def _judge_reach(self, node: ObservedNode, now: int) -> None:
        """Record the time until which a disconnected drive may move, because it has not detected the loss yet."""
        drive = self._robot.drives[node.node_id]
        if not (drive.wire.silences(MASTER) or drive.wire.silences(drive.label)):
            self._alone_since.pop(node.node_id, None)
        elif node.node_id not in self._alone_since:
            self._alone_since[node.node_id] = now
            missed = max((fact.master_s for fact in self._facts[node.node_id]), default=0.0)
            self._alone_until[node.node_id] = now + round(missed * 1e9)

    def _judge_shaft(self, node: ObservedNode, now: int) -> None:
        drive = self._robot.drives[node.node_id]
        device, actor = drive.device, drive.actor
        if device is None or actor is None or not device.drives:
            return
        if now < actor.stalled_until:
            self._excused[node.node_id] = actor.stalled_until + 1000 * _MS
        axis = next(iter(device.drives.values()))
        if self._robot.floor is not None and not axis.mover.powered:  # the floor turns it
            self._excused[node.node_id] = now + GRACE_NS
        speed = abs(axis.mover.plant.velocity)
        fastest = self._fastest.get(node.node_id)
        if fastest is None or speed > fastest:
            fastest = max(self._min.get(node.node_id, _MIN) if fastest is None else fastest, speed)
            self._fastest[node.node_id] = fastest
        if speed <= _STANDING * fastest:
            self._moving.discard(node.node_id)
            return
        if node.node_id in self._moving or now < self._excused.get(node.node_id, 0):
            return
        ramp = self._ramp_ns(node.node_id)
        stop = self._stop
        if stop is not None and now > max(stop.until, self._alone_until.get(node.node_id, 0)) + ramp + GRACE_NS:
            self._breach(node, speed, f"{(now - stop.since) / 1e9:.3f} s after {stop.why}", "stop_late")
        elif now > (until := max(self._fresh.values(), default=0)) + ramp + GRACE_NS + CONTROL_RAMP_NS:
            since = (
                f"{(now - until) / 1e9:.3f} s after its last command ended"
                if until
                else "without a command since its enable"
            )
            self._breach(node, speed, since, "motion_uncommanded")

    def _breach(self, node: ObservedNode, speed: float, when: str, rule: str) -> None:
        self._moving.add(node.node_id)
        self._report(rule, f"the shaft of node {node.node_id} turns at {speed:.0f} counts/s, {when}")

    def _ramp_ns(self, node_id: int) -> int:
        """Return a node's longest stop ramp in ns as computed by `check`; 1 s if unlimited.

        It starts from the maximum speed in the files, or else from the largest speed observed.
        """
        fastest, facts = self._fastest.get(node_id, 0.0), self._facts[node_id]
        if self._ramps.get(node_id, (-1.0, 0))[0] != fastest:
            bound = [fact if math.isfinite(fact.speed) else replace(fact, speed=fastest) for fact in facts]
            ramps = [case.ramp_s for fact in bound for case in stop_time(fact).cases if math.isfinite(case.ramp_s)]
            self._ramps[node_id] = fastest, round(max(ramps, default=1.0) * 1e9)
        return self._ramps[node_id][1]
