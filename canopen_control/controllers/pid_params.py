"""Parameters of pid_controller/PidController, by the names of jazzy."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, cast

from canopen_control.controllers.params import COMMAND_TIMEOUT_HELP, CommonParams, LoopGains
from canopen_control.errors import RobotConfigError
from canopen_control.yamlfile.convert import derived, setting

if TYPE_CHECKING:
    from canopen_control.controllers.params import Params


@dataclass(frozen=True)
class DofGains(LoopGains):
    """Gains of one degree of freedom; `antiwindup` is ROS 1's deprecated name for the strategy `legacy`."""

    INEFFECTIVE: ClassVar[dict[str, str]] = {"activate_state_publisher": "~/controller_state contains the whole state"}

    antiwindup: bool = setting(False, help="whether the strategy `legacy` limits the integral itself (deprecated)")
    error_deadband: float = setting(1e-16, help="largest error that is not integrated")
    feedforward_gain: float = setting(0.0, help="factor of the feed-forward")
    angle_wraparound: bool = setting(
        False, help="whether to use the shortest way round as the error of a continuous joint"
    )
    save_i_term: bool = setting(True, help="whether to keep the integral when the controller is deactivated")
    activate_state_publisher: bool = setting(False, help="has no effect: `~/controller_state` contains the whole state")

    @property
    def clamps_integral(self) -> bool:
        return self.antiwindup


@dataclass(frozen=True)
class PidParams(CommonParams):
    """Parameters of pid_controller/PidController; `gains` are in the order of `dof_names`.

    `command_timeout` in s ends velocity and effort references that are not renewed. With `use_external_measured_states`
    the states are received as messages, and are valid for `measured_state_timeout` in s.
    """

    dof_names: tuple[str, ...] = setting((), help="joints that receive the commands")
    reference_and_state_dof_names: tuple[str, ...] = setting(
        (), help="names of the joints in references and states, if they differ from `dof_names`"
    )
    command_interface: str = setting("", help="command interface of the loops: velocity, acceleration or effort")
    reference_and_state_interfaces: tuple[str, ...] = setting(
        (), help="controlled quantity and its derivative, as in [position, velocity]"
    )
    set_current_state_as_first_setpoint: bool = setting(
        True, help="first references: true keeps the joints where they are, false sets the references to 0"
    )
    use_external_measured_states: bool = setting(
        False, help="whether to receive the states on `~/measured_state` instead of from the state interfaces"
    )
    measured_state_timeout: float = setting(
        0.2,
        low=0.001,
        high=60.0,
        help="time in s without a measured state after which targets become 0 and references are discarded",
    )
    enable_feedforward: bool = setting(
        False,
        help="whether to add `feedforward_gain` times the derivative of the reference, or times the reference if "
        "no derivative is given",
    )
    command_timeout: float | None = setting(None, low=0.0, high=1e9, help=COMMAND_TIMEOUT_HELP)
    gains: tuple[DofGains, ...] = derived(())

    @property
    def measured(self) -> tuple[str, ...]:
        """Names of the degrees of freedom in references and states."""
        return self.reference_and_state_dof_names or self.dof_names

    def mistake(self) -> str | None:
        for key, names in (
            ("dof_names", self.dof_names),
            ("reference_and_state_dof_names", self.reference_and_state_dof_names),
        ):
            if len(set(names)) != len(names):
                return f"{key} contains a name twice: {', '.join(names)}; list each name once"
        if not self.dof_names:
            return "no 'dof_names'; give it under ros__parameters: dof_names: [joint_1, joint_2]"
        if len(self.measured) != len(self.dof_names):
            count = f"{len(self.measured)} for {len(self.dof_names)} dof_names"
            return f"reference_and_state_dof_names: {count}; give the same number"
        if not self.command_interface:
            return "no 'command_interface'; give it: command_interface: effort"
        if len(self.reference_and_state_interfaces) not in (1, 2):
            length = len(self.reference_and_state_interfaces)
            return f"reference_and_state_interfaces has {length}; give one, or two as in [position, velocity]"
        if len(set(self.reference_and_state_interfaces)) != len(self.reference_and_state_interfaces):
            return (
                "reference_and_state_interfaces contains an interface twice; give the derivative: [position, velocity]"
            )
        return None


def read_params(params: Params, name: str) -> PidParams:
    """Return the parameters of PID controller `name`; raise RobotConfigError if they are invalid."""
    node = params.flat.get("dof_names")
    dofs = tuple(dict.fromkeys(element.text for element in node.elements())) if node is not None else ()
    settings = params.read(_with_gains(dofs))
    result = dataclasses.replace(
        settings, gains=tuple(getattr(settings, f"gains_{index}") for index in range(len(dofs)))
    )
    if (mistake := result.mistake()) is not None:
        raise RobotConfigError(f"{name}: {mistake}")
    return result


def _with_gains(dofs: tuple[str, ...]) -> type[PidParams]:
    """Return a parameter class that has a section of gains for each degree of freedom."""
    fields: list[tuple[str, Any, Any]] = [
        (f"gains_{index}", DofGains, setting(DofGains(), key=f"gains.{dof}", section=True))
        for index, dof in enumerate(dofs)
    ]
    return cast("type[PidParams]", dataclasses.make_dataclass("PidParams", fields, bases=(PidParams,), frozen=True))
