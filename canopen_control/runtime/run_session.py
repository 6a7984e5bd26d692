"""Run of a robot in this process from start to end: core, API, child processes and signals.

`close` always ends all child processes and removes sockets and locks. At the end, the drives are ramped down and
disabled, then the client processes are ended, then the virtual drives.
"""

from __future__ import annotations

import contextlib
import gc
import math
import os
import signal
import sys
import traceback
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from canopen_control.controllers.base import twist_axes_of
from canopen_control.errors import CanopenError, ControlError, RobotConfigError
from canopen_control.host.files import state_dir
from canopen_control.host.lifeline import lifeline_fd
from canopen_control.host.reactor import Reactor
from canopen_control.host.sockets import (
    SocketInUse,
    claim,
    connect,
    drive_name,
    find_robots,
    peer_pid,
    runtime_dir,
    socket_path,
)
from canopen_control.master.event_log import Event, Level
from canopen_control.runtime.api import ApiServer
from canopen_control.runtime.core import RobotCore, RobotState
from canopen_control.runtime.ground_truth import PERIOD_NS, TruePoseQuery, odometry_at
from canopen_control.runtime.observer import RobotObserver
from canopen_control.runtime.physics_plant import SensedValues, world_sensors, write_plant
from canopen_control.runtime.prepared_bridge import BRIDGE, bridge_command
from canopen_control.runtime.realtime import RealTime, keep_garbage_small
from canopen_control.runtime.stop_latch import RELEASE
from canopen_control.runtime.supervisor import Restarts, Supervisor, hosts_virtual_drives
from canopen_control.urdf.joint_element import POSITION, VELOCITY

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.host.spawn import Child
    from canopen_control.host.timer import Timer
    from canopen_control.rpc.messages.drive import BasePose
    from canopen_control.runtime.setup import RobotSetup


# Demo motion: velocities, positions or a curve, until a client commands the robot.
#
# The first command of a client ends the demo motion permanently. Velocities change in steps, positions swing slowly
# about the initial positions, a base drives a curve; efforts are not commanded, since their result is unpredictable.


SOURCE = "demo"
_STEP_NS = 100_000_000
_STEPS_EACH = 30  # number of steps of each phase: three seconds
_PHASES = (0, 1, -1)
_SPEED = 10.0  # rad/s (m/s)
_TWIST = {"linear.x": 0.2, "linear.y": 0.1, "angular.z": 0.5}  # m/s, rad/s
_SWING = 0.25  # rad (m), each way
_SWING_STEPS = 80  # eight seconds per cycle: 0.2 rad/s at most


class DemoMotion:
    """Demo motion: velocities, twists or positions that a controller executes in alternating directions."""

    def __init__(self, robot: RobotCore, controller: str) -> None:
        self._robot, self._controller = robot, controller
        self._step = 0
        self._middle: list[float] | None = None
        self._timer: Timer | None = robot.reactor.call_later(_STEP_NS, self._play)

    def _play(self) -> None:
        robot = self._robot
        if robot.commander not in (None, SOURCE):
            robot.report(
                Event(robot.reactor.now(), "demo", "", f"{robot.commander} commands the robot; the demo motion ends")
            )
            return
        if robot.state in (RobotState.STOPPING, RobotState.STOPPED):
            return
        self._timer = robot.reactor.call_later(_STEP_NS, self._play)
        if robot.state is RobotState.RUNNING:
            self._command()

    def _command(self) -> None:
        try:
            values = self._values()
            if values:
                self._robot.command(self._controller, values, SOURCE)
        except ControlError:
            return  # for example, the controller is not active
        self._step += 1

    def _values(self) -> list[float]:
        """Return the command values of the current step; [] for a controller that the demo cannot use."""
        controller = self._robot.manager.get(self._controller)
        if controller.topic is None:  # the controller accepts goals
            return []
        if axes := twist_axes_of(controller):
            return [_TWIST[axis] * _PHASES[self._step // _STEPS_EACH % len(_PHASES)] for axis in axes]
        names = controller.command_interface_names()
        kinds = {name.rpartition("/")[2] for name in names}
        if kinds == {VELOCITY}:
            return [_SPEED * _PHASES[self._step // _STEPS_EACH % len(_PHASES)]] * len(names)
        if kinds != {POSITION}:
            return []
        if self._middle is None:
            self._middle = [self._robot.registry.state(name).value for name in names]
        swing = _SWING * math.sin(math.tau * self._step / _SWING_STEPS)
        return [middle + swing for middle in self._middle]


# Unexpected exceptions while a robot runs: each is reported as an event, and the robot continues, unless its cycle
# raises one a few times in a row (`runtime.core`).
#
# The event has the place in the code, and is reported once for each place. If CANOPEN_CONTROL_DEBUG is set, the
# traceback is printed.


_MAX_PLACES = 20


class ProgramErrors:
    """Handler that reports unexpected exceptions in the reactor as events, once for each place in the code."""

    def __init__(self, now: Callable[[], int], report: Callable[[Event], None]) -> None:
        self._now, self._report = now, report
        self._reported: set[str] = set()

    def __call__(self, error: BaseException) -> None:
        """Report an exception, unless one from the same place in the code has already been reported."""
        if os.environ.get("CANOPEN_CONTROL_DEBUG"):
            traceback.print_exception(error, file=sys.stderr)
        place = _place_of(error)
        if place in self._reported or len(self._reported) >= _MAX_PLACES:
            return
        self._reported.add(place)
        text = (
            f"an error in this program at {place}: {type(error).__name__}: {error}; the robot "
            "continues unless every cycle raises one; please report the error"
        )
        self._report(Event(self._now(), "program_error", "", text, Level.ERROR))


def _place_of(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    if not frames:
        return "an unknown place"
    last = frames[-1]
    return f"{last.filename.rpartition('canopen_control/')[2]}:{last.lineno}"


_BOOT_FIRST_NS = 1_000_000_000  # after a usual boot, which another process start would delay by 50 ms
_HEARING_NS, _HEARING_TRIES = 5_000_000, 400  # waiting for boot-up messages
_ENDING_S = 10.0  # for a run whose socket is closed, while its child processes end
_PROBE_S = 0.5
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a robot's run; `duration` is in s, None without a limit.

    `drives` starts virtual drives where the channel allows that; `like` is their personality. With `physics` they move
    the robot in a physics simulation, in the world file `world` if given; else `plant` is their plant file, if any.
    `ros` starts the ROS bridge with `ros_arguments`, `bridge` is its process if already started. `view` serves the web
    page, `teleop` allows that page to drive the robot. `recorder` starts the flight recorder. `realtime` is a priority
    of SCHED_FIFO, `cpu` the processor to which the robot's thread is bound.
    """

    drives: bool = True
    like: str = ""
    physics: bool = False
    world: Path | None = None
    ros: bool = False
    ros_arguments: tuple[str, ...] = ()
    view: bool = False
    teleop: bool = False
    table: bool = False
    motion: bool = False
    duration: float | None = None
    recorder: bool = False
    realtime: int | None = None
    cpu: int | None = None
    plant: Path | None = None
    bridge: Child | None = None


class RunSession(RobotObserver):
    """Run of a robot; `run` blocks until the robot has stopped."""

    def __init__(self, setup: RobotSetup, options: RunOptions, *, reactor: Reactor | None = None) -> None:
        self.setup, self.options = setup, options
        self.reactor = reactor or Reactor()
        self._timer: Timer | None = None
        self._cleanup = contextlib.ExitStack()
        try:
            self._open()
        except BaseException:
            self.close()
            raise

    def _open(self) -> None:
        cleanup, setup = self._cleanup, self.setup
        cleanup.callback(self.reactor.close)
        self.realtime = RealTime(self.options.realtime, self.options.cpu)
        cleanup.callback(self.realtime.close)
        self.robot = RobotCore(setup, self.reactor)
        self.robot.latch.keep(state_dir(setup.name) / "stop_latched")
        self.reactor.on_error = ProgramErrors(self.reactor.now, self.robot.report)
        claims = cleanup.enter_context(contextlib.ExitStack())
        self.supervisor = Supervisor(setup.name, self.reactor, self.robot.report, self.realtime, self.robot.nodes)
        self.robot.missing_programs = self.supervisor.missing
        cleanup.callback(self.supervisor.end)
        try:
            self.api = ApiServer(self.robot)
        except SocketInUse as error:
            owner = f" (process {error.pid})" if error.pid else ""
            raise RobotConfigError(
                f"a robot named {setup.name} runs already{owner}; stop that one (canopen-control shutdown --name "
                f"{setup.name}), or choose another name with --as"
            ) from error
        cleanup.callback(self.api.close)
        cleanup.callback(self.robot.close)
        # after the check of the name: a second run of the robot under another name has another channel by default
        for channel in setup.channels.values() if self.robot.buses else ():
            claims.callback(os.close, _claim(channel))
        drives = [drive_name(self.robot.bus_of(node).channel, node.node_id) for node in self.robot.nodes.values()]
        sensed = SensedValues(self.robot.sensed, world_sensors(setup))
        self._true_pose = TruePoseQuery(
            drives,
            self.reactor,
            self._take_true_pose,
            sensed.take if sensed.needed else None,
            setup.cycle_ns if sensed.needed else PERIOD_NS,
        )
        cleanup.callback(self._true_pose.close)
        self.robot.observers.append(self)

    def start(self) -> None:
        """Start the child processes, then the robot once they are ready; raise CanopenError on failure."""
        if self.realtime.text:
            self.robot.report(Event(self.reactor.now(), "realtime", "", self.realtime.text))
        self.robot.latch.report(self.reactor.now())
        keep_garbage_small(self._cleanup, self.robot.observers, by_hand=self.options.realtime is not None)
        if self.options.drives and self.robot.buses and hosts_virtual_drives(self.setup):
            plant = write_plant(self.setup, self.robot.joints, self.options.world) if self.options.physics else None
            self.supervisor.start_drives(self.setup, plant or self.options.plant, like=self.options.like)
        if self.options.recorder:
            channels = {name: bus.channel for name, bus in self.robot.buses.items()}
            self.supervisor.start_recorder(channels, Restarts())
        if self.options.ros:
            bridge = bridge_command(self.setup.name, self.options.ros_arguments)
            self.supervisor.start_client(
                BRIDGE, bridge, ros=True, answers=True, restarts=Restarts(), prepared=self.options.bridge
            )
        self.robot.join()
        self.supervisor.when_ready(self)

    def child_failed(self, text: str) -> None:
        self.robot.fail(text)

    def children_ready(self, tries: int = _HEARING_TRIES) -> None:
        """Boot the nodes once all virtual drives have sent their boot-up messages, or after `tries` checks."""
        if self.robot.has_heard(self.supervisor.driven) or not tries:
            self._begin()
        else:
            self.reactor.call_later(_HEARING_NS, lambda: self.children_ready(tries - 1))

    def _begin(self) -> None:
        """Start the robot, bind the thread to its processor, and schedule the start of the web page."""
        try:
            self.robot.start()
        except CanopenError as error:
            self.robot.fail(str(error))
            return
        self.realtime.pin()
        if self.options.view:
            self.reactor.call_later(_BOOT_FIRST_NS, self._start_view)

    def _start_view(self) -> None:
        options = ["--teleop"] if self.options.teleop else []
        view = ["canopen_control", "view", "--name", self.setup.name, *options]
        self.supervisor.start_client("view", view, restarts=Restarts())

    def run(self) -> str | None:
        """Run the robot until it has stopped; return the error text of a failed run, else None."""
        shutdown = self.robot.shutdown
        self.reactor.handle_signals({number: partial(shutdown, number.name) for number in _SIGNALS})
        lifeline = lifeline_fd()
        if lifeline is not None:  # the program that runs several robots started this one
            self.reactor.add_reader(lifeline, partial(self._on_orphaned, lifeline))
        self.start()
        self.reactor.run()
        return self.robot.failure

    def _on_orphaned(self, lifeline: int) -> None:
        self.reactor.remove_reader(lifeline)
        self.robot.shutdown("its parent program has ended")

    def close(self) -> None:
        """End child processes and release all resources; a second call does nothing."""
        self._cleanup.close()

    def _take_true_pose(self, base: BasePose) -> None:
        odometry = odometry_at(self.robot.manager, base.time_ns - self.reactor.now())
        self.robot.truth.take(base, odometry, self.robot.wall_offset_ns)

    def event(self, event: Event) -> None:
        if event.kind == "ready":
            self.supervisor.node_ready(event.node)

    def stopped(self) -> None:
        self.reactor.stop()

    def booted(self) -> None:
        """Start the timer for the duration of the run early if STOP is latched, because the robot may never run."""
        if self.robot.latch.held:
            self._start_timer()

    def running(self) -> None:
        """Start the true pose query, the demo motion and the timer for the duration of the run."""
        self._true_pose.start()
        gc.freeze()  # including the objects created during the boot
        if self.options.motion and self.setup.files.bus_alone and self.robot.joints:
            text = "a bus without controllers has no demo motion; use axis enable NODE, then command NODE VALUE"
            self.robot.report(Event(self.reactor.now(), "demo", "", text))
        elif self.options.motion:
            manager = self.robot.manager
            started = [manager.get(name) for name in self.setup.to_activate]
            moving = [
                controller.name for controller in started if controller.moves_joints and not controller.is_broadcaster
            ]
            self._motion = DemoMotion(self.robot, moving[0]) if moving else None
        self._start_timer()

    def _start_timer(self) -> None:
        """Schedule the end of a run with a limited duration; a second call does nothing."""
        if self.options.duration is not None and self._timer is None:
            self._timer = self.reactor.call_later(round(self.options.duration * 1e9), self._on_elapsed)

    def _on_elapsed(self) -> None:
        """End the run; it has failed if STOP, latched at first, has kept the robot from running."""
        if not self.robot.has_run:
            latched_by = self.robot.latch.by
            held = f"STOP is latched (by {latched_by}); start the robot without --for, then: {RELEASE}"
            why = held if latched_by is not None else "STOP was released too late; allow more time with --for"
            self.robot.failure = f"{self.setup.name} did not start within {self.options.duration:g} s: {why}"
        self.robot.shutdown("duration elapsed")


def _claim(channel: str) -> int:
    """Lock a channel on this host for this NMT master; raise RobotConfigError if another process holds the lock.

    A process without a robot's socket is about to end, and is awaited.
    """
    safe = "".join(letter if letter.isalnum() or letter in "_-" else "_" for letter in channel)
    path = runtime_dir() / f"master-{safe[:48]}.lock"
    try:
        return claim(path)
    except SocketInUse as error:
        holder = error.pid
    robot = _robot_of(holder)
    try:
        return claim(path, _ENDING_S if robot is None else 0.0)
    except SocketInUse:
        end = "end that process" if robot is None else f"end it (canopen-control shutdown --name {robot})"
        raise RobotConfigError(
            f"channel {channel} is busy: process {holder or 'unknown'} already runs a robot on it; "
            f"{end}, or choose another channel with --can"
        ) from None


def _robot_of(pid: int) -> str | None:
    """Return the name of the robot at whose socket a process listens, None without one."""
    for name in find_robots():
        with contextlib.suppress(OSError), connect(socket_path("robot", name), _PROBE_S) as probe:
            if peer_pid(probe) == pid:
                return name
    return None
