"""Record of a passed preflight, and the speed limit of a run on real drives without a valid record.

A record is valid for one configuration (the bytes of all files of the robot with their EDS files, and the xacro
arguments) and the same drives (serial numbers, 0x1018:04), and covers the joints that the preflight turned. If a file,
an argument or a drive differs, or a drive does not answer, a run on real drives is slow (`SpeedCap`) and reports the
reason. A joint that was not turned stays slow.
"""

from __future__ import annotations

import hashlib
import json
import math
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError, ConfigError, SdoAbort
from canopen_control.hardware.device_parts import device_of
from canopen_control.hardware.interfaces import TARGET
from canopen_control.host.files import state_dir, telling, write_whole
from canopen_control.master.direct import DirectBus
from canopen_control.od.codec import fitted
from canopen_control.od.model import DataType
from canopen_control.urdf.joint_element import EFFORT, POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Iterable, Mapping
    from pathlib import Path

    from canopen_control.controllers.manager import CommandLimiter
    from canopen_control.hardware.interfaces import CommandInterface, InterfaceRegistry, StateInterface
    from canopen_control.hardware.joint import JointDrive
    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import ControlJoint


# Speed limit of all joints, for every command interface, for the first run with real drives.
#
# A command that cannot be limited is reported. A velocity is limited when it is converted to the drive's target, as are
# the drive's own speeds (0x6081, 0x6099). A position follows its command in steps of at most speed times cycle, from
# the actual position. An effort is set to 0 while the joint is faster than the cap and the effort accelerates it.


_LAG_S = 0.5  # a joint with a larger lag at the cap is disabled or blocked


class _Position:
    """Limiter of a position command: the position follows the command at the speed cap."""

    __slots__ = ("_command", "_here", "_last", "_limit", "_target")

    def __init__(self, command: CommandInterface, here: StateInterface, limit: float) -> None:
        self._command, self._here, self._limit = command, here, limit
        self._last = self._target = math.nan

    def enforce(self, period: float) -> None:
        value, here = self._command.value, self._here.value
        if self._command.owner is None or not math.isfinite(value):
            self._last = math.nan
            return
        # if the value is unchanged, no controller was updated, and the ramp to the last command continues
        if value != self._last:
            self._target = value
        followed = abs(self._last - here) <= self._limit * _LAG_S  # False for nan
        start, step = self._last if followed else here, self._limit * period
        self._command.value = self._last = max(start - step, min(start + step, self._target))


class _Effort:
    """Limiter of an effort command: sets it to 0 while it would accelerate a joint that exceeds the speed cap."""

    __slots__ = ("_command", "_limit", "_speed")

    def __init__(self, command: CommandInterface, speed: StateInterface, limit: float) -> None:
        self._command, self._speed, self._limit = command, speed, limit

    def enforce(self, period: float) -> None:  # noqa: ARG002 - as with a position
        speed = self._speed.value
        if self._command.value * speed > 0.0 and abs(speed) > self._limit:
            self._command.value = 0.0


class _Target:
    """Limiter of a `target` command, whose quantity is that of the current mode: velocity, position or effort."""

    __slots__ = ("_command", "_effort", "_limit", "_position")

    def __init__(self, command: CommandInterface, here: StateInterface, speed: StateInterface, limit: float) -> None:
        self._command, self._limit = command, limit
        self._position, self._effort = _Position(command, here, limit), _Effort(command, speed, limit)

    def enforce(self, period: float) -> None:
        command, quantity = self._command, self._command.quantity
        if quantity == VELOCITY:
            if abs(command.value) > self._limit:  # False for nan
                command.value = math.copysign(self._limit, command.value)
        elif quantity == EFFORT:
            self._effort.enforce(period)
        else:
            self._position.enforce(period)


_NEEDS: dict[str, tuple[str, Callable[[CommandInterface, StateInterface, float], _Position | _Effort]]] = {
    POSITION: (POSITION, _Position),
    EFFORT: (VELOCITY, _Effort),
}


class SpeedCap:
    """Command limiter that caps the speed of `joints` in rad/s or m/s; `unlimited` are commands that it cannot cap."""

    def __init__(
        self, registry: InterfaceRegistry, joints: Container[str], limit: float, before: CommandLimiter | None = None
    ) -> None:
        self.unlimited: list[str] = []
        self._before, self._limit = before, limit
        self._capped: list[_Position | _Effort | _Target] = []
        states = {state_interface.name: state_interface for state_interface in registry.state_interfaces}
        for command in registry.command_interfaces:
            if command.joint in joints and command.interface == TARGET:
                self._cap_target(command, states)
            if command.joint not in joints or command.interface not in _NEEDS:
                continue
            needed, make = _NEEDS[command.interface]
            state = states.get(f"{command.joint}/{needed}")
            if state is None:
                self.unlimited.append(command.name)
            else:
                self._capped.append(make(command, state, limit))

    def _cap_target(self, command: CommandInterface, states: Mapping[str, StateInterface]) -> None:
        here, speed = (states.get(f"{command.joint}/{interface}") for interface in (POSITION, VELOCITY))
        if here is None or speed is None:
            self.unlimited.append(command.name)
        else:
            self._capped.append(_Target(command, here, speed, self._limit))

    def bound(self, drives: Iterable[JointDrive], reductions: Mapping[str, float]) -> None:
        """Limit the velocity targets of drives, and the speeds of motions that drives generate.

        `reductions` are motor turns per joint turn, for joints with a transmission.
        """
        for drive in drives:
            most = self._limit * abs(reductions.get(drive.joint, 1.0))
            drive.axis.limits.lower(most, "the speed limit of this run")
            command = drive.commands.get(VELOCITY)
            if command is not None:
                command.minimum = max(command.minimum, -most)
                command.maximum = min(command.maximum, most)

    def enforce(self, period: float) -> str | None:
        """Limit commands that are too fast; `period` is in s. Return the text of the previous limiter."""
        limited = None if self._before is None else self._before.enforce(period)
        for cap in self._capped:
            cap.enforce(period)
        return limited


SLOW = 1.0  # rad/s, or m/s of a prismatic joint, without a passed preflight
_SERIAL = (0x1018, 4)
_ANSWER_S = 0.5


@dataclass(frozen=True, slots=True)
class PreflightRecord:
    """Record of a passed preflight; `config` is the result of `config_hash`.

    `serials` are the serial numbers by node name; `time` is Unix time in s.
    """

    config: str
    serials: dict[str, int]
    time: float = 0.0
    channel: str = ""
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SlowReason:
    """Reason for a speed limit, and the limited joints."""

    why: str
    joints: tuple[str, ...]


def config_hash(setup: RobotSetup) -> str:
    """Return the SHA-256 of the files and arguments of a robot, in hexadecimal digits."""
    paths = list(setup.files.paths)
    paths += sorted({path for bus in setup.buses.values() for path in bus.eds_paths.values()})
    digest = hashlib.sha256()
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode() + content)
    for name, value in sorted(setup.files.arguments.items()):
        digest.update(f"{name}:={value}\n".encode())
    return digest.hexdigest()


def read_serials(setup: RobotSetup) -> dict[str, int | None]:
    """Read the serial number (0x1018:04) of every node; 0 if the node has none, None without a response.

    Raise BusError if a channel cannot be opened.
    """
    serials: dict[str, int | None] = {}
    for name, bus in setup.buses.items():
        with DirectBus.open(setup.channels[name], label="preflight", timeout_s=_ANSWER_S, join=False) as direct:
            answers = direct.read_many((node.node_id, *_SERIAL) for node in bus.nodes.values())
        for node in bus.nodes.values():
            answer = answers[node.node_id, *_SERIAL]
            serials[node.name] = _serial(answer)
    return serials


def _serial(answer: bytes | CanopenError) -> int | None:
    if isinstance(answer, bytes):
        value = fitted(answer, DataType.UNSIGNED32)
        return None if value is None else int.from_bytes(value, "little")
    return 0 if isinstance(answer, SdoAbort) else None


def _file(setup: RobotSetup) -> Path:
    return state_dir("preflight") / f"{setup.name}.json"


def save_record(setup: RobotSetup, serials: Mapping[str, int], joints: Iterable[str]) -> Path:
    """Save a passed preflight of `joints` in place of an earlier record, and return the file's path.

    Raise ConfigError or DiskFull if it cannot be saved.
    """
    path = _file(setup)
    channels = ", ".join(setup.channels.values())
    passed = PreflightRecord(config_hash(setup), dict(serials), time.time(), channels, tuple(joints))
    try:
        with telling(path, "the pass is not recorded"):
            path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, f"{json.dumps(asdict(passed), indent=2)}\n".encode())
    except ConfigError as error:
        raise ConfigError(f"{error}; the pass is not recorded: set XDG_STATE_HOME to a writable folder") from error
    return path


def find_record(setup: RobotSetup) -> PreflightRecord | None:
    """Return the last preflight record of a robot, or None if there is no readable one."""
    try:
        content = json.loads(_file(setup).read_text())
        serials = {str(name): int(serial) for name, serial in content["serials"].items()}
        joints = tuple(str(joint) for joint in content["joints"])
        return PreflightRecord(str(content["config"]), serials, float(content["time"]), str(content["channel"]), joints)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def explain(setup: RobotSetup, passed: PreflightRecord | None, serials: Mapping[str, int | None]) -> str | None:
    """Return why a record does not permit full speed, or None if it does."""
    if passed is None:
        return "this robot has not passed a preflight on this machine"
    if passed.config != config_hash(setup):
        return "its files have changed since it passed the preflight"
    for name, serial in serials.items():
        if serial is None:
            return f"{name} does not answer, so it may be another drive than in the preflight"
        if passed.serials.get(name) != serial:
            return f"{name} is not the drive that passed the preflight (serial number {serial})"
    return None


def slow_reason(setup: RobotSetup) -> SlowReason | None:
    """Return why full speed is not permitted, and for which joints, or None if it is permitted for all.

    Raise BusError if a channel cannot be opened.
    """
    joints = tuple(part.name for tag in setup.description.hardware for part in tag.joints if _turns(setup, part))
    if not joints:  # such as a robot of I/O modules
        return None
    passed = find_record(setup)
    why = explain(setup, passed, {} if passed is None else read_serials(setup))
    if why is not None or passed is None:
        return SlowReason(why or "", joints)
    missing = tuple(joint for joint in joints if joint not in passed.joints)
    return SlowReason(f"the preflight could not turn {', '.join(missing)}", missing) if missing else None


def _turns(setup: RobotSetup, joint: ControlJoint) -> bool:
    """Whether a joint may have a drive, and is not only measured by another device."""
    plans = {name: plan for bus in setup.buses.values() for name, plan in bus.plans.items()}
    device = device_of(joint, {name: plan.node_id for name, plan in plans.items()})
    return not device or bool(plans[device].axes) or bool(joint.command_interfaces)


def limit_speed(robot: RobotCore, joints: Collection[str], limit: float = SLOW) -> list[str]:
    """Cap the speed of joints for all command interfaces; return the commands that cannot be capped."""
    cap = SpeedCap(robot.registry, joints, limit, robot.manager.limiter)
    geared = (transmission for tag in robot.setup.description.hardware for transmission in tag.transmissions)
    cap.bound(
        [drive for drive in robot.joints.values() if drive.joint in joints],
        {capped.joint: float(capped.reduction) for capped in geared},
    )
    robot.manager.limiter = cap
    return cap.unlimited
