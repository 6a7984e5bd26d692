"""Connection of the page to one robot, with the robot's constant data and the motion commanded by held buttons.

STOP is sent at once on the open connection, and never waits for an answer or behind another request. Slow requests use
a separate connection, on a thread that may block.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TypeVar

from canopen_control.client import RobotClient
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.rpc.messages.robot import (
    AxisRequest,
    CommandController,
    GetDescription,
    GetNodes,
    GetStatus,
    ListControllers,
    Stop,
    Subscribe,
    TwistController,
)
from canopen_control.rpc.messages.samples import OdometrySample, TrajectoryPoint
from canopen_control.rpc.messages.state import ControllerReading, RobotEvent, StateSample
from canopen_control.rpc.messages.trajectory import CancelTrajectory, SendTrajectory, TrajectoryHeartbeat

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.drive import WorldShape
    from canopen_control.rpc.messages.robot import Description, NodeListing, NodePlace
    from canopen_control.rpc.messages.state import Status


# Data of a robot that do not change while the robot runs.


Pose = tuple[float, float, float]
"""Pose as x and y in m and heading in rad."""


@dataclass(frozen=True, slots=True)
class NodeAddress:
    """Node with the CAN channel and the node-ID that identify the socket of its virtual drive."""

    name: str
    channel: str
    node_id: int


@dataclass(frozen=True, slots=True)
class RobotInfo:
    """Constant data of a running robot, and its state and events at the time of the request."""

    robot: str
    urdf: str
    path: str
    nodes: tuple[NodeAddress, ...]
    buses: tuple[str, ...]
    joints: tuple[str, ...]
    state: StateSample
    events: tuple[RobotEvent, ...] = field(default=(), compare=False)
    places: tuple[NodePlace, ...] = ()
    world: tuple[WorldShape, ...] = field(default=(), compare=False)

    @property
    def shape(self) -> object:
        """Comparable key of the robot's structure; pages are reloaded when the key changes."""
        return self.urdf, self.nodes, self.buses, self.joints


def read_robot_info(robot: str, description: Description, listing: NodeListing, status: Status) -> RobotInfo:
    """Combine the robot's replies to the requests `description`, `nodes` and `status`."""
    state = status.grown(StateSample, load={name: bus.load for name, bus in status.buses.items()})
    return RobotInfo(
        robot,
        description.urdf,
        description.path,
        tuple(NodeAddress(node.name, listing.buses[node.bus].channel, node.node_id) for node in listing.nodes),
        tuple(status.buses),
        tuple(sorted(status.joints)),
        state,
        tuple(status.events),
        tuple(sorted(listing.nodes, key=lambda node: node.node_id)),
        description.world,
    )


def true_pose_of(state: StateSample) -> Pose | None:
    """Return the true pose of a simulated base in the odometry frame, or None if unknown."""
    return None if state.true_pose is None else state.true_pose.in_odometry


def pose_of(state: StateSample) -> Pose | None:
    """Return the odometry pose of the first base controller, or None without a base controller."""
    for sample in state.samples_of(OdometrySample).values():
        return sample.x, sample.y, sample.heading
    return None


# Driving by a held button: which page drives, and the command at the release. No browser, no socket.
#
# The robot moves only while a button is held, and the page renews a held button repeatedly. Silence for
# `HOLD_TIMEOUT_NS`, a closed page or another controller ends the motion at once with its resting command. Only one page
# drives at a time; a second page must wait until the first has released its button.


HOLD_HZ: Final = 20.0
HOLD_TIMEOUT_NS: Final = 200_000_000
SOURCE: Final = "view"
Command = CommandController | TwistController | SendTrajectory | CancelTrajectory | TrajectoryHeartbeat
_HEARTBEAT_S: Final = 0.5  # this process renews it 20 times a second; the robot stops if the process hangs


@dataclass(frozen=True, slots=True)
class TeleopCommands:
    """Commands of a held button: `moving` while held, `resting` on release; both expire if the connection is lost.

    `again` is sent instead of `moving` while the same motion continues; None sends `moving` again.
    """

    controller: str
    moving: Command
    resting: Command
    again: Command | None = None


def twist_motion(controller: str, linear: float, angular: float, lateral: float = 0.0) -> TeleopCommands:
    """Return the motion of a base; `linear` (forward) and `lateral` (to the left) are in m/s, `angular` in rad/s."""
    moving, resting = (
        TwistController(
            controller=controller, linear=ahead, lateral=aside, angular=around, source=SOURCE, dead_man=True
        )
        for ahead, aside, around in ((linear, lateral, angular), (0.0, 0.0, 0.0))
    )
    return TeleopCommands(controller, moving, resting)


def trajectory_motion(
    controller: str, joints: Sequence[str], positions: Sequence[float], seconds: float
) -> TeleopCommands:
    """Return the motion of an arm to `positions` in `seconds`; on release the arm brakes."""
    point = TrajectoryPoint(positions=list(positions), velocities=[0.0] * len(positions), time_from_start=seconds)
    goal = SendTrajectory(
        controller=controller, joints=list(joints), points=[point], source=SOURCE, heartbeat=_HEARTBEAT_S
    )
    cancel = CancelTrajectory(controller=controller, own=True, why="the page released its button")
    return TeleopCommands(controller, goal, cancel, TrajectoryHeartbeat())


def joint_motion(
    controller: str, values: Sequence[float], resting: Sequence[float], interface: str | None = None
) -> TeleopCommands:
    """Return the motion of joints with the command `values`; on release the `resting` values are sent.

    `interface` is the kind of the values; the robot refuses them if the controller then takes another kind.
    """
    moved, rested = (
        CommandController(
            controller=controller, values=list(numbers), source=SOURCE, dead_man=True, interface=interface
        )
        for numbers in (values, resting)
    )
    return TeleopCommands(controller, moved, rested)


class DeadMan:
    """Dead-man control: ends the motion of a held button unless it is renewed in time; `send` sends a command."""

    def __init__(self, send: Callable[[Command], object]) -> None:
        self._send = send
        self._driver: str | None = None
        self._motion: TeleopCommands | None = None
        self._renewed_at = 0

    @property
    def driver(self) -> str | None:
        """Page whose button is held, or None if no button is held."""
        return self._driver

    @property
    def deadline(self) -> int | None:
        """Monotonic time in ns at which `tick` ends the motion, or None without a motion."""
        return None if self._driver is None else self._renewed_at + HOLD_TIMEOUT_NS

    def hold(self, page: str, motion: TeleopCommands, now: int) -> bool:
        """Start or renew the motion of a page's held button; return False if another page has control."""
        self.tick(now)
        if self._driver not in (None, page):
            return False
        before = self._motion
        if before is not None and before.controller != motion.controller:
            self._send(before.resting)
        continues = before is not None and motion.again is not None and before == motion
        self._driver, self._motion, self._renewed_at = page, motion, now
        self._send(motion.again if continues and motion.again is not None else motion.moving)
        return True

    def tick(self, now: int) -> None:
        """End the motion if the page has not renewed it for `HOLD_TIMEOUT_NS`."""
        if self._driver is not None and now - self._renewed_at >= HOLD_TIMEOUT_NS:
            self.release()

    def leave(self, page: str) -> None:
        """End the motion of a page that was closed; the motion of another page continues."""
        if page == self._driver:
            self.release()

    def release(self) -> None:
        """Send the resting command if there is a motion."""
        motion, self._driver, self._motion = self._motion, None, None
        if motion is not None:
            self._send(motion.resting)

    def forget(self) -> None:
        """Discard the motion without sending a command, for instance because STOP was sent."""
        self._driver, self._motion = None, None


_TIMEOUT_S: Final = 2.0
_ACTION_TIMEOUT_S: Final = 20.0


class RobotConnection:
    """Connection to the robot `name`; wait until `fileno` is readable, then call `messages`."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._client = RobotClient.connect(name, _TIMEOUT_S)

    def robot_info(self) -> RobotInfo:
        """Request the constant data of the robot; blocks. Raise RemoteError if the robot has ended."""
        ask = self._client.ask
        return read_robot_info(self.name, ask(GetDescription()), ask(GetNodes()), ask(GetStatus()))

    def subscribe(self, rate: float) -> None:
        """Subscribe to events and to samples at `rate` in Hz without waiting.

        Raise RemoteError if the robot has ended.
        """
        self._client.notify(Subscribe(state_rate=rate, events=True))

    def messages(self) -> Iterator[StateSample | RobotEvent]:
        """Yield the received events, then the latest received sample; raise RemoteError if the robot has ended."""
        newest: StateSample | None = None
        for message in self._client.messages(0):
            if isinstance(message, StateSample):
                newest = message
            elif isinstance(message, RobotEvent):
                yield message
        if newest is not None:
            yield newest

    def fileno(self) -> int:
        """Return the file descriptor of the connection, for an event loop."""
        return self._client.fileno()

    def stop(self) -> None:
        """Send a latched STOP without waiting for a reply; raise RemoteError if the robot cannot be reached."""
        self._client.notify(Stop(latch=True, source=SOURCE))

    def send(self, request: Request[Any]) -> None:
        """Send a command without waiting for a reply; errors are ignored.

        If the robot has ended, `messages` reports it.
        """
        with contextlib.suppress(RemoteError):
            self._client.notify(request)

    def ask(self, request: Request[Any]) -> str | None:
        """Send a request on a separate connection and wait; return the reason for a failure, or None on success."""
        try:
            with RobotClient.connect(self.name, _TIMEOUT_S) as client:
                usual = _ACTION_TIMEOUT_S
                client.ask(request, request.timeout_s(usual) if isinstance(request, AxisRequest) else usual)
        except CanopenError as error:
            return str(error)
        return None

    def controllers(self) -> tuple[ControllerReading, ...]:
        """Request the controllers on a separate connection and wait; raise CanopenError if the robot has ended."""
        with RobotClient.connect(self.name, _TIMEOUT_S) as client:
            return client.ask(ListControllers())

    def close(self) -> None:
        self._client.close()


T = TypeVar("T")


async def in_thread(function: Callable[[], T], discard: Callable[[T], object] | None = None) -> T:
    """Run `function` on a thread and return its result or raise its error.

    If the caller was cancelled meanwhile, `discard` gets the result, for example to close a connection. The
    default executor is not used, because the program waits for that executor at its end, and a robot or a drive that
    hangs would delay this.
    """
    loop = asyncio.get_running_loop()
    arrival: asyncio.Future[None] = loop.create_future()
    results: list[T] = []  # at most one; popped either by the waiting caller or by `drop`
    abandoned = threading.Event()

    def drop() -> None:
        with contextlib.suppress(IndexError):
            result = results.pop()
            if discard is not None:
                discard(result)

    def arrive(error: Exception | None) -> None:
        if arrival.done():
            return
        if error is not None:
            arrival.set_exception(error)
        else:
            arrival.set_result(None)

    def work() -> None:
        failure = None
        try:
            results.append(function())
        except Exception as error:  # noqa: BLE001 - raised again in the caller
            failure = error
        if abandoned.is_set():
            drop()
        with contextlib.suppress(RuntimeError):  # the loop has ended meanwhile
            loop.call_soon_threadsafe(arrive, failure)

    threading.Thread(target=work, name="page", daemon=True).start()
    try:
        await arrival
    except asyncio.CancelledError:
        abandoned.set()
        drop()
        raise
    return results.pop()
