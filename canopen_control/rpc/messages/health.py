"""Display texts and advice for the states of axes and robots, and the health of drives, for all displays and ROS.

The first matching rule applies (REP 107): no data is STALE; a fault, or an error of a drive that is not enabled, is an
ERROR; a drive that is booting or not enabled, which may be intended, or an error of an enabled drive, is a WARN;
otherwise OK.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, Final, NamedTuple

from canopen_control.cia402.state import State
from canopen_control.rpc.quick_verbs import state_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from canopen_control.rpc.messages.state import AxisReading, NodeReading


GOOD, IDLE, WARN, BAD = "good", "idle", "warn", "bad"
"""Display levels of a state: works, idle, needs attention, does not work."""


class StateWords(NamedTuple):
    """Display text of a state: meaning, display level `tone`, advice, and suggested API action."""

    text: str
    tone: str
    advice: str = ""
    action: str = ""


AXIS_STATES: Final = {
    State.NOT_READY_TO_SWITCH_ON.name: StateWords("starting up", IDLE),
    State.SWITCH_ON_DISABLED.name: StateWords("disabled", IDLE),
    State.READY_TO_SWITCH_ON.name: StateWords("disabled, ready to switch on", IDLE),
    State.SWITCHED_ON.name: StateWords("switched on, not enabled", WARN),
    State.OPERATION_ENABLED.name: StateWords("enabled, follows commands", GOOD),
    State.QUICK_STOP_ACTIVE.name: StateWords("quick stop", WARN),
    State.FAULT_REACTION_ACTIVE.name: StateWords("fault, stopping", BAD),
    State.FAULT.name: StateWords("fault", BAD),
}
"""Meanings of the states of an axis, by their names in CiA 402."""
_NEEDS_ENABLE: Final = StateWords(
    "needs enable", WARN, "Nothing moves before the drives are enabled: press Enable.", "enable"
)
ROBOT_STATES: Final = {
    "starting": StateWords("starting", WARN, "The drives are being booted."),
    "running": StateWords("running", GOOD),
    "disabled": _NEEDS_ENABLE,
    "fault": StateWords("fault", BAD, "Remove the cause, then press Reset fault, then Enable.", "fault-reset"),
    "stopping": StateWords("stopping", WARN, "The joints ramp down to a standstill."),
    "stopped": StateWords("stopped", IDLE, "The robot has ended its run."),
}
"""Meanings of the states of a robot as a whole; a state unknown to this version is shown by its name."""
LATCHED: Final = StateWords("STOP is latched", BAD, "Press Release STOP, then Enable.", "release")


_FAULTS: Final = (State.FAULT.name, State.FAULT_REACTION_ACTIVE.name)


class Health(enum.IntEnum):
    """Health levels of diagnostic_msgs/msg/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


class HealthStatus(NamedTuple):
    """Health level of a drive, with a short reason for it."""

    level: Health
    message: str


def stale(age: float | None, after: float, *, is_known: bool) -> HealthStatus | None:
    """Return STALE if no message was received or the data is older than `after` s, else None.

    `age` is the age of the newest data in s; `is_known` is True if any message was received.
    """
    if not is_known:
        return HealthStatus(Health.STALE, "no message was received from it")
    if age is not None and age > after:
        return HealthStatus(Health.STALE, f"no news for {age:.2f} s")
    return None


def diagnose(states: Sequence[str | None], *, ready: bool, nmt: str | None, error: str | None) -> HealthStatus:
    """Return the health of a drive from axis states, boot, NMT state and error text."""
    if any(state in _FAULTS for state in states):
        return HealthStatus(Health.ERROR, error or "the drive is in fault")
    if not ready:
        level = Health.WARN if nmt and not error else Health.ERROR
        return HealthStatus(level, error or f"not ready, NMT state {state_name(nmt or 'unknown').lower()}")
    waiting = [state for state in states if state != State.OPERATION_ENABLED.name]
    if error:
        return HealthStatus(Health.ERROR if waiting else Health.WARN, error)
    if waiting:
        return HealthStatus(
            Health.WARN, f"not enabled: {', '.join(state_name(state or 'no statusword').lower() for state in waiting)}"
        )
    return HealthStatus(Health.OK, "operational")


def diagnose_node(node: NodeReading) -> HealthStatus:
    """Return the health of a node with all its axes."""
    states = [axis.state for axis in node.axes]
    error = node.error or next((axis.error for axis in node.axes if axis.error), None)
    return diagnose(states, ready=node.ready, nmt=_nmt_of(node), error=error)


def diagnose_axis(node: NodeReading, axis: AxisReading | None) -> HealthStatus:
    """Return the health of one axis of a node, or of a node without axes."""
    states = [] if axis is None else [axis.state]
    error = (axis.error if axis is not None else None) or node.error
    return diagnose(states, ready=node.ready, nmt=_nmt_of(node), error=error)


def _nmt_of(node: NodeReading) -> str | None:
    return None if node.age is None else node.nmt_state
