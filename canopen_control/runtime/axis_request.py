"""Asynchronous axis requests (enable, halt, home, ...), answered on completion, failure or timeout.

A request is refused for all axes, or accepted for all, before any axis is changed.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from canopen_control.cia402 import objects
from canopen_control.cia402.drive_goal import FAULT_STATES
from canopen_control.cia402.homing import require_method
from canopen_control.cia402.modes import OperationMode, mode_words, require_mode
from canopen_control.cia402.state import POWERED_STATES, State
from canopen_control.errors import ControlError, DriveError, UnknownName
from canopen_control.hardware.axis_parameters import listed_modes, require_own_start
from canopen_control.hardware.axis_statechart import Action
from canopen_control.hardware.system import with_partners
from canopen_control.master.keys import MotionKeys

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from canopen_control.cia301.sdo_exchange import SdoRequest
    from canopen_control.hardware.axis import AxisProcessData
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.hardware.system import CanopenSystem
    from canopen_control.master.remote_node import RemoteNode


ALL: Final = "all"
"""Name of all nodes in a request."""
_PROBE = {
    "function": objects.TOUCH_PROBE_FUNCTION,
    "status": objects.TOUCH_PROBE_STATUS,
    "probe_1_positive": objects.TOUCH_PROBE_1_POSITIVE,
    "probe_1_negative": objects.TOUCH_PROBE_1_NEGATIVE,
    "probe_2_positive": objects.TOUCH_PROBE_2_POSITIVE,
    "probe_2_negative": objects.TOUCH_PROBE_2_NEGATIVE,
}


def _is_disabled(joint: JointDrive) -> bool:
    """Whether a drive has no power; False while a ready node has not sent a statusword."""
    return joint.state not in POWERED_STATES and (joint.state is not None or not joint.node.ready)


_REACHED: Final[Mapping[Action, Callable[[JointDrive], bool]]] = MappingProxyType(
    {
        Action.ENABLE: lambda joint: joint.enabled and joint.machine.reached,
        Action.DISABLE: _is_disabled,
        Action.HALT: lambda joint: joint.at_standstill,
        Action.QUICK_STOP: lambda joint: (
            joint.state is None or (joint.state is not State.OPERATION_ENABLED and joint.at_standstill)
        ),
        Action.FAULT_RESET: lambda joint: joint.state not in (None, *FAULT_STATES),
        Action.HOME: lambda joint: joint.homing is None and joint.homed,
        Action.MODE: lambda joint: (
            joint.targets.pending is None
            and joint.machine.mode_request.may_enable
            and not joint.machine.mode_request.failed
            # with `switching_state` the drive leaves OPERATION ENABLED to change the mode
            and (joint.machine.enabled or not joint.enable_requested)
        ),
    }
)


def reached(joint: JointDrive, action: Action) -> bool:
    """Whether a joint has reached the state requested by an action."""
    return _REACHED[action](joint)


def find_node(nodes: Mapping[str, RemoteNode], name: str) -> RemoteNode:
    """Return the node with this name or node-ID; raise UnknownName if it does not exist."""
    for node in nodes.values():
        if name in (node.name, str(node.node_id)):
            return node
    names = ", ".join(f"{node.name} ({node.node_id})" for node in nodes.values()) or "none"
    raise UnknownName(f"no node {name!r}; available: {names}")


def axes_of(
    nodes: Mapping[str, RemoteNode], joints: Collection[JointDrive], name: str, only: str | None = None
) -> tuple[JointDrive, ...]:
    """Return the axes of a node or of "all" nodes; `only` selects one joint. Raise ControlError if no axis matches."""
    axes = tuple(joints)
    if name == ALL and nodes and not axes:
        raise ControlError("no node drives a joint, so the robot has no axis")
    if name != ALL:
        node = find_node(nodes, name)
        axes = tuple(joint for joint in joints if joint.node is node)
        if not axes:
            raise ControlError(f"{node.label} drives no joint, so it has no axis")
    selected = tuple(joint for joint in axes if only is None or joint.joint == only)
    if only is not None and not selected:
        names = ", ".join(joint.joint for joint in axes) or "none"
        raise UnknownName(f"{name} has no joint {only!r}; available: {names}")
    return selected


def without_target(
    joints: tuple[JointDrive, ...], action: Action, name: str
) -> tuple[tuple[JointDrive, ...], list[JointDrive]]:
    """Omit axes that lack a target in an RPDO from an action that enables "all".

    Return the remaining and the omitted axes. If every axis lacks a target, none is omitted, so that the action is
    refused with the reason.
    """
    omitted = [joint for joint in joints if joint.lacks_target] if action is Action.ENABLE and name == ALL else []
    if len(omitted) == len(joints):
        return joints, []
    return tuple(joint for joint in joints if joint not in omitted), omitted


def whole_bases(joints: Sequence[JointDrive], action: Action) -> tuple[tuple[JointDrive, ...], str]:
    """Add the joints that share a base or a controlword; also return a sentence about them, or ""."""
    complete = with_partners(joints)
    notes = [
        f"{' and '.join(motor.joint for motor in (joint, *joint.partners))} share one controlword: "
        f"{action.value} applies to all of them"
        for joint in joints
        if any(partner not in joints for partner in joint.partners)
    ]
    for joint in list(complete):
        base = joint.base
        if base is None or all(joint in complete for joint in base.joints):
            continue
        complete += [joint for joint in base.joints if joint not in complete]
        names = " and ".join(dict.fromkeys(joint.node.name for joint in base.joints))
        notes.append(f"{base.name} moves {names} together: {action.value} applies to all of them")
    return tuple(complete), "; ".join(notes)


def stop_enabling(joints: Iterable[JointDrive], now: int) -> list[JointDrive]:
    """Stop the joints that are being enabled but are not enabled yet, with their groups; return all stopped joints."""
    rising = [joint for joint in joints if joint.enable_requested and not joint.machine.enabled]
    stopped = list(dict.fromkeys(member for joint in rising for member in joint.group.stop(now)))
    for joint in stopped:
        joint.stopped_by = f"stopped since the enabling of {', '.join(joint.joint for joint in rising)} was given up"
    return stopped


class PendingAxisRequest:
    """Pending `action` on `joints`; `done` is called once, with None on success, else with an error text.

    `holder` is the client that waits for the end of the action, or None.
    """

    def __init__(
        self,
        joints: Sequence[JointDrive],
        action: Action,
        deadline: int,
        done: Callable[[str | None], None],
        holder: object = None,
    ) -> None:
        self._joints, self._action, self._deadline, self._done = joints, action, deadline, done
        self._holder = holder
        self._cycles = 0
        #: every drive has answered, and none has a fault: the reset has no effect
        self._useless = action is Action.FAULT_RESET and all(reached(joint, action) for joint in joints)

    def settle(self, now: int) -> bool:
        """End the request if it is complete, failed or late; return whether it has ended. Called once per cycle."""
        self._cycles += 1
        late = [joint for joint in self._joints if not reached(joint, self._action)]
        if self._cycles > 1 and not late:
            self._done(self._without_fault() if self._useless else None)
            return True
        refused = [joint for joint in late if self._refused(joint)]
        if self._cycles > 1 and (refused or now > self._deadline) and not self._explaining(now):
            named = [joint for joint in late if joint.machine.fault] or refused or late
            reasons = "; ".join(self._reason(joint) for joint in named)
            if self._action is Action.ENABLE:  # no drive must be enabled after the answer that the request has failed
                others = dict.fromkeys(joint.node.name for joint in stop_enabling(late, now) if joint not in named)
                if others:
                    reasons += f"; therefore also disabled: {', '.join(others)}"
            self._done(reasons)
            return True
        return False

    def confirm_stop(self) -> bool:
        """End a disable request whose drives are disabled, even in its first cycle; return whether it has ended."""
        stopped = self._action is Action.DISABLE and all(reached(joint, self._action) for joint in self._joints)
        if stopped:
            self._done(None)
        return stopped

    def abandon(self, holder: object, now: int) -> list[str]:
        """Stop the axes that this request homes or enables, because its client is gone; return their names."""
        if self._holder is not holder or holder is None:
            return []
        if self._action is Action.ENABLE:
            return [joint.joint for joint in stop_enabling(self._joints, now)]
        homing = [joint for joint in self._joints if self._action is Action.HOME and joint.homing is not None]
        for joint in homing:
            joint.stop(now)
        return [joint.joint for joint in homing]

    def fail(self, reason: str) -> None:
        self._done(reason)

    def _without_fault(self) -> str:
        labels = dict.fromkeys(joint.node.label for joint in self._joints) or ["the robot, which has no drive,"]
        return f"nothing was reset, because {' and '.join(labels)} {'have' if len(labels) > 1 else 'has'} no fault"

    def _explaining(self, now: int) -> bool:
        """Whether the cause of a drive's fault is still being read by SDO."""
        return now <= self._deadline and any(joint.faults.asking for joint in self._joints)

    def _refused(self, joint: JointDrive) -> bool:
        """Whether the request can no longer succeed."""
        if self._action is Action.ENABLE:
            return not joint.enable_requested
        if self._action is Action.HOME:
            return joint.homing is None
        if self._action is Action.MODE:
            return joint.machine.mode_request.failed
        return self._action is Action.FAULT_RESET and not joint.machine.resetting

    def _reason(self, joint: JointDrive) -> str:
        node, state = joint.node, joint.state
        word = "no statusword" if joint.statusword is None else f"statusword 0x{joint.statusword:04X}"
        name = "not there" if state is None else state.name.replace("_", " ")
        cause = f"; {node.reason}" if node.error else ""
        if (fault := joint.fault) is not None and fault.error_code is not None:
            cause += f"; 0x603F is {fault.code_text}"
        if self._action is Action.ENABLE and joint.stopped_by:
            cause += f"; {joint.stopped_by}"
        if self._action is Action.HOME and joint.home_position.result:
            cause = f"; {joint.home_position.result}{cause}"
        return f"{node.label}: {self._action.value} not reached, the drive is {name} ({word}){cause}"


class ProbeReading:
    """One-time read of an axis' touch probe objects (0x60B8 to 0x60BD) by SDO; missing objects are omitted.

    Raises ControlError if the axis has no touch probe, or if its node is not ready.
    """

    def __init__(self, axis: AxisProcessData, done: Callable[[dict[str, int] | str], None]) -> None:
        self._done = done
        self._values: dict[str, int] = {}
        objects_read = [(name, index) for name, index in _PROBE.items() if axis.has(index)]
        if not objects_read:
            raise ControlError(f"{axis.node.label} has no touch probe (0x60B9)")
        if not axis.node.ready:
            raise ControlError(f"{axis.node.label} is not operational")
        self._open = len(objects_read)
        for name, index in objects_read:
            axis.node.read(axis.index(index), 0, self._answer(name, signed=index >= objects.TOUCH_PROBE_1_POSITIVE))

    def _answer(self, name: str, *, signed: bool) -> Callable[[SdoRequest], None]:
        def answered(request: SdoRequest) -> None:
            if request.error is None:
                self._values[name] = int.from_bytes(request.data, "little", signed=signed)
            self._open -= 1
            if self._open == 0:
                self._done(self._values or str(request.error))

        return answered


EXCLUSIVE_ACTIONS: Final = frozenset((Action.DISABLE, Action.HALT, Action.QUICK_STOP))
"""Actions after which an axis ignores the running command, while the other axes of that command continue."""


def begin_action(
    action: Action,
    joints: Sequence[JointDrive],
    systems: Sequence[CanopenSystem],
    now: int,
    *,
    method: int | None = None,
    mode: str | None = None,
) -> int:
    """Start a user's action on axes; return the extension of the request timeout in ns, usually 0.

    Raise ControlError or DriveError if the action is impossible, before any drive is changed.
    """
    if action is Action.ENABLE:
        parts = [(system, [joint for joint in joints if joint in system.joints]) for system in systems]
        for system, part in parts:
            system.prepare_enable(part)
        for system, part in parts:
            system.enable(part)
        patience = [sum(joint.node.config.motion.transition_timeouts_ms.values()) for joint in joints]
        return max(patience, default=0) * 1_000_000
    elif action is Action.HOME:
        _home_axes(joints, method)
        return max((round(joint.node.config.motion.homing_timeout_seconds * 1e9) for joint in joints), default=0)
    elif action is Action.MODE:
        _change_mode(joints, mode or "")
    else:
        for joint in joints:
            _SIMPLE[action](joint, now)
        if action is Action.FAULT_RESET:
            longest = max((joint.node.config.motion.fault_reset_timeout_ms for joint in joints), default=0)
            return max(0, longest - MotionKeys().fault_reset_timeout_ms) * 1_000_000
    return 0


def _home_axes(joints: Sequence[JointDrive], method: int | None) -> None:
    """Start homing of all joints; if one cannot be homed, raise ControlError or DriveError before any axis starts."""
    for joint in joints:
        _require_present(joint)
        require_own_start(joint.axis, OperationMode.HM)
        require_mode(OperationMode.HM, listed_modes(joint.axis, joint.parameters))
        if method is not None:
            require_method(method, joint.parameters.homing_methods)
    for joint in joints:
        joint.home(method)


def _change_mode(joints: Sequence[JointDrive], text: str) -> None:
    """Request a mode of operation by name or number; raise ControlError or DriveError before any drive is changed."""
    mode = _mode_of(text)
    for joint in joints:
        _require_present(joint)
        if mode < 0 and mode not in joint.axis.own_modes:
            raise DriveError(
                f"{joint.axis.label}: {mode_words(mode)} is not in bus.yml; give it there with its target, such as "
                f"`velocity_mode: {mode}` and `velocity_target: 0x60FF`"
            )
        require_own_start(joint.axis, mode)
        require_mode(mode, listed_modes(joint.axis, joint.parameters))
        joint.targets.require_claim(mode)
    for joint in joints:
        joint.targets.set_mode(mode)


def _mode_of(text: str) -> int:
    if text.startswith("-") and text[1:].isdigit():
        return int(text)  # negative modes are manufacturer-specific (CiA 402-2, 0x6060)
    try:
        return OperationMode[text.upper()] if not text.lstrip("-").isdigit() else OperationMode(int(text))
    except (KeyError, ValueError):
        names = ", ".join(mode.name for mode in OperationMode if mode)
        raise UnknownName(f"no mode of operation {text!r}; available: {names}") from None


def _require_present(joint: JointDrive) -> None:
    node = joint.node
    if not node.ready or not joint.parameters.loaded:
        raise ControlError(node.absence)


_SIMPLE: Mapping[Action, Callable[[JointDrive, int], None]] = MappingProxyType(
    {
        Action.DISABLE: lambda joint, now: joint.stop(now),
        Action.HALT: lambda joint, _now: joint.halt(),
        Action.QUICK_STOP: lambda joint, _now: joint.quick_stop(),
        Action.FAULT_RESET: lambda joint, _now: joint.fault_reset(),
    }
)
