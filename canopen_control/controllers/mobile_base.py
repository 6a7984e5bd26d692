"""Base class of vehicle controllers, which convert twists to wheel commands, and wheel motion to odometry.

Each update uses the newest twist, or zero if the newest twist is older than the timeout, limits it against the last two
limited twists (so that a timeout brakes along the ramp), updates the odometry, and writes the commands. When another
controller claims the reference interfaces, these are the twist (chaining). A twist that is not finite is refused and
does not restart the timeout. The first sample of the wheels is the baseline of the odometry. When feedback is lost
because a drive is disabled, the base stops and waits for the feedback, so that motion can continue once the drives are
enabled. Position commands, such as that of a steering joint, hold the actual position when the twist ends or is
cleared.

A new base is a class that defines `on_configure`, `compute_commands`, `velocities` and `advance` (or `follow`).
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, ClassVar, Final

from mypy_extensions import mypyc_attr

from canopen_control.controllers.base import Controller, ControllerState, zero_targets
from canopen_control.controllers.base_params import BaseParams
from canopen_control.controllers.command_timeout import UNLIMITED, timeout_warning
from canopen_control.controllers.limiters import (
    IMMOBILE,
    SLOW_STOP,
    RateLaw,
    RateLimiter,
    VelocityLimits,
    immobile_text,
    slow_stop,
)
from canopen_control.controllers.planar_pose import MIN_DT, PlanarPose
from canopen_control.errors import ControlError, RobotConfigError
from canopen_control.hardware.interfaces import ERROR, OK, CommandInterface, ReturnType
from canopen_control.rpc.messages.samples import OdometrySample
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.base_params import TwistAxisLimits
    from canopen_control.hardware.interfaces import StateInterface
    from canopen_control.rpc.messages.samples import Sample


# A twist and its limits: the desired value of each axis, and the limited value, which depends on the last two steps.


_STEPS: Final = 2  # previous steps that the limits of acceleration and jerk depend on


class LimitedTwist:
    """Requested and limited twist, by axis in m/s and rad/s; the requested twist is nan if none is requested."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._axes = tuple(axes)
        count = len(self._axes)
        self.desired, self.limited = [math.nan] * count, [0.0] * count
        self._actual = [0.0] * count  # initial history: standstill
        self._limiter = RateLimiter(self._actual)
        self._quiet = 0  # consecutive steps with a desired and a limited value of zero

    def set_limits(self, controller: str, limits: Sequence[TwistAxisLimits]) -> None:
        """Set the limits of each axis; raise RobotConfigError, with no change, for invalid limits."""
        axes = zip(self._axes, limits, strict=True)
        self._limiter.laws = [_law(controller, axis, params.limits()) for axis, params in axes]
        self._quiet = 0

    @property
    def is_requested(self) -> bool:
        """Whether a twist is requested; it may be zero."""
        total = sum(self.desired)
        return total == total  # False for nan

    @property
    def is_zero(self) -> bool:
        """Whether the limited twist is zero."""
        return not any(self.limited)

    @property
    def is_standstill(self) -> bool:
        """Whether both the requested and the limited twist have been zero for more than two steps."""
        return self._quiet > _STEPS and not any(self.desired)

    def limit(self, period: float) -> None:
        """Compute the limited twist from the requested twist and the last two limited twists; `period` is in s."""
        self.limited[:] = self.desired
        self._limiter.enforce(self._actual, self.limited, period)

    def step(self) -> None:
        """Record the limited twist as the latest step of the history."""
        self._limiter.step(self._actual, self.limited)
        self._quiet = 0 if any(self.desired) or any(self.limited) else self._quiet + 1

    def forget(self) -> None:
        """Discard the requested twist, and reset the history to standstill."""
        self._quiet = 0
        fill(self.desired, math.nan)
        self._limiter.reset()


def _law(controller: str, axis: str, limits: VelocityLimits) -> RateLaw:
    try:
        law = RateLaw(limits)
    except ValueError as error:
        raise RobotConfigError(f"{controller}: {axis}: {error}: a minimum is above its maximum") from error
    if not law.brakes:  # a motion would continue after the end of its commands
        raise RobotConfigError(
            f"{controller}: {axis}: a deceleration limit is 0, so the base would never brake; give max_deceleration "
            "and max_deceleration_reverse other values, or, if they are absent, the acceleration limits"
        )
    return law


def fill(values: list[float], value: float) -> None:
    """Set all elements of a list to one value, without allocating memory."""
    for index in range(len(values)):
        values[index] = value


# Published odometry of a base, which is valid until the next publication, and the schedule of publications.


NS: Final = 1_000_000_000
_AT_ONCE: Final = -1  # before any cycle


class OdometryPublication:
    """Snapshot of the odometry for publication; `count` is the number of publications."""

    def __init__(self, axes: int) -> None:
        self.count = 0
        self._x = self._y = self._heading = 0.0
        self._linear = self._lateral = self._angular = 0.0
        self._limited = [0.0] * axes
        self._period = 0
        self._next = _AT_ONCE

    def set_rate(self, rate: float) -> None:
        """Set the publication rate in Hz; 0 publishes at every update."""
        self._period = round(NS / rate) if rate else 0
        self._next = _AT_ONCE

    def is_due(self, now: int) -> bool:
        """Whether a publication is due at `now` (ns); if so, count it and schedule the next one.

        The schedule is a fixed grid; missed publications are not made up for.
        """
        next_time, period = self._next, self._period
        if now <= next_time:
            return False
        self._next = (now if next_time == _AT_ONCE else max(next_time, now - period)) + period
        self.count += 1
        return True

    def store(self, pose: PlanarPose, velocities: tuple[float, float, float], limited: list[float]) -> None:
        """Copy the current values; `velocities` are forward and to the left in m/s, and the yaw rate in rad/s."""
        self._x, self._y, self._heading = pose.x, pose.y, pose.heading
        self._linear, self._lateral, self._angular = velocities
        for index in range(len(limited)):
            self._limited[index] = limited[index]

    def sample(self, time: float, params: BaseParams, limited: bool) -> OdometrySample | None:
        """Return the last publication with the configured frames, or None before the first publication.

        `time` is in Unix seconds; with `limited`, the limited twist is included.
        """
        if not self.count:
            return None
        frame, child = params.frame_ids()
        return OdometrySample(
            time=time,
            x=self._x,
            y=self._y,
            heading=self._heading,
            linear=self._linear,
            lateral=self._lateral,
            angular=self._angular,
            frame_id=frame,
            child_frame_id=child,
            pose_covariance=list(params.pose_covariance_diagonal),
            twist_covariance=list(params.twist_covariance_diagonal),
            enable_odom_tf=params.enable_odom_tf,
            limited=(self._limited[0], self._limited[-1]) if limited else None,
        )


BASELINE: Final = -1.0
"""Return value of `elapsed` for the first step."""
TOO_SHORT: Final = 0.0
"""Return value of `elapsed` for a time step that is too short and is added to the next step."""
ONE_UPDATE: Final = "one_update"
"""Kind of the event that reports a timeout of 0, with which a twist applies to a single update."""
_DIRECTIONS: Final = {
    "linear.x": ("move forward", "move backward"),
    "linear.y": ("move to the left", "move to the right"),
    "angular.z": ("turn to the left", "turn to the right"),
}
_NEVER: Final = -1
# a subclass defines one method of each group
_REQUIRED: Final = (("compute_commands",), ("velocities",), ("advance", "follow"))


@mypyc_attr(allow_interpreted_subclasses=True)
class MobileBase(Controller):
    """Base class of controllers that move a vehicle by twists; `pose` is integrated from the wheel motion.

    - `desired`: requested twist of this cycle, nan before the first twist; `limited`: the limited twist. Both are in
      the order of `twist_axes`, in m/s and rad/s.
    - `targets`: values for the command interfaces.
    - `publications`: number of publications, the last of which was at `stamp` (ns).
    """

    topic: ClassVar[str | None] = "cmd_vel"
    is_base: ClassVar[bool] = True
    sample_type: ClassVar[type[Sample] | None] = OdometrySample
    twist_axes: ClassVar[tuple[str, ...]] = ("linear.x", "angular.z")
    references: ClassVar[tuple[str, ...]] = ("linear", "angular")
    timeout_key: ClassVar[str] = "cmd_vel_timeout"
    zero_is_never: ClassVar[bool] = False
    """Whether a timeout of 0 means unlimited; otherwise a twist then applies to one update, as in ros2_controllers."""
    by_twist_alone: ClassVar[bool] = False
    """Whether the commands are velocities that depend only on the twist."""
    waits_for_a_twist: ClassVar[bool] = False
    """Whether the base neither updates nor publishes the odometry before the first twist."""

    def __init__(self, name: str, type_name: str, pose: PlanarPose) -> None:
        super().__init__(name, type_name)
        self._require_methods()
        self.pose = pose
        self._twist = LimitedTwist(self.twist_axes)
        self._brake_s = 0.0
        self._blocked: dict[str, tuple[str, str]] = {}  # by axis: the limits that permit no motion forward, and back
        self.desired, self.limited = self._twist.desired, self._twist.limited
        self.targets: list[float] = []
        self.braking = False
        self._publication = OdometryPublication(len(self.twist_axes))
        self._references = tuple(CommandInterface(f"{name}/{reference}", VELOCITY) for reference in self.references)
        self._odometry_params = BaseParams()
        self._followed = _NEVER
        self._once = self._fresh = self._open_loop = False
        self._was_chained = self._writing = self._too_fast = False
        self._reset(0)

    def _require_methods(self) -> None:
        """Raise TypeError if a subclass lacks a required method, since `abc` does not check compiled classes."""
        kind = type(self)
        for names in _REQUIRED:
            if all(getattr(kind, name) is getattr(MobileBase, name) for name in names):
                raise TypeError(f"{kind.__name__} does not define {' or '.join(names)}; see docs/guide/bases.md")

    # ------------------------------------------------------------------------------------------ methods of a base

    def set_up(
        self,
        params: BaseParams,
        timeout: float,
        commands: int,
        limits: Sequence[TwistAxisLimits] = (),
        publish_rate: float = 0.0,
        open_loop: bool = False,
    ) -> None:
        """Apply the parameters common to all bases at configuration; `commands` is the number of commands."""
        self._open_loop = open_loop
        self.apply_parameters(params, timeout, limits)
        self.update_rate, self.publish_rate = params.update_rate, publish_rate
        self._publication.set_rate(publish_rate)
        self.targets = [0.0] * commands

    def apply_parameters(self, params: BaseParams, timeout: float, limits: Sequence[TwistAxisLimits] = ()) -> None:
        """Apply the parameters that may change at run time: timeout in s, axis limits and odometry options."""
        if any(limit.freezes for limit in limits) and self.state is ControllerState.ACTIVE:
            raise RobotConfigError(
                f"{self.name}: with a max_jerk of 0 a base that moves would never brake; give a value above 0"
            )
        if limits:
            self._twist.set_limits(self.name, limits)
        self._odometry_params = params
        self._blocked.clear()
        self._brake_s = 0.0
        for axis, limit in zip(self.twist_axes, limits, strict=False):
            if limit.freezes:
                self.report("parameter", f"{axis}.max_jerk is 0, which keeps the speed constant; remove it")
            law = RateLaw(limit.limits())
            self._brake_s = max(self._brake_s, law.brake_s)
            self._find_blocked(axis, law, reported=limit.freezes)
            if (text := slow_stop(axis, law.brake_s, f"{axis}.{law.longest_brake}")) is not None:
                self.report(SLOW_STOP, text)
        self.command_timeout.limit_ns, self._once = round(timeout * NS), timeout == 0.0 and not self.zero_is_never
        if self._once:
            self.report(
                ONE_UPDATE, f"{self.timeout_key} is 0, so a twist is used for one update only; give a time in s"
            )
        elif (text := timeout_warning(self.timeout_key, timeout, (VELOCITY,))) is not None:
            self.report(UNLIMITED, text)

    @property
    def brake_s(self) -> float:
        return self._brake_s

    def why_immobile(self, values: Sequence[float]) -> str | None:
        moving = [(axis, value) for axis, value in zip(self.twist_axes, values, strict=False) if value]
        limits = [self._blocked.get(axis, ("", ""))[value < 0.0] for axis, value in moving]
        if not all(limits) or not limits:
            return None
        names = " and ".join(limits)
        return f"{names} of {self.name} {'is' if len(moving) == 1 else 'are'} 0, so the base does not move"

    def _find_blocked(self, axis: str, law: RateLaw, *, reported: bool) -> None:
        """Find limits of 0 that permit no motion along an axis, and report them unless `reported`.

        A base that only moves forward is not reported, since its limits say so on purpose.
        """
        forward, backward = (f"{axis}.{name}" if name else "" for name in law.blocked)
        if not (forward or backward):
            return
        ahead, back = _DIRECTIONS.get(axis, _DIRECTIONS["linear.y"])
        both = bool(forward and backward)
        self._blocked[axis] = forward, forward if both else backward
        if both and not reported:
            self.report(IMMOBILE, immobile_text(forward, f"the base does not move along {axis}"))
        elif forward and not reported:
            self.report(IMMOBILE, immobile_text(forward, f"the base does not {ahead}"))
        elif not reported and axis != "linear.x":
            self.report(IMMOBILE, immobile_text(backward, f"the base does not {back}", "below"))

    @abstractmethod
    def compute_commands(self, twist: Sequence[float]) -> None:
        """Compute `targets`, one value per command interface, from a twist."""

    def begin(self) -> None:
        """Set the odometry baseline to the current wheel positions; the base class does nothing."""

    def advance(self, dt: float) -> None:
        """Integrate the wheel motion of the last `dt` s into the pose.

        A base that does not override `follow` must override this method.
        """

    def integrate_command(self, dt: float) -> None:
        """Integrate the limited twist over `dt` s into the pose, for open-loop odometry."""
        limited = self.limited
        left = limited[1] if len(limited) > 2 else 0.0
        self.pose.shift(limited[0] * dt, left * dt, limited[-1] * dt)

    @abstractmethod
    def velocities(self) -> tuple[float, float, float]:
        """Return the current velocities: forward and to the left in m/s, yaw rate in rad/s."""

    def follow(self, now: int) -> bool:
        """Update the odometry; return False if required wheel states are unknown. `now` is in ns."""
        if not (self._open_loop or self.states_known()):
            return False
        dt = self.elapsed(now)
        if dt == BASELINE:
            if not self._open_loop:
                self.begin()
        elif dt != TOO_SHORT:
            if self._open_loop:
                self.integrate_command(dt)
            else:
                self.advance(dt)
        return True

    @property
    def begun(self) -> bool:
        """Whether the odometry has its baseline."""
        return self._followed != _NEVER

    def stop_following(self) -> None:
        """Suspend the odometry until the next sample, which becomes the new baseline."""
        self._followed = _NEVER

    def elapsed(self, now: int) -> float:
        """Return the time step of the odometry in s, or BASELINE or TOO_SHORT; `now` is in ns."""
        before = self._followed
        dt = BASELINE if before == _NEVER else (now - before) / NS
        if before != _NEVER and dt < MIN_DT:
            return TOO_SHORT
        self._followed = now
        return dt

    def states_known(self) -> bool:
        """Whether the values of all state interfaces are finite."""
        total = 0.0
        for state in self.states:
            total += state.value
        return math.isfinite(total)

    def wheel_states(self, position_feedback: bool) -> list[str]:
        """Return the position or velocity interface of every wheel joint; an empty list in open loop."""
        feedback = POSITION if position_feedback else VELOCITY
        return [] if self._open_loop else [f"{joint}/{feedback}" for joint in self.joints]

    # ------------------------------------------------------------------------------------------------- reports

    @property
    def publications(self) -> int:
        return self._publication.count

    @property
    def chained(self) -> bool:
        """Whether another controller has claimed the reference interfaces."""
        return any(reference.owner is not None for reference in self._references)

    def frame_ids(self, namespace: str = "") -> tuple[str, str]:
        """Return the names of the odometry frame and the base frame, with their prefix."""
        return self._odometry_params.frame_ids(namespace)

    def set_odometry(self, x: float, y: float, heading: float) -> None:
        """Set the pose of the odometry, in m and rad; raise ControlError if inactive, or if a value is not finite."""
        if self.state is not ControllerState.ACTIVE:
            raise ControlError(f"{self.name} is {self.state.value}; activate it before setting its odometry")
        if not all(map(math.isfinite, (x, y, heading))):
            raise ControlError(f"{self.name}: a pose needs three finite numbers, got {x}, {y}, {heading}")
        self.pose.set_pose(x, y, heading)

    def dead_reckoning(self, ahead: float) -> tuple[float, float, float] | None:
        if not self.begun:
            return None
        forward, left, angular = self.velocities()
        cosine, sine = math.cos(self.pose.heading), math.sin(self.pose.heading)
        x = self.pose.x + (cosine * forward - sine * left) * ahead
        y = self.pose.y + (sine * forward + cosine * left) * ahead
        return x, y, self.pose.heading + angular * ahead

    def odometry_sample(self, wall_offset_ns: int, limited: bool = False) -> OdometrySample | None:
        """Return the last published odometry, including the limited twist if `limited` is True."""
        return self._publication.sample(self.published(wall_offset_ns), self._odometry_params, limited)

    def snapshot(self) -> None:
        """Copy the pose, velocities and limited twist for publication; an override must call this method first."""
        self._publication.store(self.pose, self.velocities(), self.limited)

    # ----------------------------------------------------------------------------------------------------- lifecycle

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        return self._references

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        super().on_activate(commands, states, now)
        self.stop_following()
        self._reset(now)

    def on_deactivate(self, now: int) -> None:
        """Stop the wheels at once, with the deceleration of the drives; position commands are kept."""
        super().on_deactivate(now)
        self._reset(now)

    def forget(self, now: int) -> None:
        """Stop the wheels at once, hold positions, and reset the limits to standstill."""
        zero_targets(self.commands)
        for command in self.commands:
            if command.interface == POSITION:
                command.value = math.nan  # the hardware holds the actual position instead of the old target
        self._reset(now)
        self._brake()
        self._writing = True

    def _reset(self, now: int) -> None:
        """Discard the twist and its history; a timeout is counted from `now`, in ns."""
        self._twist.forget()
        self.command_timeout.end()
        self.command_timeout.created = now
        self.braking = self._fresh = False
        self._was_chained = self._writing = self._too_fast = False
        for reference in self._references:
            reference.value = math.nan

    # ------------------------------------------------------------------------------------------------------- command

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store a twist in m/s and rad/s; a twist older than the timeout is refused.

        `stamp` is the creation time in ns; 0 or None stands for `now`. A stamp in the future, from a clock that is
        ahead, also counts as `now`, because it must not extend the timeout.
        """
        self.checked(values, self.twist_axes)
        owner = next((reference.owner for reference in self._references if reference.owner is not None), None)
        if owner is not None:
            raise self.refusal(f"is commanded by {owner}; deactivate that controller first")
        sent, limit = min(stamp or now, now), self.command_timeout.limit_ns
        if limit and now - sent >= limit:
            age, timeout = (now - sent) / NS, limit / NS
            raise self.refusal(
                f"got a twist that is {age:.3f} s old, {self.timeout_key} is {timeout:g} s; check the clocks"
            )
        self.compute_commands(values)
        for command, target in zip(self.commands, self.targets, strict=True):
            self.refuse_out_of_range([command], target, now)
        for index, value in enumerate(values):
            self.desired[index] = float(value)
        self.braking, self._fresh = False, True
        self.command_timeout.start(sent)

    # --------------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        if not self.begun:
            fill(self.limited, 0.0)
            self.follow(now)
        self._update_request(now)
        twist = self._twist
        is_standstill = twist.is_standstill
        if not is_standstill:
            if not twist.is_requested:
                return OK if self.waits_for_a_twist else self._rest(now)
            twist.limit(period)
        if not self.follow(now):
            return self._without_feedback()
        if not is_standstill:
            twist.step()
        self._write(is_standstill=is_standstill)
        self._publish(now)
        return OK

    def _update_request(self, now: int) -> None:
        """Update the requested twist from the chain or the last command; request zero after a timeout."""
        timeout = self.command_timeout
        if self._follow_chain():
            self._was_chained = True
            timeout.end()
        elif self._was_chained and not timeout.live:
            self._was_chained = False
            self._brake()
        elif self._once:
            if timeout.live and not self._fresh:
                timeout.end()
            self._fresh = False
            if not timeout.live and self._twist.is_requested:
                self._brake()
        elif timeout.limit_ns and now - timeout.created > timeout.limit_ns:
            if timeout.expire(now):
                age = (now - timeout.created) / NS
                self.report("command_timeout", f"no twist for {age:.2f} s, it brakes until the next one")
            self._brake()

    def _follow_chain(self) -> bool:
        """Use the claimed reference interfaces as the requested twist; return False if none is claimed."""
        for reference in self._references:
            if reference.owner is not None:
                break
        else:
            return False
        self.braking = False
        for index, reference in enumerate(self._references):
            self.desired[index] = reference.value
        if self._writing and not self._twist.is_requested:
            self._brake()  # a base that moved by a topic's twist must not continue without a reference
        return True

    def _brake(self) -> None:
        fill(self.desired, 0.0)
        self.braking = True

    def _rest(self, now: int) -> ReturnType:
        """Update the odometry before the first twist; here missing feedback is not an error."""
        fill(self.limited, 0.0)
        zero_targets(self.commands)
        if self.follow(now):
            self._publish(now)
        else:
            self.stop_following()
        return OK

    def _without_feedback(self) -> ReturnType:
        """Wait at standstill if a drive is disabled; otherwise report the missing feedback and return ERROR."""
        if all(command.enabled for command in self.commands):
            unknown = [state.name for state in self.states if not math.isfinite(state.value)]
            self.report("feedback", f"{', '.join(unknown)} has no finite value")
            return ERROR
        zero_targets(self.commands)
        self.stop_following()
        return OK

    def _publish(self, now: int) -> None:
        if self._publication.is_due(now):
            self.stamp = now
            self.snapshot()

    def _write(self, *, is_standstill: bool) -> None:
        """Write the commands for the limited twist; if a value is outside its drive's range, stop all wheels.

        `is_standstill` means that the limited twist is zero, so that no command needs to be computed if the commands
        are velocities.
        """
        self._writing = True
        if (is_standstill and self.by_twist_alone) or (self.braking and self._twist.is_zero):
            zero_targets(self.commands)
            return
        self.compute_commands(self.limited)
        targets = self.targets
        for index, command in enumerate(self.commands):
            target = targets[index]
            if not (command.lowest <= target <= command.highest and math.isfinite(target)):
                self._stop_wheels(target)
                return
            command.value = target
        self._too_fast = False

    def _stop_wheels(self, target: float) -> None:
        """Stop all wheels because `target` is outside a drive's range; report the first occurrence."""
        zero_targets(self.commands)
        if not self._too_fast:
            self._too_fast = True
            self.rejected += 1
            self.report(
                "refused",
                f"a wheel would have to turn at {target:g} rad/s, out of range of its drive; the base is stopped",
            )
