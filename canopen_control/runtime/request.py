"""Something asked of axes that takes time: answered when it is reached, fails, or runs out of time.

The law of this file: whatever can be refused is refused for all axes before any of them is touched.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING

from canopen_control.cia402 import objects
from canopen_control.cia402.homing import require_method
from canopen_control.cia402.modes import OperationMode, require_mode
from canopen_control.errors import ControlError, UnknownName
from canopen_control.hardware.axis_modes import MODES
from canopen_control.hardware.choice import listed_modes
from canopen_control.hardware.wishes import Action, Wish

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.cia301.sdo_client import SdoRequest
    from canopen_control.hardware.axis import Axis
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.hardware.system import CanopenSystem

__all__ = ["AxisRequest", "ProbeReading", "begin_action"]

_PROBE = {
    "function": objects.TOUCH_PROBE_FUNCTION,
    "status": objects.TOUCH_PROBE_STATUS,
    "probe_1_positive": objects.TOUCH_PROBE_1_POSITIVE,
    "probe_1_negative": objects.TOUCH_PROBE_1_NEGATIVE,
    "probe_2_positive": objects.TOUCH_PROBE_2_POSITIVE,
    "probe_2_negative": objects.TOUCH_PROBE_2_NEGATIVE,
}


class AxisRequest:
    """`action` on `joints`; `done` is called once, with None or a sentence that names who did not do it and why."""

    def __init__(
        self, joints: Sequence[JointDrive], action: Action, deadline: int, done: Callable[[str | None], None]
    ) -> None:
        self._joints, self._action, self._deadline, self._done = joints, action, deadline, done
        self._cycles = 0

    def settle(self, now: int) -> bool:
        """Look whether it is over, once per cycle; the first look comes after the drives had a chance to answer."""
        self._cycles += 1
        late = [joint for joint in self._joints if not joint.reached(self._action)]
        if self._cycles > 1 and not late:
            self._done(None)
            return True
        refused = [joint for joint in late if self._refused(joint)]
        if self._cycles > 1 and (refused or now > self._deadline) and not self._explaining(now):
            named = [joint for joint in late if joint.machine.fault] or refused or late
            self._done("; ".join(self._reason(joint) for joint in named))
            return True
        return False

    def fail(self, reason: str) -> None:
        """End it without success."""
        self._done(reason)

    def _explaining(self, now: int) -> bool:
        """Whether a drive is still being asked why it is in a fault."""
        return now <= self._deadline and any(joint.reason.asking for joint in self._joints)

    def _refused(self, joint: JointDrive) -> bool:
        """Whether waiting longer is of no use."""
        if self._action is Action.ENABLE:
            return joint.wish is not Wish.ON
        if self._action is Action.HOME:
            return joint.homing is None
        if self._action is Action.MODE:
            return joint.machine.mode_failed
        return self._action is Action.FAULT_RESET and not joint.machine.resetting

    def _reason(self, joint: JointDrive) -> str:
        node, state = joint.node, joint.state
        seen = "no statusword" if joint.statusword is None else f"statusword 0x{joint.statusword:04X}"
        name = "not there" if state is None else state.name.replace("_", " ")
        cause = f"; {node.error}" if node.error else ""
        if joint.machine.fault and joint.reason.text:
            cause += f"; {joint.reason.text}"
        if self._action is Action.HOME and joint.homing_result:
            cause = f"; {joint.homing_result}{cause}"
        return f"{node.who}: {self._action.value} not reached, it is {name} ({seen}){cause}"


class ProbeReading:
    """One read-out of the touch probes of an axis (0x60B8 to 0x60BD) by SDO; what the drive lacks is left out."""

    def __init__(self, axis: Axis, done: Callable[[dict[str, int] | str], None]) -> None:
        self._done = done
        self._values: dict[str, int] = {}
        wanted = [(name, index) for name, index in _PROBE.items() if axis.has(index)]
        if not wanted:
            raise ControlError(f"{axis.node.who} has no touch probe (0x60B9)")
        if not axis.node.ready:
            raise ControlError(f"{axis.node.who} is not operational")
        self._open = len(wanted)
        for name, index in wanted:
            axis.node.read(axis.index(index), 0, self._answer(name, signed=index >= objects.TOUCH_PROBE_1_POSITIVE))

    def _answer(self, name: str, *, signed: bool) -> Callable[[SdoRequest], None]:
        def answered(request: SdoRequest) -> None:
            if request.error is None:
                self._values[name] = int.from_bytes(request.data, "little", signed=signed)
            self._open -= 1
            if self._open == 0:
                self._done(self._values or str(request.error))

        return answered


def begin_action(
    action: Action,
    joints: Sequence[JointDrive],
    systems: Sequence[CanopenSystem],
    now: int,
    *,
    method: int | None = None,
    mode: str | None = None,
) -> int:
    """Begin what a user asks of these axes; returns how many ns it may take beyond the ordinary.

    Raises ControlError or DriveError where it cannot be, before any drive was touched.
    """
    if action is Action.ENABLE:
        for system in systems:
            system.enable([joint for joint in joints if joint in system.joints])
    elif action is Action.HOME:
        _home_axes(joints, method)
        return max((round(joint.node.config.homing_timeout_seconds * 1e9) for joint in joints), default=0)
    elif action is Action.MODE:
        _change_mode(joints, mode or "")
    else:
        for joint in joints:
            _SIMPLE[action](joint, now)
    return 0


def _home_axes(joints: Sequence[JointDrive], method: int | None) -> None:
    """Begin homing of all these axes, or of none; raises ControlError or DriveError."""
    for joint in joints:
        _require_there(joint)
        require_mode(OperationMode.HM, listed_modes(joint.axis, joint.parameters))
        if method is not None:
            require_method(method, joint.parameters.homing_methods)
    for joint in joints:
        joint.home(method)


def _change_mode(joints: Sequence[JointDrive], text: str) -> None:
    """Ask for a mode of operation; raises ControlError or DriveError before any drive was touched."""
    mode = _mode_of(text)
    for joint in joints:
        _require_there(joint)
        require_mode(mode, listed_modes(joint.axis, joint.parameters))
        serves = MODES.get(mode)
        if joint.claimed is not None and (serves is None or joint.targets.mode_serves(mode) != joint.claimed):
            raise ControlError(
                f"{joint.node.who}: a controller commands its {joint.claimed}, which mode "
                f"{mode.name} does not serve; deactivate that controller first"
            )
    for joint in joints:
        joint.targets.set_mode(mode)


def _mode_of(text: str) -> OperationMode:
    try:
        return OperationMode[text.upper()] if not text.lstrip("-").isdigit() else OperationMode(int(text))
    except (KeyError, ValueError):
        known = ", ".join(mode.name for mode in OperationMode if mode)
        raise UnknownName(f"no mode of operation {text!r}; there are: {known}") from None


def _require_there(joint: JointDrive) -> None:
    node = joint.node
    if not node.ready or not joint.parameters.loaded:
        raise ControlError(f"{node.who} is not operational: {node.error or 'it has not booted yet'}")


_SIMPLE: Mapping[Action, Callable[[JointDrive, int], None]] = MappingProxyType(
    {
        Action.DISABLE: lambda joint, now: joint.stop(now),
        Action.HALT: lambda joint, _now: joint.halt(),
        Action.QUICK_STOP: lambda joint, _now: joint.quick_stop(),
        Action.FAULT_RESET: lambda joint, _now: joint.fault_reset(),
    }
)
