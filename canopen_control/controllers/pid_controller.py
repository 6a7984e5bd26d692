"""PID controller of positions or velocities: commands velocities, accelerations or efforts.

Rules (ros2_controllers jazzy, pid_controller/PidController): the reference is the last message, or that of the
controller that claims `NAME/DOF/INTERFACE` (chaining); a second interface, the derivative, gives the loop the rate of
the error. Safer than upstream: without a reference or a state the target is 0, where upstream leaves the last target.
When a drive is disabled or external measured states stop (`use_external_measured_states`), the degree of freedom loses
its reference and integral, and holds its actual state once it is enabled again. A reference that causes motion expires
(see `command_timeout`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, ClassVar

from canopen_control.controllers.base import Controller, finite, zero_targets
from canopen_control.controllers.command_timeout import MOVING, UNLIMITED, timeout_ns, timeout_warning
from canopen_control.controllers.limiters import IMMOBILE
from canopen_control.controllers.params import DofGains, PidParams, read_pid_params
from canopen_control.controllers.pid import Pid
from canopen_control.controllers.trajectory.point import shortest_angular_distance
from canopen_control.errors import RobotConfigError
from canopen_control.hardware.interfaces import OK, CommandInterface, ReturnType, StateInterface
from canopen_control.rpc.messages.samples import DofReading, PidSample

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.controllers.params import Params
    from canopen_control.rpc.messages.samples import Sample


class _Dof:
    """Degree of freedom of the controller: PID loop, interfaces, and errors of the last cycle."""

    def __init__(self, name: str, gains: DofGains, references: Sequence[CommandInterface]) -> None:
        self.name, self.pid, self.keep = name, Pid(gains.pid()), gains.save_i_term
        self.forward, self.wraps = gains.feedforward_gain, gains.angle_wraparound
        self.reference = references[0]
        self.reference_rate = references[1] if len(references) == 2 else None
        self.command: CommandInterface = CommandInterface(name, "none")
        self.state: StateInterface | None = None
        self.state_rate: StateInterface | None = None
        self.error = self.error_rate = math.nan

    def set_gains(self, gains: DofGains) -> None:
        self.pid.set_gains(gains.pid())
        self.keep, self.forward, self.wraps = gains.save_i_term, gains.feedforward_gain, gains.angle_wraparound

    def clear(self) -> None:
        self.reference.value = self.error = self.error_rate = math.nan
        if self.reference_rate is not None:
            self.reference_rate.value = math.nan

    def stay(self) -> None:
        """Set the reference to the measured state, or to 0.0 if the reference is a velocity or effort."""
        measured = math.nan if self.state is None else self.state.value
        self.reference.value = 0.0 if self.reference.interface in MOVING else measured
        if self.reference_rate is not None:
            self.reference_rate.value = 0.0

    def step(self, period: float, feed_forward: bool) -> float:
        """Return the command of one cycle, or nan if the reference or the state is missing; `period` is in s."""
        reference = self.reference.value
        measured = math.nan if self.state is None else self.state.value
        self.error = shortest_angular_distance(measured, reference) if self.wraps else reference - measured
        rate = math.nan if self.reference_rate is None else self.reference_rate.value
        self.error_rate = rate - (math.nan if self.state_rate is None else self.state_rate.value)
        if not (math.isfinite(reference) and math.isfinite(measured)):
            return math.nan
        command = 0.0
        if feed_forward:
            forwarded = reference if self.reference_rate is None else rate
            command = self.forward * forwarded if math.isfinite(forwarded) else 0.0
        if math.isfinite(self.error_rate):
            return command + self.pid.compute_with_rate(self.error, self.error_rate, period)
        return command + self.pid.compute(self.error, period)


class PidController(Controller):
    """Controller with one PID loop per degree of freedom; `feed_forward` adds scaled references to the outputs."""

    title: ClassVar[str] = "PID"
    reads: ClassVar[type[PidParams]] = PidParams
    sections: ClassVar[dict[str, type[object]]] = {
        "Each degree of freedom: `gains.DOF.KEY`": DofGains,
    }
    topic: ClassVar[str | None] = "reference"
    sample_type: ClassVar[type[Sample] | None] = PidSample
    settable: ClassVar[tuple[str, ...]] = ("gains.*",)

    def __init__(self, name: str, type_name: str = "") -> None:
        super().__init__(name, type_name)
        self.params = PidParams()
        self.feed_forward = False
        self._references: list[CommandInterface] = []
        self._exported: list[StateInterface] = []
        self._dofs: list[_Dof] = []
        self._follows: list[bool] = []
        self._period = 0.0
        self._measured: list[StateInterface] = []  # states from messages; empty if state interfaces are read
        self._measured_at = 0

    @property
    def chained(self) -> bool:
        """Whether another controller has claimed the reference interfaces."""
        return any(reference.owner is not None for reference in self._references)

    # ------------------------------------------------------------------------------------------------- lifecycle

    def on_configure(self, params: Params) -> None:
        self.params = settings = read_pid_params(params, self.name)
        if settings.command_interface not in MOVING:
            raise RobotConfigError(
                f"{self.name}: command_interface: {settings.command_interface} keeps its target when the loop stops; "
                f"give velocity, acceleration or effort"
            )
        self.update_rate, self.joints, self.interface = (
            settings.update_rate,
            settings.dof_names,
            settings.command_interface,
        )
        self.feed_forward = settings.enable_feedforward
        self.command_timeout.limit_ns = timeout_ns(
            settings.command_timeout, settings.reference_and_state_interfaces[:1]
        )
        kind = settings.reference_and_state_interfaces[:1]
        if (text := timeout_warning("command_timeout", settings.command_timeout, kind)) is not None:
            self.report(UNLIMITED, text)
        for text in settings.immobile():
            self.report(IMMOBILE, text)
        self._references = [
            self._reference(dof, interface)
            for interface in settings.reference_and_state_interfaces
            for dof in settings.measured
        ]
        self._exported = [StateInterface(reference.joint, reference.interface) for reference in self._references]
        external = settings.use_external_measured_states
        self._measured = [
            StateInterface(interface.joint, interface.interface) for interface in self._exported if external
        ]
        count = len(settings.dof_names)
        self._follows = [False] * count
        self._dofs = [
            _Dof(dof, settings.gains[index], self._references[index::count])
            for index, dof in enumerate(settings.measured)
        ]

    def on_set(self, params: Params) -> None:
        self.params = settings = read_pid_params(params, self.name)
        for dof, gains in zip(self._dofs, settings.gains, strict=False):
            dof.set_gains(gains)

    def _reference(self, dof: str, interface: str) -> CommandInterface:
        """Return a new reference interface with the range of the joint."""
        joint = self.description.get(dof)
        low, high = (-math.inf, math.inf) if joint is None else joint.range_of(interface)
        return CommandInterface(f"{self.name}/{dof}", interface, minimum=low, maximum=high)

    def command_interface_names(self) -> list[str]:
        return [f"{dof}/{self.params.command_interface}" for dof in self.params.dof_names]

    def state_interface_names(self) -> list[str]:
        if self.params.use_external_measured_states:
            return []
        return [
            f"{dof}/{interface}"
            for interface in self.params.reference_and_state_interfaces
            for dof in self.params.measured
        ]

    def reference_interfaces(self) -> Sequence[CommandInterface]:
        return self._references

    def exported_states(self) -> Sequence[StateInterface]:
        return self._exported

    def on_activate(self, commands: list[CommandInterface], states: list[StateInterface], now: int) -> None:
        states = self._measured or states
        super().on_activate(commands, states, now)
        self._lose_states()
        self._export()
        count = len(self._dofs)
        for index, dof in enumerate(self._dofs):
            dof.command, dof.state = commands[index], states[index]
            dof.state_rate = states[index + count] if len(states) > count else None
        self.stamp = 0
        self.command_timeout.end()
        self._clear()

    def on_deactivate(self, now: int) -> None:
        super().on_deactivate(now)
        self.command_timeout.end()
        self._clear()
        for state in self._exported:
            state.value = math.nan

    def forget(self, now: int) -> None:
        del now
        zero_targets(self.commands)
        self.command_timeout.end()
        self._clear()
        for dof in self._dofs:
            dof.pid.reset()

    def _clear(self) -> None:
        for index, dof in enumerate(self._dofs):
            dof.pid.reset(dof.keep)
            dof.clear()
            self._follows[index] = False

    # -------------------------------------------------------------------------------------------------- commands

    def set_measured_states(self, values: Sequence[float], now: int) -> None:
        """Store the measured state of each degree of freedom, optionally with derivatives; `now` is in ns.

        The values are received on ~/measured_state.
        """
        if not self._measured:
            raise self.refusal("reads state interfaces; set use_external_measured_states to accept messages")
        names = [state.name for state in self._measured]
        self.checked(values, names if len(values) > len(self._dofs) else names[: len(self._dofs)])
        for index, state in enumerate(self._measured):
            state.value = float(values[index]) if index < len(values) else math.nan
        self._measured_at = now

    def _lose_states(self) -> None:
        self._measured_at = 0
        for state in self._measured:
            state.value = math.nan

    def set_command(self, values: Sequence[float], now: int, stamp: int | None = None) -> None:
        """Store a reference for each degree of freedom, optionally with derivatives; `now` is in ns."""
        del stamp  # MultiDOFCommand has no stamp
        names = [
            f"{interface.joint.removeprefix(f'{self.name}/')}/{interface.interface}" for interface in self._references
        ]
        count = len(self._dofs)
        self.checked(values, names if len(values) > count else names[:count])
        if self._measured and not self._measured_at:
            raise self.refusal("has no measured states; send them first to ~/measured_state")
        if self.chained:
            owner = next(interface.owner for interface in self._references if interface.owner is not None)
            raise self.refusal(f"is commanded by {owner}; deactivate that controller first")
        for interface, name, value in zip(self._references, names, values, strict=False):
            if not interface.minimum <= value <= interface.maximum:
                limits = f"{interface.minimum:g} to {interface.maximum:g} (limits of the joint)"
                raise self.refusal(f"expects {limits} for {name}, got {value:g}; nothing was applied")
        for index, reference in enumerate(self._references):
            reference.value = float(values[index]) if index < len(values) else math.nan
        self.command_timeout.start(now)

    def is_standstill(self, values: Sequence[float]) -> bool:
        """Whether the references are zero velocities or efforts; always False for position references."""
        return self._references[0].interface in MOVING and super().is_standstill(values)

    def set_feed_forward(self, enabled: bool) -> None:
        self.feed_forward = enabled

    def sample(self, wall_offset_ns: int) -> PidSample | None:
        if not self.stamp:
            return None
        return PidSample(
            time=self.published(wall_offset_ns),
            dofs=[
                DofReading(
                    name=dof.name,
                    reference=finite(dof.reference.value),
                    feedback=None if dof.state is None else finite(dof.state.value),
                    feedback_dot=None if dof.state_rate is None else finite(dof.state_rate.value),
                    error=finite(dof.error),
                    error_dot=finite(dof.error_rate),
                    time_step=self._period,
                    output=finite(dof.command.value),
                )
                for dof in self._dofs
            ],
        )

    # ----------------------------------------------------------------------------------------------------- cycle

    def update(self, now: int, period: float) -> ReturnType:
        self.stamp, self._period = now, period
        if self._measured_at and now - self._measured_at > self.params.measured_state_timeout * 1e9:
            self._lose_states()
            text = (
                f"no measured state for {self.params.measured_state_timeout:g} s, targets are 0; send references again"
            )
            self.report("measured_state_lost", text)
        self._export()
        if self.command_timeout.expire(now) and not self.chained:
            self._stop(now)
        dofs, follows = self._dofs, self._follows
        for index in range(len(dofs)):
            dof = dofs[index]
            state = dof.state
            enabled = dof.command.enabled and (not self._measured or (state is not None and math.isfinite(state.value)))
            if enabled is not follows[index] or enabled is not dof.reference.enabled:
                self._turn(index, enabled)
            target = dof.step(period, self.feed_forward) if enabled else math.nan
            dof.command.value = target if math.isfinite(target) else 0.0
        return OK

    def _export(self) -> None:
        for index in range(len(self._exported)):
            self._exported[index].value = self.states[index].value

    def _turn(self, index: int, enabled: bool) -> None:
        """Record that a drive was enabled or disabled; clear its loop and references, or set its first reference."""
        dof = self._dofs[index]
        self._follows[index] = dof.reference.enabled = enabled
        if dof.reference_rate is not None:
            dof.reference_rate.enabled = enabled
        if not enabled:
            dof.pid.reset()
            dof.clear()
        elif not math.isfinite(dof.reference.value) and self.params.set_current_state_as_first_setpoint:
            dof.stay()

    def _stop(self, now: int) -> None:
        for dof in self._dofs:
            dof.clear()
        age = (now - self.command_timeout.created) / 1e9
        self.report("command_timeout", f"no reference for {age:.2f} s, targets are 0 until the next reference")
