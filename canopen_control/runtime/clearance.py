"""Clearance of a robot for full speed on real drives: what a passed pre-flight leaves, and what a run makes of it.

The law of this file: a pass is for one configuration (the bytes of all its files and of the EDS files they name, and
xacro's arguments) on these very drives (their serial numbers, 0x1018:04), and covers the joints that were turned. Any
other file, argument, drive or missing answer is no pass; then a real run is slow (`speed_cap`) and says why. A joint
that was not turned stays slow.
"""

from __future__ import annotations

import hashlib
import json
import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from canopen_control.errors import CanopenError, SdoAbort
from canopen_control.hardware.device_parts import device_of
from canopen_control.host.files import state_dir, write_whole
from canopen_control.master.direct import DirectBus
from canopen_control.od.codec import fitted
from canopen_control.od.model import DataType
from canopen_control.runtime.speed_cap import SpeedCap

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping
    from pathlib import Path

    from canopen_control.runtime.core import RobotCore
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.urdf.ros2_control import ControlJoint

__all__ = [
    "SLOW",
    "Clearance",
    "SlowReason",
    "config_hash",
    "doubt",
    "explain",
    "find_pass",
    "keep_pass",
    "limit_speed",
    "read_serials",
]

SLOW = 1.0  # rad/s, or m/s of a prismatic joint, without a pass
_SERIAL = (0x1018, 4)
_ANSWER_S = 0.5


@dataclass(frozen=True, slots=True)
class Clearance:
    """A pass: `config` is the hash of the files, `serials` by node name, `time` in Unix seconds, `joints` it covers."""

    config: str
    serials: dict[str, int]
    time: float = 0.0
    channel: str = ""
    joints: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SlowReason:
    """Why a robot has to be slow, and which of its joints."""

    why: str
    joints: tuple[str, ...]


def config_hash(setup: RobotSetup) -> str:
    """Return the hash of everything a robot is described by, in hexadecimal digits."""
    paths = [*setup.files.buses.values(), setup.files.controllers, setup.files.description]
    paths += sorted({path for bus in setup.buses.values() for path in bus.eds_paths.values()})
    digest = hashlib.sha256()
    for path in paths:
        content = path.read_bytes()
        digest.update(f"{path.name} {len(content)}\n".encode() + content)
    for name, value in sorted(setup.files.arguments.items()):
        digest.update(f"{name}:={value}\n".encode())
    return digest.hexdigest()


def read_serials(setup: RobotSetup) -> dict[str, int | None]:
    """Ask every node for its serial number, straight on the bus: 0 if it says it has none, None if it says nothing.

    Raises BusError where a channel cannot be opened.
    """
    found: dict[str, int | None] = {}
    for name, bus in setup.buses.items():
        with DirectBus.open(setup.channels[name], label="clearance", timeout_s=_ANSWER_S, join=False) as direct:
            answers = direct.read_many((node.node_id, *_SERIAL) for node in bus.nodes.values())
        for node in bus.nodes.values():
            answer = answers[node.node_id, *_SERIAL]
            found[node.name] = _serial(answer)
    return found


def _serial(answer: bytes | CanopenError) -> int | None:
    if isinstance(answer, bytes):
        whole = fitted(answer, DataType.UNSIGNED32)
        return None if whole is None else int.from_bytes(whole, "little")
    return 0 if isinstance(answer, SdoAbort) else None


def _file(setup: RobotSetup) -> Path:
    return state_dir("preflight") / f"{setup.name}.json"


def keep_pass(setup: RobotSetup, serials: Mapping[str, int], joints: Iterable[str]) -> Path:
    """Write down that the robot has passed with these joints, instead of any earlier pass of this name.

    Return the file.
    """
    path = _file(setup)
    path.parent.mkdir(parents=True, exist_ok=True)
    channels = ", ".join(setup.channels.values())
    passed = Clearance(config_hash(setup), dict(serials), time.time(), channels, tuple(joints))
    write_whole(path, f"{json.dumps(asdict(passed), indent=2)}\n".encode())
    return path


def find_pass(setup: RobotSetup) -> Clearance | None:
    """Return the last pass of a robot of this name; None if there is none, or none that can be read."""
    try:
        held = json.loads(_file(setup).read_text())
        serials = {str(name): int(serial) for name, serial in held["serials"].items()}
        joints = tuple(str(joint) for joint in held["joints"])
        return Clearance(str(held["config"]), serials, float(held["time"]), str(held["channel"]), joints)
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def explain(setup: RobotSetup, passed: Clearance | None, serials: Mapping[str, int | None]) -> str | None:
    """Say in words why a pass does not clear the robot as it is; None: it does."""
    if passed is None:
        return "this robot has not passed a pre-flight on this machine"
    if passed.config != config_hash(setup):
        return "its files have changed since it passed the pre-flight"
    for name, serial in serials.items():
        if serial is None:
            return f"{name} does not answer, so that nobody knows whether it is the drive that passed"
        if passed.serials.get(name) != serial:
            return f"{name} is another drive than the one that passed the pre-flight (serial number {serial})"
    return None


def doubt(setup: RobotSetup) -> SlowReason | None:
    """Look for a pass and ask the drives for their serial numbers; return what speaks against full speed, if anything.

    Raises BusError where a channel cannot be opened.
    """
    joints = tuple(part.name for tag in setup.description.hardware for part in tag.joints if _turns(setup, part))
    passed = find_pass(setup)
    why = explain(setup, passed, {} if passed is None else read_serials(setup))
    if why is not None or passed is None:
        return SlowReason(why or "", joints)
    left = tuple(joint for joint in joints if joint not in passed.joints)
    return SlowReason(f"the pre-flight could not turn {', '.join(left)}", left) if left else None


def _turns(setup: RobotSetup, joint: ControlJoint) -> bool:
    """Whether a joint may have a drive: one that another device measures cannot be turned."""
    plans = {name: plan for bus in setup.buses.values() for name, plan in bus.plans.items()}
    device = device_of(joint, {name: plan.node_id for name, plan in plans.items()})
    return not device or bool(plans[device].axes) or bool(joint.command_interfaces)


def limit_speed(robot: RobotCore, joints: Collection[str], limit: float = SLOW) -> list[str]:
    """Cap the speed of joints, by whatever they are commanded; return the commands that cannot be capped."""
    cap = SpeedCap(robot.registry, joints, limit, robot.manager.limiter)
    geared = (each for tag in robot.setup.description.hardware for each in tag.transmissions)
    cap.bound(
        [drive for drive in robot.joints.values() if drive.joint in joints],
        {each.joint: float(each.reduction) for each in geared},
    )
    robot.manager.limiter = cap
    return cap.unlimited
