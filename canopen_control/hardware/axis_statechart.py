"""Statechart of one axis as a table: power, stops, and permission to move.

`TABLE` has for each state and trigger the next state and the commands to the drive; a trigger without a row changes
nothing. Targets of a controller are sent only in FOLLOWING, and every path to this state begins with ENABLE: a fault
reset, a drive that returns or a complete group never leads from a stop to FOLLOWING. The rows with GROUP_ are triggers
of the stop group (`StopGroup`): its joints are enabled in one cycle and disabled in one cycle. Every state of a stop
has a timeout (`LIMITS_NS`), which is followed by a quick stop, then by disable voltage, unless the axis holds a load
that would fall; the last state reports that the axis has not stopped. A stop that does not slow the axis down is not
waited for (`expire`).
"""

from __future__ import annotations

import enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, Protocol, TypeVar

from canopen_control.errors import RobotConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.interfaces import CommandInterface
    from canopen_control.urdf.ros2_control import ControlJoint


_SECOND: Final = 1_000_000_000
_NEVER: Final = (1 << 62) - 1  # small enough for an unboxed integer in compiled code


class Action(enum.Enum):
    """Action on an axis that users can request."""

    ENABLE = "enable"
    DISABLE = "disable"
    HALT = "halt"
    QUICK_STOP = "quick-stop"
    FAULT_RESET = "fault-reset"
    HOME = "home"
    MODE = "mode"


class AxisPhase(enum.Enum):
    """State of an axis in the statechart; each value is a description in words."""

    DISABLED = "disabled"
    SWITCHING_ON = "being enabled; waits in SWITCHED_ON until the whole group is ready"
    ENABLING = "being enabled; the group has permitted OPERATION_ENABLED"
    ENABLED = "enabled; targets are at standstill until the whole group is enabled"
    READY = "enabled with the whole group; targets are at standstill until the drive may move in the requested mode"
    FOLLOWING = "enabled; the controller's targets are sent to the drive"
    HOMING = "enabled; homing"
    HALTED = "enabled; stopped by the halt bit until the next enable"
    RAMPING_DOWN = "controlled stop: the target velocity ramps to zero"
    AWAITING_STANDSTILL = (
        "controlled stop: the target is at standstill; waits for standstill of the axis and of the group"
    )
    DISABLING = "commanded to disable by the drive's own ramp; not confirmed yet"
    QUICK_STOPPING = "commanded to quick stop by a user; not confirmed yet"
    QUICK_STOPPED = "stopped by a quick stop; the drive's 0x605A decides whether it has power"
    FORCED_QUICK_STOP = "the stop took too long: quick stop commanded"
    VOLTAGE_DISABLED = "the quick stop took too long: voltage disabled, so a turning motor coasts"
    STOP_FAILED = "no stop command had a visible effect"


class PhaseTrigger(enum.Enum):
    """Trigger of a transition in the statechart; each value is a description in words."""

    ENABLE = "enable requested"
    STOP = "stop requested, or an error in the stop group"
    QUICK_STOP = "quick stop requested"
    HALT = "halt requested"
    FAULT_RESET = "fault reset requested"
    GROUP_READY = "every joint of the group that is being enabled is ready for OPERATION_ENABLED"
    GROUP_ENABLING = "a joint of the group is being enabled"
    GROUP_ENABLED = "no joint of the group is being enabled"
    GROUP_AT_STANDSTILL = "every joint of the group that is being stopped is at standstill"
    DRIVE_ENABLED = "the drive has entered OPERATION_ENABLED"
    DRIVE_DISABLED = "the drive is in a state without torque"
    DRIVE_LOST_ENABLE = "the drive has left OPERATION_ENABLED by itself, or does not enter it"
    NODE_LOST = "the node was lost"
    MOTION_PERMITTED = "the drive may move in the requested mode"
    STANDSTILL_REQUIRED = "the drive may not move, or homing or a mode change needs standstill"
    HOMING_STARTED = "homing has started"
    HOMING_ENDED = "homing has ended"
    TARGET_AT_STANDSTILL = "the target has reached zero"
    AT_STANDSTILL = "the drive has left OPERATION_ENABLED and is at standstill"
    TIMEOUT = "the timeout of the state has elapsed"
    TIMEOUT_LOADED = "the timeout of the state has elapsed, and the axis holds a load that would fall"


class DriveCommand(enum.Enum):
    """Command to the drive in a row of the statechart; each value is a description in words."""

    PREPARE = "enable up to SWITCHED_ON, and clear halt"
    RELEASE = "enter OPERATION_ENABLED"
    RESUME = "clear halt"
    HALT = "set halt"
    DISABLE = "disable"
    QUICK_STOP = "quick stop"
    CUT = "disable voltage"
    RESET = "reset the fault"


class Row(NamedTuple):
    """Transition of the statechart: next state, and commands to the drive."""

    state: AxisPhase
    commands: tuple[DriveCommand, ...] = ()


_S, _T, _O = AxisPhase, PhaseTrigger, DriveCommand
ENABLED_STATES: Final = (_S.SWITCHING_ON, _S.ENABLING, _S.ENABLED, _S.READY, _S.FOLLOWING, _S.HOMING, _S.HALTED)
"""States of an axis that is enabled or being enabled."""
ENABLING: Final = (_S.SWITCHING_ON, _S.ENABLING)
STOPPING: Final = (_S.RAMPING_DOWN, _S.AWAITING_STANDSTILL)
STOPPED: Final = (_S.DISABLED, _S.QUICK_STOPPED)

LIMITS_NS: Final[Mapping[AxisPhase, int]] = MappingProxyType(
    {
        _S.RAMPING_DOWN: 10 * _SECOND,  # includes AWAITING_STANDSTILL, which keeps this deadline
        _S.DISABLING: 10 * _SECOND,
        _S.QUICK_STOPPING: 10 * _SECOND,
        _S.FORCED_QUICK_STOP: 3 * _SECOND,
        _S.VOLTAGE_DISABLED: 1 * _SECOND,
    }
)
"""Timeouts of states in ns, after which TIMEOUT is fired; other states have no timeout."""

OVERDUE_TEXTS: Final = {
    _S.FORCED_QUICK_STOP: "has not stopped in time; quick stop commanded",
    _S.VOLTAGE_DISABLED: "its quick stop did not end in time; voltage is disabled, so a turning motor coasts",
    _S.STOP_FAILED: "no stop command had a visible effect, so it may have power; switch its supply off if it moves",
}
"""Texts about the states that a timeout leads to."""

_ALWAYS: Final = {
    _T.QUICK_STOP: Row(_S.QUICK_STOPPING, (_O.QUICK_STOP,)),
    _T.NODE_LOST: Row(_S.DISABLED, (_O.DISABLE,)),
}
_LEAVE: Final = {**_ALWAYS, _T.DRIVE_LOST_ENABLE: Row(_S.DISABLING, (_O.DISABLE,))}
_ENABLE: Final = {_T.ENABLE: Row(_S.SWITCHING_ON, (_O.PREPARE,))}
_RESUME: Final = {_T.ENABLE: Row(_S.ENABLED, (_O.RESUME,))}  # not FOLLOWING at once: a new command is needed
_ENABLED: Final = {**_LEAVE, **_RESUME, _T.STOP: Row(_S.RAMPING_DOWN), _T.HALT: Row(_S.HALTED, (_O.HALT,))}
_ENABLING: Final = {
    **_LEAVE,
    **_ENABLE,
    _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
    _T.DRIVE_ENABLED: Row(_S.ENABLED, (_O.RELEASE,)),
}
_ESCALATE: Final = {
    _T.TIMEOUT: Row(_S.FORCED_QUICK_STOP, (_O.QUICK_STOP,)),
    _T.TIMEOUT_LOADED: Row(_S.FORCED_QUICK_STOP, (_O.QUICK_STOP,)),
}
_STOPPING: Final = {**_LEAVE, **_RESUME, **_ESCALATE, _T.GROUP_AT_STANDSTILL: Row(_S.DISABLING, (_O.DISABLE,))}
_CUT: Final = {_T.TIMEOUT: Row(_S.VOLTAGE_DISABLED, (_O.CUT,)), _T.TIMEOUT_LOADED: Row(_S.STOP_FAILED)}
_SEEN_OFF: Final = {
    _T.DRIVE_DISABLED: Row(_S.DISABLED, (_O.DISABLE,)),
    _T.AT_STANDSTILL: Row(_S.DISABLING, (_O.DISABLE,)),
}
_LOST: Final = {_T.NODE_LOST: Row(_S.DISABLED, (_O.DISABLE,))}

_ROWS: Final[Mapping[AxisPhase, Mapping[PhaseTrigger, Row]]] = {
    _S.DISABLED: {**_ALWAYS, **_ENABLE, _T.STOP: Row(_S.DISABLED, (_O.DISABLE,))},
    _S.SWITCHING_ON: {**_ENABLING, _T.GROUP_READY: Row(_S.ENABLING, (_O.RELEASE,))},
    _S.ENABLING: _ENABLING,
    _S.ENABLED: {**_ENABLED, _T.GROUP_ENABLED: Row(_S.READY)},
    _S.READY: {
        **_ENABLED,
        _T.GROUP_ENABLING: Row(_S.ENABLED),
        _T.MOTION_PERMITTED: Row(_S.FOLLOWING),
        _T.HOMING_STARTED: Row(_S.HOMING),
    },
    _S.FOLLOWING: {**_ENABLED, _T.GROUP_ENABLING: Row(_S.ENABLED), _T.STANDSTILL_REQUIRED: Row(_S.READY)},
    _S.HOMING: {**_ENABLED, _T.ENABLE: Row(_S.HOMING, (_O.RESUME,)), _T.HOMING_ENDED: Row(_S.READY)},
    _S.HALTED: _ENABLED,
    _S.RAMPING_DOWN: {**_STOPPING, _T.TARGET_AT_STANDSTILL: Row(_S.AWAITING_STANDSTILL)},
    _S.AWAITING_STANDSTILL: _STOPPING,
    _S.DISABLING: {
        **_ALWAYS,
        **_ENABLE,
        **_ESCALATE,
        _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
        _T.DRIVE_DISABLED: Row(_S.DISABLED),
    },
    _S.QUICK_STOPPING: {
        **_LOST,
        **_ENABLE,
        **_CUT,
        _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
        _T.DRIVE_DISABLED: Row(_S.DISABLED),
        _T.AT_STANDSTILL: Row(_S.QUICK_STOPPED),
    },
    _S.QUICK_STOPPED: {
        **_LOST,
        **_ENABLE,
        _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
        _T.DRIVE_DISABLED: Row(_S.DISABLED),
    },
    _S.FORCED_QUICK_STOP: {**_LOST, **_ENABLE, **_CUT, **_SEEN_OFF},
    _S.VOLTAGE_DISABLED: {
        **_LOST,
        **_ENABLE,
        _T.DRIVE_DISABLED: Row(_S.DISABLED),
        _T.TIMEOUT: Row(_S.STOP_FAILED),
        _T.TIMEOUT_LOADED: Row(_S.STOP_FAILED),
    },
    _S.STOP_FAILED: {**_ALWAYS, **_ENABLE, **_SEEN_OFF},
}


def _complete(state: AxisPhase, rows: Mapping[PhaseTrigger, Row]) -> Mapping[PhaseTrigger, Row]:
    """Add the transitions common to all states: a fault reset, and a halt, which takes effect when enabled.

    The added rows do not change the state.
    """
    everywhere = {_T.FAULT_RESET: Row(state, (_O.RESET,)), _T.HALT: Row(state, (_O.HALT,))}
    return MappingProxyType({**everywhere, **rows})


TABLE: Final[Mapping[AxisPhase, Mapping[PhaseTrigger, Row]]] = MappingProxyType(
    {state: _complete(state, rows) for state, rows in _ROWS.items()}
)
"""Transition for each state and trigger; other triggers have no effect."""

_WATCHED: Final = (*ENABLING, *LIMITS_NS, _S.AWAITING_STANDSTILL, _S.QUICK_STOPPED, _S.STOP_FAILED)


class PhaseObserver(Protocol):
    """Observer of the transitions of a statechart."""

    def row_taken(self, state: AxisPhase, trigger: PhaseTrigger) -> None:
        """Handle an applied transition; `state` is the previous state."""


class AxisStatechart:
    """State of one axis in the statechart; changed only by `fire` and `overdue`.

    `following` is True only in FOLLOWING, and equals `enabled` of the command interfaces. `watched` means that the
    drive must be checked in every cycle. `since` is the time at which the state was entered (AWAITING_STANDSTILL keeps
    that of RAMPING_DOWN), `deadline` the timeout of the state. `observer` is notified of applied rows.
    """

    def __init__(
        self, machine: DriveMachine, commands: Sequence[CommandInterface] = (), *, holds_load: bool = False
    ) -> None:
        self.state = AxisPhase.DISABLED
        self.following = False
        self.watched = False
        self.since = 0
        self.deadline = _NEVER
        self.holds_load = holds_load
        self.observer: PhaseObserver | None = None
        self._machine, self._commands = machine, commands
        for command in commands:
            command.enabled = False

    @property
    def enable_requested(self) -> bool:
        """Whether the axis is enabled or being enabled."""
        return self.state in ENABLED_STATES

    @property
    def rising(self) -> bool:
        """Whether the axis is being enabled."""
        return self.state in ENABLING

    @property
    def falling(self) -> bool:
        """Whether the axis performs a controlled stop, after which its whole group is disabled."""
        return self.state in STOPPING

    def fire(self, trigger: PhaseTrigger, now: int) -> bool:
        """Apply the transition of a trigger, if any; return whether the state has changed."""
        row = TABLE[self.state].get(trigger)
        if row is None:
            return False
        if self.observer is not None:
            self.observer.row_taken(self.state, trigger)
        changed = row.state is not self.state
        if changed:
            self._enter(row.state, now)
        for command in row.commands:
            _EXECUTE[command](self._machine)
        return changed

    def overdue(self, now: int) -> bool:
        """Fire the timeout trigger if the state's deadline has passed; return whether the state has changed."""
        if now <= self.deadline:
            return False
        return self.fire(PhaseTrigger.TIMEOUT_LOADED if self.holds_load else PhaseTrigger.TIMEOUT, now)

    def expire(self, now: int) -> None:
        """End the wait of a controlled stop, because the axis does not slow down."""
        self.deadline = now - 1

    def _enter(self, state: AxisPhase, now: int) -> None:
        if state is not AxisPhase.AWAITING_STANDSTILL:
            self.since = now
            self.deadline = now + LIMITS_NS[state] if state in LIMITS_NS else _NEVER
        self.state = state
        self.watched = state in _WATCHED
        following = state is AxisPhase.FOLLOWING
        if following is not self.following:
            self.following = following
            for command in self._commands:
                command.enabled = following
                if following:
                    command.excluded = False


def holds_load(description: ControlJoint) -> bool:
    """Return the parameter `holds_load` (the load would fall without power); raise RobotConfigError if invalid."""
    text = description.parameters.get("holds_load", "false").strip().lower()
    if text not in ("true", "false"):
        raise RobotConfigError(f"joint {description.name}: holds_load is {text!r}; it must be true or false")
    return text == "true"


def _prepare(machine: DriveMachine) -> None:
    machine.enable()
    machine.halt(False)
    machine.hold_in_switched_on(True)


_EXECUTE: Final[Mapping[DriveCommand, Callable[[DriveMachine], None]]] = MappingProxyType(
    {
        DriveCommand.PREPARE: _prepare,
        DriveCommand.RELEASE: lambda machine: machine.hold_in_switched_on(False),
        DriveCommand.RESUME: lambda machine: machine.halt(False),
        DriveCommand.HALT: lambda machine: machine.halt(True),
        DriveCommand.DISABLE: lambda machine: machine.disable(),
        DriveCommand.QUICK_STOP: lambda machine: machine.quick_stop(),
        DriveCommand.CUT: lambda machine: machine.disable_voltage(),
        DriveCommand.RESET: lambda machine: machine.fault_reset(),
    }
)


# Stop groups: joints that stop together after an error of one joint, and are enabled and disabled in one SYNC cycle.
#
# The axes of a group enter OPERATION_ENABLED when every axis that is being enabled is ready for this state, and are
# disabled when every axis that is being stopped is at standstill. All joints of a robot are one group unless the
# description defines others (`<param name="stop_group">`); a joint that stops alone has a group of its own. The joints
# that a base controller claims are always in one group, and move together or not at all.


class GroupMember(Protocol):
    """Interface of a joint for its stop group."""

    joint: str
    statechart: AxisStatechart
    group: StopGroup[Any]
    stop_group: StopGroup[Any]
    base: BaseJoints[Any] | None

    @property
    def enable_requested(self) -> bool: ...

    @property
    def is_enabled_or_ready(self) -> bool:
        """Whether the joint is enabled, or could be enabled as soon as its group permits."""

    def has_settled(self, now: int) -> bool:
        """Whether the controlled stop has ended, so that the drive may be disabled."""

    def stop(self, now: int) -> None: ...


J = TypeVar("J", bound=GroupMember)


class BaseJoints(Generic[J]):
    """Joints claimed by one base controller, with the controller's name."""

    __slots__ = ("joints", "name")

    def __init__(self, name: str, joints: Sequence[J]) -> None:
        self.name, self.joints = name, joints


class StopGroup(Generic[J]):
    """Joints that stop together; `busy` while a joint is being enabled or stopped."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.joints: list[J] = []
        self.busy = False

    def stop(self, now: int) -> list[J]:
        """Ramp every joint to a standstill, then disable all; return the joints that were enabled or being enabled."""
        moving = [joint for joint in self.joints if joint.enable_requested]
        for joint in self.joints:
            joint.stop(now)
        return moving

    def coordinate(self, now: int) -> None:
        """Fire the group triggers in the statecharts of the joints; call once per cycle while `busy`."""
        waiting = [joint for joint in self.joints if joint.statechart.state is AxisPhase.SWITCHING_ON]
        if waiting and all(joint.is_enabled_or_ready for joint in waiting):
            self._fire(PhaseTrigger.GROUP_READY, now)
        rising = any(joint.statechart.rising for joint in self.joints)
        self._fire(PhaseTrigger.GROUP_ENABLING if rising else PhaseTrigger.GROUP_ENABLED, now)
        falling = [joint for joint in self.joints if joint.statechart.falling]
        if falling and all(joint.has_settled(now) for joint in falling):
            self._fire(PhaseTrigger.GROUP_AT_STANDSTILL, now)
        self.busy = rising or any(joint.statechart.falling for joint in falling)

    def _fire(self, trigger: PhaseTrigger, now: int) -> None:
        for joint in self.joints:
            joint.statechart.fire(trigger, now)


def merge_base_groups(joints: Iterable[J], bases: Mapping[str, Collection[str]], now: int) -> None:
    """Assign joints to the base controllers that claim them, and merge the stop groups of each base.

    If only some joints of a base are enabled or being enabled, these are stopped.
    """
    joints = list(joints)
    bases_held = [
        BaseJoints(name, [joint for joint in joints if joint.joint in names]) for name, names in bases.items()
    ]
    sets: list[set[StopGroup[J]]] = []
    for base in bases_held:
        touched = {joint.stop_group for joint in base.joints}
        for overlapping in [members for members in sets if members & touched]:
            sets.remove(overlapping)
            touched |= overlapping
        sets.append(touched)
    merged: dict[StopGroup[J], StopGroup[J]] = {}
    for members in sets:
        if len(members) > 1:
            merged.update(dict.fromkeys(members, _merged(members, joints)))
    for joint in joints:
        joint.base = next((base for base in bases_held if joint in base.joints), None)
        _move(joint, merged.get(joint.stop_group, joint.stop_group))
    for base in bases_held:
        enabled = [joint for joint in base.joints if joint.enable_requested]
        if len(enabled) < len(base.joints):
            for joint in enabled:
                joint.stop(now)


def _merged(groups: set[StopGroup[J]], joints: Iterable[J]) -> StopGroup[J]:
    """Return one stop group that replaces several; reuse the first joint's group if it already has all their joints."""
    members = [joint for joint in joints if joint.stop_group in groups]
    if members[0].group.joints == members:
        return members[0].group
    merged: StopGroup[J] = StopGroup(", ".join(sorted(group.name for group in groups)))
    merged.joints = members
    return merged


def _move(joint: J, group: StopGroup[J]) -> None:
    if joint.group is not group:
        joint.group = group
        group.busy = True
