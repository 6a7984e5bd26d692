"""Player of trajectories for all pages, on a separate connection, without NiceGUI.

A trajectory runs only while its page repeatedly confirms that it is open. Silence for `SILENT_S`, a closed page or a
click on Cancel ends the trajectory: the robot decelerates, holds its position, and reports this as a sentence. The end
of this process ends the trajectory too, since the robot stops when the connection closes or becomes silent; `tick`
confirms that the process is running. Only one page plays at a time.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Final

from canopen_control.client.robot_client import HEARTBEAT_S
from canopen_control.client.trajectory_file import parse_trajectory
from canopen_control.errors import CanopenError, ConfigError, RemoteError
from canopen_control.rpc.messages.samples import TrajectorySample, kind_of
from canopen_control.rpc.messages.trajectory import CancelTrajectory, SendTrajectory, TrajectoryEnd, TrajectoryHeartbeat
from canopen_control.view.robot_connection import SOURCE, in_thread

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.client import RobotClient
    from canopen_control.rpc.messages.samples import TrajectoryPoint
    from canopen_control.rpc.messages.state import ControllerReading


# Trajectory that a page has loaded: its points, the joint positions at each point, and texts about it.
#
# The preview shows the points of the file; the controller of the robot interpolates between them. No toolkit.


MAX_BYTES: Final = 1_000_000  # parsing a larger file could delay STOP; the command line accepts larger ones


@dataclass(frozen=True, slots=True)
class LoadedTrajectory:
    """Joints and points of an uploaded file; `name` is the file name, times of points are in s from the start."""

    name: str
    joints: list[str]
    points: list[TrajectoryPoint]

    @property
    def duration(self) -> float:
        """Time of the last point in s."""
        return self.points[-1].time_from_start

    def positions(self, number: int) -> dict[str, float]:
        """Return the joint positions of a point in rad or m; empty if the point has no positions."""
        positions = self.points[number].positions
        return dict(zip(self.joints, positions, strict=True)) if len(positions) == len(self.joints) else {}


def load(data: bytes, name: str) -> LoadedTrajectory:
    """Parse an uploaded file; if it is invalid, raise ConfigError with all errors and their lines."""
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{name}:{line}: the file is not UTF-8; save it as UTF-8") from None
    joints, points = parse_trajectory(text, name)
    if not points:
        raise ConfigError(f"{name}: the trajectory has no points; give at least one")
    return LoadedTrajectory(name, joints, points)


def active_trajectory_controllers(controllers: Iterable[ControllerReading]) -> list[str]:
    """Return the names of the active trajectory controllers."""
    return [
        controller.name
        for controller in controllers
        if follows_trajectories(controller) and controller.state == "active"
    ]


def follows_trajectories(controller: ControllerReading) -> bool:
    """Whether a controller is a joint trajectory controller, active or not."""
    return controller.tells == kind_of(TrajectorySample)


def progress_of(sample: TrajectorySample | None, duration: float) -> tuple[float, str]:
    """Return the progress of a trajectory as a number from 0 to 1 and as a sentence."""
    if sample is None or not sample.executing:
        return 0.0, "Playing."
    at = min(max(sample.reference.time_from_start, 0.0), duration)
    slow = sample.speed_scaling_factor
    scaled = "" if slow == 1.0 else f", at {100 * slow:.3g} % of its speed"
    return at / duration if duration > 0 else 1.0, f"Playing: {at:.1f} of {duration:.1f} s{scaled}."


def place_text(loaded: LoadedTrajectory, number: int) -> str:
    """Return a sentence with the number and the time of the previewed point."""
    at = loaded.points[number].time_from_start
    return f"Preview, the robot does not move: point {number + 1} of {len(loaded.points)}, at {at:.2f} s"


def preview_table(
    loaded: LoadedTrajectory, number: int, now: Mapping[str, float | None], linear: frozenset[str]
) -> str:
    """Return an HTML table with the previewed and the current positions of the joints."""
    positions = loaded.positions(number)
    if not positions:
        return "<p class='cc-note'>This point has no positions.</p>"
    lines = [
        f"<tr><td><b>{escape(joint)}</b></td><td>{_number(position)}<small>{'m' if joint in linear else 'rad'}</small>"
        f"</td><td>{_now(joint, now)}</td></tr>"
        for joint, position in positions.items()
    ]
    titles = "<tr><th>joint</th><th>preview</th><th>now</th></tr>"
    return f"<table class='cc-table cc-joints cc-preview'>{titles}{''.join(lines)}</table>"


def _now(joint: str, now: Mapping[str, float | None]) -> str:
    if joint not in now:
        return "not a joint of this robot"
    position = now[joint]
    return "-" if position is None else _number(position)


def _number(position: float) -> str:
    return f"{round(position, 3) + 0.0:.3f}"


HERE_HZ: Final = 4.0
SILENT_S: Final = 1.5  # browsers limit the timers of hidden pages to once a second
_TIMEOUT_S: Final = 5.0
_PATIENCE_S: Final = 3600.0  # in addition to the duration: speed may be scaled, and the goal time unlimited
_CLOSED: Final = "the page that played the trajectory was closed"
_SILENT: Final = "the page that played the trajectory does not respond"


@dataclass(frozen=True, slots=True)
class TrajectoryOutcome:
    """Result of a trajectory, with the robot's sentence about how it ended."""

    reached: bool
    text: str


class TrajectoryPlayer:
    """Player of trajectories for all pages; `may_play(page)` is True if a page may move the robot."""

    def __init__(
        self,
        may_play: Callable[[str], bool],
        connect: Callable[[], RobotClient],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._may_play, self._connect, self._clock = may_play, connect, clock
        self._confirmed_at = 0.0
        self._page: str | None = None
        self._run: _Run | None = None

    @property
    def page(self) -> str | None:
        """Page that plays a trajectory, or None."""
        return self._page

    async def play(self, page: str, controller: str, trajectory: LoadedTrajectory) -> TrajectoryOutcome:
        """Play a trajectory and wait for its end; return a refusal if the page may not play or another is playing."""
        if not self._may_play(page):
            return TrajectoryOutcome(False, "this page may not move the robot")
        if self._run is not None:
            return TrajectoryOutcome(
                False, "this or another page is already playing a trajectory; wait until it has ended"
            )
        run = self._run = _Run(controller, trajectory)
        self._page, self._confirmed_at = page, self._clock()
        try:
            return await in_thread(partial(run.play, self._connect))
        finally:
            self._page, self._run = None, None

    def here(self, page: str) -> None:
        """Confirm that a page is open."""
        if page == self._page:
            self._confirmed_at = self._clock()

    def tick(self) -> None:
        """Send a heartbeat to the robot; end the trajectory if the page has been silent for `SILENT_S`."""
        if self._run is None:
            return
        self._run.beat()
        if self._clock() - self._confirmed_at >= SILENT_S:
            self._run.cancel(_SILENT)

    def leave(self, page: str) -> None:
        """End the trajectory of a closed page."""
        self.cancel(page, _CLOSED)

    def cancel(self, page: str, why: str | None = None) -> None:
        """End the trajectory of a page; a trajectory of another page continues."""
        if self._run is not None and page == self._page:
            self._run.cancel(why)

    def end(self) -> None:
        """Close the connection, which ends the trajectory."""
        if self._run is not None:
            self._run.close()


class _Run:
    """Playback of one trajectory on its own connection; `play` blocks, so call it on a thread."""

    def __init__(self, controller: str, trajectory: LoadedTrajectory) -> None:
        self._controller, self._trajectory = controller, trajectory
        self._client: RobotClient | None = None
        self._sent = self._cancelled = False
        self._why: str | None = None

    def play(self, connect: Callable[[], RobotClient]) -> TrajectoryOutcome:
        """Send the trajectory and wait for its end; return errors as an outcome."""
        try:
            with connect() as self._client:
                return self._follow(self._client)
        except CanopenError as error:
            return TrajectoryOutcome(False, str(error))

    def cancel(self, why: str | None) -> None:
        """Cancel the trajectory, so that the joints brake; a second call does nothing."""
        if self._cancelled:
            return
        self._cancelled, self._why = True, why
        if self._sent:
            self._report()

    def close(self) -> None:
        """Close the connection, which makes the robot brake."""
        self._cancelled = True
        if self._client is not None:
            self._client.close()

    def _follow(self, client: RobotClient) -> TrajectoryOutcome:
        loaded = self._trajectory
        remaining = client.send_points(loaded.points)
        if self._cancelled:
            return TrajectoryOutcome(False, f"the trajectory was not sent: {self._why or 'cancelled'}")
        request = SendTrajectory(
            controller=self._controller, joints=loaded.joints, points=remaining, source=SOURCE, heartbeat=HEARTBEAT_S
        )
        verdict = client.ask(request)
        if not verdict.accepted:
            return TrajectoryOutcome(False, verdict.text)
        self._sent = True
        if self._cancelled:  # cancelled while waiting for the answer
            self._report()
        result = client.ask(TrajectoryEnd(), loaded.duration + _PATIENCE_S)
        return TrajectoryOutcome(result.state == "succeeded", result.text)

    def beat(self) -> None:
        """Send a heartbeat if the trajectory is running."""
        if self._sent and not self._cancelled:
            self._notify(TrajectoryHeartbeat())

    def _report(self) -> None:
        self._notify(CancelTrajectory(controller=self._controller, own=True, why=self._why))

    def _notify(self, request: CancelTrajectory | TrajectoryHeartbeat) -> None:
        client = self._client
        with contextlib.suppress(RemoteError):  # the robot has ended, or brakes because the connection is lost
            if client is not None:
                client.notify(request)
