"""Statechart of one axis as a table of states and triggers: power, stops, and permission to move.

`TABLE` has for each state and trigger the next state and the commands to the drive; a trigger without a row changes
nothing. Targets of a controller are sent only in FOLLOWING, and every path to this state begins with ENABLE: a fault
reset, a drive that returns or a complete group never lead from a stop to FOLLOWING. The rows with GROUP_ are triggers
of the stop group (`StopGroup`): its joints are enabled in one cycle and disabled in one cycle. Every state of a stop
has a timeout (`LIMITS_NS`), which is followed by a quick stop, then by disable voltage, unless the axis holds a load
that would fall; the last state reports that the axis has not stopped.
"""

from __future__ import annotations

import enum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, Generic, NamedTuple, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from canopen_control.cia402.drive import DriveMachine
    from canopen_control.hardware.interfaces import CommandInterface


_SECOND: Final = 1_000_000_000
_NEVER: Final = (1 << 62) - 1  # small enough for an unboxed integer in compiled code


class Action(enum.Enum):
    """Action on an axis that a user can request."""

    ENABLE = "enable"
    DISABLE = "disable"
    HALT = "halt"
    QUICK_STOP = "quick-stop"
    FAULT_RESET = "fault-reset"
    HOME = "home"
    MODE = "mode"


class AxisPhase(enum.Enum):
    """State in the statechart of an axis; the value describes the state."""

    OFF = "disabled"
    RISING = "being enabled; waits before OPERATION_ENABLED for its group"
    RELEASED = "being enabled; its group has let it into OPERATION_ENABLED"
    ENABLED = "enabled; its targets rest until its whole group is"
    READY = "enabled with its group; its targets rest until the drive may move in the mode that was asked for"
    FOLLOWING = "enabled; the targets of its controller are sent"
    HOMING = "enabled; homing"
    HALTED = "enabled; held by the halt bit until the next enable"
    BRAKING = "a controlled stop: its target ramps to zero"
    SETTLING = "a controlled stop: its target stands; waits until it and its group stand still"
    DISABLING = "told to disable by the drive's own ramp, and not seen disabled yet"
    QUICK_STOPPING = "commanded to quick stop by a user"
    QUICK_STOPPED = "stopped by a quick stop; with power or without, as the drive's 0x605A says"
    ESCALATED = "its stop took too long: quick stop commanded"
    VOLTAGE_OFF = "its quick stop took too long: voltage disabled, a turning motor coasts"
    UNSTOPPED = "no stop command had a visible effect"


class PhaseTrigger(enum.Enum):
    """Trigger of a row in the statechart; the value describes the trigger."""

    ENABLE = "a request enables it"
    STOP = "a request, or trouble in its group, stops it"
    QUICK_STOP = "a request quick stops it"
    HALT = "a request halts it"
    FAULT_RESET = "a request resets a fault"
    GROUP_MAY_RISE = "every joint of its group that is being enabled waits"
    GROUP_RISES = "a joint of its group is being enabled"
    GROUP_ENABLED = "no joint of its group is being enabled any more"
    GROUP_RESTS = "every joint of its group that is being stopped stands still"
    DRIVE_ENABLED = "the drive is seen in OPERATION_ENABLED"
    DRIVE_OFF = "the drive is seen without torque"
    DRIVE_LEFT = "the drive left operation on its own, or refuses it"
    NODE_LOST = "its node is gone"
    MAY_MOVE = "the drive may move in the mode that was asked for"
    MUST_REST = "the drive may not move, or something else than a controller needs it"
    HOMING_RUNS = "its homing runs"
    HOMING_ENDED = "its homing is over"
    TARGET_STANDS = "its target has come to zero"
    AT_REST = "the drive has left OPERATION_ENABLED and stands still"
    OVERDUE = "the time of the state is over"
    OVERDUE_LOADED = "the time of the state is over, and the axis holds a load that would fall"


class DriveCommand(enum.Enum):
    """Command to the drive in a row of the statechart; the value describes the command."""

    PREPARE = "enable, and wait before OPERATION_ENABLED; no halt"
    RELEASE = "go into OPERATION_ENABLED"
    RESUME = "no halt"
    HALT = "halt"
    DISABLE = "disable"
    QUICK_STOP = "quick stop"
    CUT = "disable voltage"
    RESET = "reset the fault"


class Row(NamedTuple):
    """Row of the statechart: the next state, and the commands to the drive."""

    state: AxisPhase
    orders: tuple[DriveCommand, ...] = ()


_S, _T, _O = AxisPhase, PhaseTrigger, DriveCommand
UP: Final = (_S.RISING, _S.RELEASED, _S.ENABLED, _S.READY, _S.FOLLOWING, _S.HOMING, _S.HALTED)
"""States of an axis that is enabled or being enabled."""
RISING: Final = (_S.RISING, _S.RELEASED)
FALLING: Final = (_S.BRAKING, _S.SETTLING)
STOPPED: Final = (_S.OFF, _S.QUICK_STOPPED)

LIMITS_NS: Final[Mapping[AxisPhase, int]] = MappingProxyType(
    {
        _S.BRAKING: 10 * _SECOND,  # includes SETTLING, which keeps this deadline
        _S.DISABLING: 10 * _SECOND,
        _S.QUICK_STOPPING: 10 * _SECOND,
        _S.ESCALATED: 3 * _SECOND,
        _S.VOLTAGE_OFF: 1 * _SECOND,
    }
)
"""Timeouts of states in ns, after which OVERDUE is fired; the other states have no timeout."""

_ALWAYS: Final = {_T.QUICK_STOP: Row(_S.QUICK_STOPPING, (_O.QUICK_STOP,)), _T.NODE_LOST: Row(_S.OFF, (_O.DISABLE,))}
_LEAVE: Final = {**_ALWAYS, _T.DRIVE_LEFT: Row(_S.DISABLING, (_O.DISABLE,))}
_RISE: Final = {_T.ENABLE: Row(_S.RISING, (_O.PREPARE,))}
_GO_ON: Final = {_T.ENABLE: Row(_S.ENABLED, (_O.RESUME,))}  # not FOLLOWING at once: a new command is needed
_UP: Final = {**_LEAVE, **_GO_ON, _T.STOP: Row(_S.BRAKING), _T.HALT: Row(_S.HALTED, (_O.HALT,))}
_RISING: Final = {
    **_LEAVE,
    **_RISE,
    _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
    _T.DRIVE_ENABLED: Row(_S.ENABLED, (_O.RELEASE,)),
}
_ESCALATE: Final = {
    _T.OVERDUE: Row(_S.ESCALATED, (_O.QUICK_STOP,)),
    _T.OVERDUE_LOADED: Row(_S.ESCALATED, (_O.QUICK_STOP,)),
}
_FALLING: Final = {**_LEAVE, **_GO_ON, **_ESCALATE, _T.GROUP_RESTS: Row(_S.DISABLING, (_O.DISABLE,))}
_CUT: Final = {_T.OVERDUE: Row(_S.VOLTAGE_OFF, (_O.CUT,)), _T.OVERDUE_LOADED: Row(_S.UNSTOPPED)}
_SEEN_OFF: Final = {_T.DRIVE_OFF: Row(_S.OFF, (_O.DISABLE,)), _T.AT_REST: Row(_S.DISABLING, (_O.DISABLE,))}
_LOST: Final = {_T.NODE_LOST: Row(_S.OFF, (_O.DISABLE,))}

_ROWS: Final[Mapping[AxisPhase, Mapping[PhaseTrigger, Row]]] = {
    _S.OFF: {**_ALWAYS, **_RISE, _T.STOP: Row(_S.OFF, (_O.DISABLE,))},
    _S.RISING: {**_RISING, _T.GROUP_MAY_RISE: Row(_S.RELEASED, (_O.RELEASE,))},
    _S.RELEASED: _RISING,
    _S.ENABLED: {**_UP, _T.GROUP_ENABLED: Row(_S.READY)},
    _S.READY: {
        **_UP,
        _T.GROUP_RISES: Row(_S.ENABLED),
        _T.MAY_MOVE: Row(_S.FOLLOWING),
        _T.HOMING_RUNS: Row(_S.HOMING),
    },
    _S.FOLLOWING: {**_UP, _T.GROUP_RISES: Row(_S.ENABLED), _T.MUST_REST: Row(_S.READY)},
    _S.HOMING: {**_UP, _T.ENABLE: Row(_S.HOMING, (_O.RESUME,)), _T.HOMING_ENDED: Row(_S.READY)},
    _S.HALTED: _UP,
    _S.BRAKING: {**_FALLING, _T.TARGET_STANDS: Row(_S.SETTLING)},
    _S.SETTLING: _FALLING,
    _S.DISABLING: {
        **_ALWAYS,
        **_RISE,
        **_ESCALATE,
        _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
        _T.DRIVE_OFF: Row(_S.OFF),
    },
    _S.QUICK_STOPPING: {
        **_LOST,
        **_RISE,
        **_CUT,
        _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)),
        _T.DRIVE_OFF: Row(_S.OFF),
        _T.AT_REST: Row(_S.QUICK_STOPPED),
    },
    _S.QUICK_STOPPED: {**_LOST, **_RISE, _T.STOP: Row(_S.DISABLING, (_O.DISABLE,)), _T.DRIVE_OFF: Row(_S.OFF)},
    _S.ESCALATED: {**_LOST, **_RISE, **_CUT, **_SEEN_OFF},
    _S.VOLTAGE_OFF: {
        **_LOST,
        **_RISE,
        _T.DRIVE_OFF: Row(_S.OFF),
        _T.OVERDUE: Row(_S.UNSTOPPED),
        _T.OVERDUE_LOADED: Row(_S.UNSTOPPED),
    },
    _S.UNSTOPPED: {**_ALWAYS, **_RISE, **_SEEN_OFF},
}


def _complete(state: AxisPhase, rows: Mapping[PhaseTrigger, Row]) -> Mapping[PhaseTrigger, Row]:
    """Return the rows of a state together with the rows of every state: fault reset, and a halt that is stored.

    The added rows do not change the state.
    """
    everywhere = {_T.FAULT_RESET: Row(state, (_O.RESET,)), _T.HALT: Row(state, (_O.HALT,))}
    return MappingProxyType({**everywhere, **rows})


TABLE: Final[Mapping[AxisPhase, Mapping[PhaseTrigger, Row]]] = MappingProxyType(
    {state: _complete(state, rows) for state, rows in _ROWS.items()}
)
"""State and trigger to the row that applies; a trigger without a row changes nothing."""

_WATCHED: Final = (*RISING, *LIMITS_NS, _S.SETTLING, _S.QUICK_STOPPED, _S.UNSTOPPED)


class PhaseObserver(Protocol):
    """Observer that is informed of every row that a statechart applies."""

    def row_taken(self, state: AxisPhase, trigger: PhaseTrigger) -> None:
        """Process an applied row: the state before, and the trigger."""


class AxisStatechart:
    """State of one axis in the statechart; only `fire` and `overdue` change the state.

    `following` is True only in FOLLOWING, and equals `enabled` of the command interfaces. `watched` means that the
    drive must be checked in every cycle. `since` is the time at which the state was entered (SETTLING keeps that of
    BRAKING), `deadline` the timeout of the state. `observer` is informed of applied rows.
    """

    def __init__(
        self, machine: DriveMachine, commands: Sequence[CommandInterface] = (), *, holds_load: bool = False
    ) -> None:
        self.state = AxisPhase.OFF
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
        return self.state in UP

    @property
    def rising(self) -> bool:
        """Whether the axis is being enabled."""
        return self.state in RISING

    @property
    def falling(self) -> bool:
        """Whether the axis performs a controlled stop, to be disabled together with its group."""
        return self.state in FALLING

    def fire(self, trigger: PhaseTrigger, now: int) -> bool:
        """Apply the row of a trigger, if there is one; return whether the state has changed."""
        row = TABLE[self.state].get(trigger)
        if row is None:
            return False
        if self.observer is not None:
            self.observer.row_taken(self.state, trigger)
        changed = row.state is not self.state
        if changed:
            self._enter(row.state, now)
        for order in row.orders:
            _EXECUTE[order](self._machine)
        return changed

    def overdue(self, now: int) -> bool:
        """Apply the timeout row of the state if its deadline has passed; return whether the state has changed."""
        if now <= self.deadline:
            return False
        return self.fire(PhaseTrigger.OVERDUE_LOADED if self.holds_load else PhaseTrigger.OVERDUE, now)

    def _enter(self, state: AxisPhase, now: int) -> None:
        if state is not AxisPhase.SETTLING:
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
    """Interface through which a stop group uses its joints."""

    joint: str
    power: AxisStatechart
    group: StopGroup[Any]
    stop_group: StopGroup[Any]
    base: BaseJoints[Any] | None

    @property
    def enable_requested(self) -> bool:
        """Whether the joint is enabled or being enabled."""

    @property
    def can_enable(self) -> bool:
        """Whether the joint waits only for its group before OPERATION_ENABLED."""

    def has_settled(self, now: int) -> bool:
        """Return whether the drive may be disabled, because its controlled stop is over."""

    def stop(self, now: int) -> None:
        """Ramp to zero, then disable the drive."""


J = TypeVar("J", bound=GroupMember)


class BaseJoints(Generic[J]):
    """Joints claimed by one base controller; `name` is the name of the controller."""

    __slots__ = ("joints", "name")

    def __init__(self, name: str, joints: Sequence[J]) -> None:
        self.name, self.joints = name, joints


class StopGroup(Generic[J]):
    """Joints that stop together; `busy` is True while one of them is being enabled or stopped."""

    def __init__(self, name: str = "") -> None:
        self.name = name
        self.joints: list[J] = []
        self.busy = False

    def stop(self, now: int) -> list[J]:
        """Ramp every joint to zero, then disable it; return the joints that were enabled or being enabled."""
        moving = [joint for joint in self.joints if joint.enable_requested]
        for joint in self.joints:
            joint.stop(now)
        return moving

    def coordinate(self, now: int) -> None:
        """Fire the group triggers in the statechart of each joint; call once per cycle while `busy`."""
        waiting = [joint for joint in self.joints if joint.power.state is AxisPhase.RISING]
        if waiting and all(joint.can_enable for joint in waiting):
            self._fire(PhaseTrigger.GROUP_MAY_RISE, now)
        rising = any(joint.power.rising for joint in self.joints)
        self._fire(PhaseTrigger.GROUP_RISES if rising else PhaseTrigger.GROUP_ENABLED, now)
        falling = [joint for joint in self.joints if joint.power.falling]
        if falling and all(joint.has_settled(now) for joint in falling):
            self._fire(PhaseTrigger.GROUP_RESTS, now)
        self.busy = rising or any(joint.power.falling for joint in falling)

    def _fire(self, trigger: PhaseTrigger, now: int) -> None:
        for joint in self.joints:
            joint.power.fire(trigger, now)


def regroup(joints: Iterable[J], bases: Mapping[str, Collection[str]], now: int) -> None:
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
    """Return the merged stop group, which is the present group of the first joint if its members are the same."""
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
