"""Play a trajectory on a joint trajectory controller, cancel the active trajectory, or record a new one.

A file is YAML or JSON in the shape of trajectory_msgs/JointTrajectory: `joint_names`, and `points` with `positions`
and optionally `velocities` and `accelerations`, each with its `time_from_start` in seconds or as `sec` and `nanosec`.
Waypoints are positions of the controller's joints; the arm comes to rest at each. If this program ends before the
trajectory does, by Ctrl-C or otherwise, or is suspended (Ctrl-Z), the joints brake and hold their position. A recording
contains the motion of the joints while another program or a person moves them.

Exit codes: 0 the end was reached; 1 refused, ended early, or nothing to record or to cancel; 2 wrong usage, or no
robot runs.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.cli.support.arguments import add_duration, number, one_name, seconds
from canopen_control.cli.support.commands import find_controller
from canopen_control.cli.support.output import Progress, json_text, print_result
from canopen_control.cli.support.parsers import add_robot_name
from canopen_control.client import RobotClient
from canopen_control.client.robot_client import HEARTBEAT_S
from canopen_control.client.trajectory_file import read_trajectory, read_waypoints, write_trajectory
from canopen_control.data_files import data_names, data_path
from canopen_control.errors import CanopenError, ConfigError
from canopen_control.host.signals import ENDING, on_signals
from canopen_control.rpc.messages.robot import GetStatus, ListControllers, Subscribe
from canopen_control.rpc.messages.samples import TrajectoryPoint
from canopen_control.rpc.messages.state import StateSample
from canopen_control.rpc.messages.trajectory import MAX_POINTS, CancelTrajectory, FollowTrajectory

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from canopen_control.rpc.messages.state import ControllerReading


# Recording of a trajectory from samples of joint positions, in the form that `trajectory play` reads.
#
# The trajectory begins when a joint begins to move, and ends when the last joint has come to rest. Velocities are
# differences of samples, and 0 at both ends, so that a smooth curve through the samples is played.


STILL: Final = 0.002
"""Distance in rad or m below which a joint is considered at rest."""

_APART_S: Final = 0.045
"""Minimum time between samples for a velocity, so that jitter has little effect; shorter than the default period."""


class TrajectoryRecording:
    """Recorded positions of `joints` in rad or m at times in s; the recording is full at `max_points` points."""

    def __init__(self, joints: Sequence[str], max_points: int) -> None:
        self.joints, self._max_points = tuple(joints), max_points
        self._times: list[float] = []
        self._positions: list[list[float]] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def is_full(self) -> bool:
        return len(self) >= self._max_points

    def add(self, time: float, positions: Sequence[float]) -> None:
        """Add the joint positions at a time in s; a time not later than the previous one is ignored."""
        if self._times and time <= self._times[-1]:
            return
        if len(self) == 1 and _is_close(positions, self._positions[0]):
            self._times[0], self._positions[0] = time, list(positions)  # no joint has moved yet
            return
        self._times.append(time)
        self._positions.append(list(positions))

    def points(self) -> list[TrajectoryPoint]:
        """Return the recorded points from the first to the last motion; raise CanopenError if nothing has moved."""
        end = len(self)
        while end > 1 and _is_close(self._positions[end - 2], self._positions[-1]):
            end -= 1
        if end < 2:
            raise CanopenError("no joint moved, so nothing was recorded; move a joint during the recording")
        times, positions = self._times[:end], self._positions[:end]
        return [
            TrajectoryPoint(
                positions=[round(position, 6) for position in positions[index]],
                velocities=_velocities(times, positions, index),
                time_from_start=round(times[index] - times[0], 6),
            )
            for index in range(end)
        ]


def _is_close(first: Sequence[float], second: Sequence[float]) -> bool:
    return all(abs(a - b) < STILL for a, b in zip(first, second, strict=True))


def _velocities(times: Sequence[float], positions: Sequence[Sequence[float]], index: int) -> list[float]:
    """Return the joint velocities at a point, from points at least `_APART_S` before and after; zero at both ends."""
    last = len(times) - 1
    if index in (0, last):
        return [0.0] * len(positions[index])
    before, after = index - 1, index + 1
    while before > 0 and times[index] - times[before] < _APART_S:
        before -= 1
    while after < last and times[after] - times[index] < _APART_S:
        after += 1
    elapsed = times[after] - times[before]
    return [round((b - a) / elapsed, 6) for a, b in zip(positions[before], positions[after], strict=True)]


EXAMPLE = """canopen-control trajectory play wave.yaml
         canopen-control trajectory play --waypoints '0.4 -0.3 0.4 0.6 -0.2 0.7; 0 0 0 0 0 0' --step 1.5
         canopen-control trajectory record -o wave.yaml --for 10
         canopen-control trajectory cancel --controller arm_controller"""

_MARGIN_S: Final = 3600.0  # added to the duration: time may be scaled, and a goal may be waited for without limit
_POLL_S: Final = 0.2  # interval at which a recording checks whether to end

_rate = number("rate in Hz above 0 and up to 200", lambda value: 0.0 < value <= 200.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    play = actions.add_parser("play", help="follow the trajectory of a file, or waypoints, to the end")
    play.add_argument(
        "file",
        nargs="?",
        metavar="FILE",
        help="YAML or JSON in the shape of trajectory_msgs/JointTrajectory; wave.yaml: a sample for arm6",
    )
    play.add_argument(
        "--waypoints",
        metavar="POSITIONS",
        help="positions in rad or m of each joint of the controller, as in '0.4 -0.3; 0 0'",
    )
    play.add_argument(
        "--step", type=seconds, default=2.0, metavar="S", help="time from waypoint to waypoint in s (default: 2)"
    )
    play.add_argument(
        "--approach", type=seconds, metavar="S", help="move from the current position to the first point in S seconds"
    )
    record = actions.add_parser("record", help="record the motion of the joints as a file for play, until Ctrl-C")
    record.add_argument("-o", "--output", required=True, metavar="FILE", help="the YAML file to write")
    record.add_argument(
        "--joints", metavar="NAMES", help="joints to record, as in joint_1,joint_2 (default: joints of the controller)"
    )
    record.add_argument("--rate", type=_rate, default=20.0, metavar="HZ", help="points per second (default: 20)")
    add_duration(record, "end after S seconds", former="--duration", dest="duration")
    cancel = actions.add_parser("cancel", help="cancel the running trajectory: the joints brake")
    for action in (play, record, cancel):
        action.add_argument("--controller", type=one_name, help="controller name (default: the only active one)")
        add_robot_name(action)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.action == "cancel":
        with RobotClient.connect(args.name) as robot:
            controller = _controller(robot, args).name
            robot.ask(CancelTrajectory(controller=controller))
        print_result(args, {"controller": controller, "cancelled": True})
        return 0
    return _record(args) if args.action == "record" else _play(args)


def _play(args: argparse.Namespace) -> int:
    if (args.file is None) is (args.waypoints is None):
        raise ConfigError("give what to play: a file, or --waypoints; as in: canopen-control trajectory play wave.yaml")
    joints, points = read_trajectory(sample_or_file(args.file)) if args.file is not None else ([], [])
    with RobotClient.connect(args.name) as robot:
        controller = _controller(robot, args)
        if args.waypoints is not None:
            joints = list(controller.joints)
            points = read_waypoints(args.waypoints, len(joints), args.step)
        if args.approach is not None:
            points = _later(points, args.approach)
        remaining = robot.send_points(points)
        request = FollowTrajectory(
            controller=controller.name, joints=joints, points=remaining, source="trajectory", heartbeat=HEARTBEAT_S
        )
        timeout = points[-1].time_from_start + _MARGIN_S if points else _MARGIN_S
        with robot.heartbeats():
            result = robot.ask(request, timeout)
    reached = result.state == "succeeded"
    if args.json:
        print(json_text(result))
    else:
        print(result.text, file=sys.stdout if reached else sys.stderr)
    return 0 if reached else 1


def sample_or_file(name: str) -> str:
    """Return `name` if it is an existing file, else the path of the bundled sample of this name."""
    if Path(name).name == name and not Path(name).exists():
        for robot in data_names("config"):
            if (bundled := data_path("config", robot) / name).is_file():
                return str(bundled)
    return name


def _later(points: list[TrajectoryPoint], by: float) -> list[TrajectoryPoint]:
    """Return the points, shifted in time so that the first point is at `by` s."""
    shift = by - points[0].time_from_start if points else 0.0
    return [
        TrajectoryPoint(
            positions=point.positions,
            velocities=point.velocities,
            accelerations=point.accelerations,
            effort=point.effort,
            time_from_start=point.time_from_start + shift,
        )
        for point in points
    ]


def _record(args: argparse.Namespace) -> int:
    """Record the joints until a signal, the end of --for or the maximum number of points; write the file."""
    folder = Path(args.output).absolute().parent
    if not os.access(folder, os.W_OK):  # report this before the joints are moved, not afterwards
        raise ConfigError(f"{args.output}: {folder} is not writable; give another path")
    stopping = threading.Event()
    with RobotClient.connect(args.name) as robot:
        recording = TrajectoryRecording(_joints(robot, args), MAX_POINTS)
        end = math.inf if args.duration is None else time.monotonic() + args.duration

        def is_over() -> bool:
            return stopping.is_set() or recording.is_full or time.monotonic() >= end

        with (
            on_signals(ENDING, stopping.set),
            Progress(f"recording {', '.join(recording.joints)}, Ctrl-C ends it", "points") as progress,
        ):
            robot.ask(Subscribe(state_rate=args.rate))
            while not is_over():
                for message in robot.messages(_POLL_S):
                    if isinstance(message, StateSample):
                        _add(recording, message)
                    progress.at(len(recording))
                    if is_over():
                        break
    points = recording.points()
    write_trajectory(args.output, recording.joints, points)
    full = f"; ended at the maximum of {MAX_POINTS} points of a trajectory" if recording.is_full else ""
    seconds = points[-1].time_from_start
    done = {"file": args.output, "joints": recording.joints, "points": len(points), "seconds": seconds}
    print_result(args, done, f"{args.output}: {len(points)} points in {seconds:.1f} s{full}")
    return 0


def _add(recording: TrajectoryRecording, sample: StateSample) -> None:
    """Add a sample to the recording if the positions of all recorded joints are known."""
    positions_seen = [sample.joints[joint].position for joint in recording.joints if joint in sample.joints]
    positions = [position for position in positions_seen if position is not None]
    if len(positions) == len(recording.joints):
        recording.add(sample.time if sample.sim_time is None else sample.sim_time, positions)


def _joints(robot: RobotClient, args: argparse.Namespace) -> list[str]:
    """Return the joints of --joints, else of the only trajectory controller, else all joints."""
    joints = robot.ask(GetStatus()).joints
    if args.joints is not None:
        names = [field.strip() for field in args.joints.split(",") if field.strip()]
        unknown = [name for name in names if name not in joints]
        if unknown or not names:
            raise ConfigError(f"--joints {args.joints}: name one or more joints of the robot: {', '.join(joints)}")
        return names
    controllers = [controller for controller in robot.ask(ListControllers()) if controller.tells == "trajectory"]
    named = [controller for controller in controllers if args.controller in (None, controller.name)]
    if args.controller is not None and not named:
        raise ConfigError(f"no joint trajectory controller {args.controller!r} is loaded; give --joints")
    return list(named[0].joints) if len(named) == 1 else list(joints)


def _controller(robot: RobotClient, args: argparse.Namespace) -> ControllerReading:
    return find_controller(robot, args.controller, "trajectory", "joint trajectory controller")
