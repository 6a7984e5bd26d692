"""The jog of a pre-flight: each joint turned slowly, all of them stopped, and what was seen held against what was told.

The law of this file: one joint moves at a time, slowly and only after a yes, until all are turned for STOP; a joint
with a velocity is commanded that, one with a position only is led by small steps of it, within its limits; one with
neither is not turned, and said to be so. Every step ends in a sentence with the numbers it was judged by.
"""

from __future__ import annotations

import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from canopen_control.cli.support.preflight_steps import Step
from canopen_control.errors import CanopenError
from canopen_control.hardware.interfaces import POSITION, VELOCITY
from canopen_control.robot import Robot
from canopen_control.runtime.background import BackgroundRobot
from canopen_control.runtime.run_session import RunOptions
from canopen_control.runtime.setup import read_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from canopen_control.runtime.setup import RobotSetup

__all__ = ["Jog", "jog_interfaces"]

TOLERANCE = 0.2  # of the speed that was commanded
STANDSTILL = 0.05  # rad/s
_TIMEOUT_S = 5.0
_STOP_S = 5.0
_LOOK_S = 0.02
_FORWARD = "forward_command_controller/ForwardCommandController"
_CYCLES = 25  # of a jog at speed, so that one cycle more or less does not matter
_RUN_UP_S = 0.3
_SPARE_S = 1.0  # of a jog, until it is at its speed and to stop again


def jog_interfaces(setup: RobotSetup) -> dict[str, str | None]:
    """Return what each joint is turned by, in the order of the description: velocity, position, or None: not at all."""
    parts = (part for tag in setup.description.hardware for part in tag.joints)
    return {
        part.name: next((each for each in (VELOCITY, POSITION) if each in part.command_interfaces), None)
        for part in parts
    }


class Jog:
    """The robot with a controller for each interface of its `joints`; `with` boots and stops it, enabled.

    `turned` are the joints that turned as they should.
    """

    def __init__(self, setup: RobotSetup, speed: float) -> None:
        self._interfaces = {joint: name for joint, name in jog_interfaces(setup).items() if name is not None}
        self.joints, self.speed = list(self._interfaces), speed
        self.turned: list[str] = []
        self._folder = tempfile.TemporaryDirectory(prefix="preflight-")
        path = Path(self._folder.name) / "ros2_controllers.yaml"
        groups = self._groups()
        path.write_text(_controllers(groups, setup.controllers.update_rate))
        files = replace(setup.files, controllers=path)
        channels = [f"{name}={channel}" for name, channel in setup.channels.items()]
        names = [_controller(name) for name in groups]
        self._setup = read_robot(files, name=setup.name, can=channels, controllers=names, real=True)
        self._robot = Robot(setup.name, BackgroundRobot(self._setup, RunOptions(drives=False)))
        self._hold_s = max(1.0, _CYCLES * self._setup.cycle_ns / 1e9)
        self._look_s = max(_LOOK_S, self._setup.cycle_ns / 1e9)
        self._targets: dict[str, float] = {}  # of the joints that are led by their position
        self._commanded = 0.0  # when, by the monotonic clock

    def __enter__(self) -> Jog:
        try:
            self._robot.start()
            self._targets = {joint: self._of(joint)["position"] for joint in self._groups().get(POSITION, [])}
        except BaseException:
            self._robot.shutdown()
            self._folder.cleanup()
            raise
        return self

    def __exit__(self, *_error: object) -> None:
        self._robot.shutdown()
        self._folder.cleanup()

    def no_room(self, joint: str) -> str | None:
        """Say why there is no way for a jog of this joint, None if there is."""
        if self._interfaces[joint] != POSITION:
            return None
        here, needed = self._of(joint)["position"], self.speed * (self._hold_s + _SPARE_S)
        room = self._setup.description.joints[joint].limits.upper - here
        if room >= needed:
            return None
        return f"it is at {here:.3f}, {room:.3f} before its limit, and a jog at {self.speed:g} rad/s needs {needed:.3f}"

    def turn(self, joint: str) -> Step:
        """Turn one joint at the speed, and compare what it shows of velocity and of position."""
        low, high = self.speed * (1 - TOLERANCE), self.speed * (1 + TOLERANCE)
        speeds, start = {joint: self.speed}, self._positions()
        if not self._until(speeds, lambda: self._is_fast(joint, start)):
            seen = self._of(joint)["velocity"]
            self._rest()
            return Step("jog", False, f"{joint}: {seen:.3f} rad/s at a command of {self.speed:g}{_hint(seen)}")
        begin, since = self._positions(), time.monotonic()
        self._until(speeds, lambda: time.monotonic() - since >= self._hold_s)
        end, took = self._positions(), time.monotonic() - since
        self._rest()
        ways = {each: end[each] - begin[each] for each in self.joints}
        others = [each for each in self.joints if each != joint and abs(ways[each]) > TOLERANCE * self.speed]
        text = f"{joint}: {ways[joint]:.3f} rad in {took:.2f} s at a command of {self.speed:g} rad/s"
        text += _hint(ways[joint])
        if others:
            text += f"; {', '.join(others)} turned as well"
        passed = low <= ways[joint] / took <= high and not others
        self.turned += [joint] if passed else []
        return Step("jog", passed, text)

    def stop(self) -> Step:
        """Turn all joints that turned, press STOP, and see how long it takes until nothing moves under power.

        Those that are led by their position go back where they came from.
        """
        speeds = {joint: self.speed * (-1 if joint in self._targets else 1) for joint in self.turned}
        start = self._positions()
        if not self._until(speeds, lambda: all(self._is_fast(joint, start) for joint in speeds)):
            return Step("STOP", False, "the joints do not turn, so that nothing can be stopped")
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

    def _is_fast(self, joint: str, start: Mapping[str, float]) -> bool:
        """Whether a joint has the speed of the jog; one that is led by its position, whether it is well under way."""
        seen = self._of(joint)
        if joint in self._targets:
            return abs(seen["position"] - start[joint]) >= self.speed * _RUN_UP_S
        return abs(seen["velocity"] - self.speed) <= self.speed * TOLERANCE

    def _groups(self) -> dict[str, list[str]]:
        """Return the joints by what they are turned by."""
        groups: dict[str, list[str]] = {}
        for joint, interface in self._interfaces.items():
            groups.setdefault(interface, []).append(joint)
        return groups

    def _of(self, joint: str) -> dict[str, float]:
        seen = self._robot.joints()[joint]
        known = {"position": seen.position, "velocity": seen.velocity}
        return {key: math.nan if value is None else value for key, value in known.items()}

    def _positions(self) -> dict[str, float]:
        return {joint: self._of(joint)["position"] for joint in self.joints}

    def _until(self, speeds: Mapping[str, float], condition: Callable[[], bool]) -> bool:
        """Command these joints, and no other, until `condition` or until the time is over."""
        deadline = time.monotonic() + _TIMEOUT_S + self._hold_s
        self._commanded = time.monotonic()
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._command(speeds)
            time.sleep(self._look_s)
        return True

    def _command(self, speeds: Mapping[str, float]) -> None:
        now = time.monotonic()
        passed, self._commanded = now - self._commanded, now
        for joint in self._targets:
            self._targets[joint] += speeds.get(joint, 0.0) * passed
        for interface, joints in self._groups().items():
            values = [self._targets.get(joint, speeds.get(joint, 0.0)) for joint in joints]
            self._robot.command(_controller(interface), values)

    def _rest(self) -> None:
        self._until({}, lambda: max(abs(self._of(joint)["velocity"]) for joint in self.joints) <= STANDSTILL)


def _hint(seen: float) -> str:
    if math.isnan(seen):
        return "; it shows no velocity: is 0x606C mapped?"
    return "; it turns the other way: look at the sign of its scale" if seen < -STANDSTILL else ""


def _controller(interface: str) -> str:
    return f"preflight_{interface}"


def _controllers(groups: Mapping[str, list[str]], rate: int) -> str:
    """Return a ros2_controllers.yaml with one forward controller for each group."""
    head = (
        f"controller_manager:\n  ros__parameters:\n    update_rate: {rate}\n"
        "    joint_state_broadcaster:\n      type: joint_state_broadcaster/JointStateBroadcaster\n"
    )
    types = [f"    {_controller(name)}:\n      type: {_FORWARD}\n" for name in groups]
    own = [
        f"{_controller(name)}:\n  ros__parameters:\n    joints: [{', '.join(joints)}]\n"
        f"    interface_name: {name}\n    command_timeout: 0.5\n"
        for name, joints in groups.items()
    ]
    return head + "".join(types + own)
