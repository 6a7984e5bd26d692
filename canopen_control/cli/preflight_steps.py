"""The steps of a pre-flight: what is looked at, and what a slow jog and a STOP show.

The law of this file: nothing is written to a drive before the jog, the jog moves one joint at a time, slowly and only
after a yes, and every step ends in a sentence with the numbers it was judged by.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from canopen_control.bus.channel import ChannelKind, parse_channel
from canopen_control.bus.link import find_link
from canopen_control.cli.identity import FIELDS, NAME, differences, identity_of, match_eds, read_known
from canopen_control.errors import CanopenError, SdoAbort, SdoTimeout
from canopen_control.hardware.interfaces import VELOCITY
from canopen_control.master.direct import DirectBus
from canopen_control.runtime.robot import Robot
from canopen_control.runtime.session import RunOptions
from canopen_control.runtime.setup import read_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from canopen_control.master.config import BusConfig
    from canopen_control.od.model import ObjectDictionary
    from canopen_control.runtime.setup import RobotSetup

__all__ = ["Jog", "Step", "link_steps", "node_steps", "velocity_joints"]

TOLERANCE = 0.2  # of the speed that was commanded
STANDSTILL = 0.05  # rad/s
_ALL_NODES = range(1, 128)
_ANSWER_S = 0.2
_PATIENCE_S = 5.0
_STOP_S = 5.0
_LOOK_S = 0.02
_CYCLES = 25  # of a jog at speed, so that one cycle more or less does not matter
_CONTROLLER = "preflight"
_STATE: dict[tuple[int, int], str] = {
    (0x607D, 1): "lower position limit",
    (0x607D, 2): "upper position limit",
    (0x607F, 0): "greatest profile velocity",
    (0x6080, 0): "greatest motor speed",
    (0x6079, 0): "supply voltage",
}
_ERRORS: dict[tuple[int, int], str] = {(0x1001, 0): "error register", (0x603F, 0): "error code"}


@dataclass(frozen=True, slots=True)
class Step:
    """What a step came to; `passed` is None for what is only told."""

    name: str
    passed: bool | None
    text: str


# -- the link


def link_steps(channel: str, baudrate: int) -> list[Step]:
    """Compare state and bit rate of a channel to the bus.yml's (`baudrate`, kbit/s)."""
    spec = parse_channel(channel)
    if spec.kind is not ChannelKind.SOCKETCAN:
        return [Step("link", None, f"{channel}: no interface of the kernel, its bit rate cannot be looked at")]
    link = find_link(spec.name)
    if link is None or not link.is_up:
        what = "is not there" if link is None else "is down"
        typed = f"canopen-control bus up {spec.name} --bitrate {baudrate * 1000}"
        return [Step("link", False, f"{channel} {what}; type: {typed}")]
    steps = [Step("link", link.state in (None, "ERROR-ACTIVE"), f"{channel} is up{_state_of(link.state)}")]
    if link.bitrate is None:
        return [*steps, Step("bit rate", None, f"{channel} is a {link.kind} interface and has none")]
    fits = link.bitrate == baudrate * 1000
    return [*steps, Step("bit rate", fits, f"{link.bitrate} bit/s, bus.yml says {baudrate * 1000}")]


def _state_of(state: str | None) -> str:
    return f" and {state}" if state else ""


# -- who is there


def node_steps(bus: BusConfig, channel: str) -> Iterator[Step]:
    """Ask all node ids who they are, compare to bus.yml and EDS files; read errors and limits of the robot's own."""
    with DirectBus.open(channel, label="pre-flight", timeout_s=_ANSWER_S, retries=1) as direct:
        answers = direct.read_many((node_id, 0x1000, 0) for node_id in _ALL_NODES)
        there = {node_id for (node_id, _, _), answer in answers.items() if not isinstance(answer, SdoTimeout)}
        for node in bus.nodes.values():
            if node.node_id in there:
                yield from _known_node(direct, bus, node.name, node.node_id)
            else:
                text = (
                    f"node {node.node_id} ({node.name}) does not answer; is it powered, its node id and bit rate set?"
                )
                yield Step("node", False, text)
        for node_id in sorted(there - {node.node_id for node in bus.nodes.values()}):
            yield Step("node", None, f"node {node_id} answers and is not in bus.yml")


def _known_node(direct: DirectBus, bus: BusConfig, name: str, node_id: int) -> Iterator[Step]:
    addresses = [*(address for address, _ in FIELDS.values()), NAME]
    answers = direct.read_many((node_id, *address) for address in addresses)
    identity = identity_of({(index, sub): answer for (_, index, sub), answer in answers.items()})
    title = f"node {node_id} ({name})"
    wrong = differences(identity, asdict(bus.plans[name].identity))
    who = f"{identity.device_name or 'a node without a name'}, serial number {identity.serial_number or 'none'}"
    yield Step("node", not wrong, f"{title}: {'; '.join(wrong) or who}")
    known, refused = read_known([bus.eds_paths[name]])
    eds, remark = match_eds(identity, known)
    if refused or not known:
        yield Step(
            "EDS", None, f"{title}: {bus.eds_paths[name].name} names no product, so that nothing can be compared"
        )
    elif eds is None:
        yield Step("EDS", False, f"{title}: {bus.eds_paths[name].name} is for another product")
    else:
        yield Step(
            "EDS", None if remark else True, f"{title}: {eds.path.name}{_remark(remark, identity.revision_number)}"
        )
    yield from _readings(direct, bus.dictionaries[name], node_id, title)


def _remark(remark: str, revision: int | None) -> str:
    return f" {remark}, the drive has 0x{revision or 0:08X}" if remark else " and revision fit"


def _readings(direct: DirectBus, od: ObjectDictionary, node_id: int, title: str) -> Iterator[Step]:
    """Read what tells of errors, which must be none, and of limits, which are only told."""
    wanted = [address for address in (*_ERRORS, *_STATE) if address in od]
    values: dict[tuple[int, int], int] = {}
    for address in wanted:
        try:
            data = direct.read(node_id, *address)
        except SdoAbort:
            continue
        values[address] = int.from_bytes(data, "little", signed=od[address].data_type.signed)
    errors = {_ERRORS[address]: value for address, value in values.items() if address in _ERRORS}
    told = ", ".join(f"{name} 0x{value:02X}" for name, value in errors.items())
    yield Step("errors", not any(errors.values()), f"{title}: {told or 'tells of none'}")
    limits = ", ".join(f"{_STATE[address]} {value}" for address, value in values.items() if address in _STATE)
    if limits:
        yield Step("limits", None, f"{title}: {limits} (device units)")


# -- the jog


def velocity_joints(setup: RobotSetup) -> list[str]:
    """Return the joints that can be commanded a velocity, in the order of the description."""
    parts = (part for tag in setup.description.hardware for part in tag.joints)
    return [part.name for part in parts if VELOCITY in part.command_interfaces]


class Jog:
    """The robot with one controller over all its velocity joints; `with` boots and stops it, enabled."""

    def __init__(self, setup: RobotSetup, speed: float) -> None:
        self.joints, self.speed = velocity_joints(setup), speed
        self._folder = tempfile.TemporaryDirectory(prefix="preflight-")
        path = Path(self._folder.name) / "ros2_controllers.yaml"
        path.write_text(_controllers(self.joints, setup.controllers.update_rate))
        files = replace(setup.files, controllers=path)
        channels = [f"{name}={channel}" for name, channel in setup.channels.items()]
        self._setup = read_robot(files, name=setup.name, can=channels, real=True)
        self._robot = Robot(self._setup, RunOptions(drives=False))
        self._hold_s = max(1.0, _CYCLES * self._setup.cycle_ns / 1e9)
        self._look_s = max(_LOOK_S, self._setup.cycle_ns / 1e9)

    def __enter__(self) -> Jog:
        try:
            self._robot.start()
        except BaseException:
            self._folder.cleanup()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self._robot.shutdown()
        self._folder.cleanup()

    def turn(self, joint: str) -> Step:
        """Turn one joint at the speed, and compare what it shows of velocity and of position."""
        low, high = self.speed * (1 - TOLERANCE), self.speed * (1 + TOLERANCE)
        if not self._until(joint, lambda: low <= self._of(joint)["velocity"] <= high):
            seen = self._of(joint)["velocity"]
            self._rest()
            return Step("jog", False, f"{joint}: {seen:.3f} rad/s at a command of {self.speed:g}{_hint(seen)}")
        begin, since = self._positions(), time.monotonic()
        self._until(joint, lambda: time.monotonic() - since >= self._hold_s)
        end, took = self._positions(), time.monotonic() - since
        self._rest()
        ways = {each: end[each] - begin[each] for each in self.joints}
        others = [each for each in self.joints if each != joint and abs(ways[each]) > TOLERANCE * self.speed]
        text = f"{joint}: {ways[joint]:.3f} rad in {took:.2f} s at a command of {self.speed:g} rad/s"
        if others:
            text += f"; {', '.join(others)} turned as well"
        return Step("jog", low <= ways[joint] / took <= high and not others, text)

    def stop(self) -> Step:
        """Turn all joints, press STOP, and see how long it takes until nothing turns under power."""
        everybody = [self.speed] * len(self.joints)
        deadline = time.monotonic() + _PATIENCE_S + self._hold_s
        while min(self._of(joint)["velocity"] for joint in self.joints) < self.speed * (1 - TOLERANCE):
            if time.monotonic() > deadline:
                return Step("STOP", False, "the joints do not turn, so that nothing can be stopped")
            self._robot.command(_CONTROLLER, everybody)
            time.sleep(self._look_s)
        since = time.monotonic()
        try:
            self._robot.stop()
        except CanopenError as error:
            return Step("STOP", False, str(error))
        took = time.monotonic() - since
        left = {joint: self._of(joint)["velocity"] for joint in self.joints}
        still = all(abs(velocity) <= STANDSTILL for velocity in left.values())
        told = ", ".join(f"{joint} {velocity:.3f} rad/s" for joint, velocity in left.items())
        return Step("STOP", still and took <= _STOP_S, f"drives disabled {took:.2f} s after STOP: {told}")

    def _of(self, joint: str) -> dict[str, float]:
        seen: Mapping[str, Any] = self._robot.status()["joints"][joint]
        return {key: math.nan if seen[key] is None else float(seen[key]) for key in ("position", "velocity")}

    def _positions(self) -> dict[str, float]:
        return {joint: self._of(joint)["position"] for joint in self.joints}

    def _until(self, joint: str, condition: Callable[[], bool]) -> bool:
        """Command one joint, and no other, until `condition` or until patience ends."""
        values = [self.speed if each == joint else 0.0 for each in self.joints]
        deadline = time.monotonic() + _PATIENCE_S + self._hold_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._robot.command(_CONTROLLER, values)
            time.sleep(self._look_s)
        return True

    def _rest(self) -> None:
        deadline = time.monotonic() + _PATIENCE_S
        while max(abs(self._of(joint)["velocity"]) for joint in self.joints) > STANDSTILL:
            if time.monotonic() > deadline:
                break
            self._robot.command(_CONTROLLER, [0.0] * len(self.joints))
            time.sleep(self._look_s)


def _hint(seen: float) -> str:
    if math.isnan(seen):
        return "; it shows no velocity: is 0x606C mapped?"
    return "; it turns the other way: look at the sign of its scale" if seen < -STANDSTILL else ""


def _controllers(joints: list[str], rate: int) -> str:
    return (
        f"controller_manager:\n  ros__parameters:\n    update_rate: {rate}\n"
        "    joint_state_broadcaster:\n      type: joint_state_broadcaster/JointStateBroadcaster\n"
        f"    {_CONTROLLER}:\n      type: forward_command_controller/ForwardCommandController\n"
        f"{_CONTROLLER}:\n  ros__parameters:\n    joints: [{', '.join(joints)}]\n"
        "    interface_name: velocity\n    command_timeout: 0.5\n"
    )
