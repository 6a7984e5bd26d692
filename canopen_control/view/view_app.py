"""Process of the view: `python -m canopen_control.view.view_app`, or `canopen-control view`.

One thread with an event loop runs the connection, the dead-man control and the pages. Slow requests run on other
threads, so that STOP never waits. If `run` has started the view, the view ends with its parent or the robot; started by
hand, the view waits until the robot comes back. An error in the view does not affect the robot.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import sys
import time
import traceback
from dataclasses import dataclass
from functools import cache, partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from nicegui import ui

from canopen_control.client import RobotClient, select_robot
from canopen_control.client.drive_client import shapes_of_world
from canopen_control.errors import CanopenError, RemoteError
from canopen_control.host.lifeline import lifeline_fd
from canopen_control.rpc.messages.robot import PublishEvent
from canopen_control.rpc.messages.state import RobotEvent
from canopen_control.view.drive.drive_view import DriveView
from canopen_control.view.elements.nicegui_elements import Feed
from canopen_control.view.page_address import AccessRules, PageAddress, killed_port
from canopen_control.view.page_content import read_faults
from canopen_control.view.page_server import PageServer, listen, silence
from canopen_control.view.panels.simulation_panels import FaultPanel, WorldPanel
from canopen_control.view.panels.state_panels import (
    BannerPanel,
    DrivesPanel,
    EventsPanel,
    JointsPanel,
    PlotsPanel,
    ScenePanel,
)
from canopen_control.view.panels.target_panel import PowerPanel, TargetPanel
from canopen_control.view.panels.teleop_panel import TeleopPanel
from canopen_control.view.panels.trajectory_panel import TrajectoryPanel
from canopen_control.view.robot_connection import DeadMan, RobotConnection, in_thread
from canopen_control.view.robot_view import RobotView
from canopen_control.view.sampling import Stillness, titles
from canopen_control.view.trajectory_player import TrajectoryPlayer

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Mapping

    from canopen_control.rpc.messages.declare import Request
    from canopen_control.rpc.messages.state import StateSample
    from canopen_control.view.elements.nicegui_elements import FeedMessage
    from canopen_control.view.page_content import PageContent
    from canopen_control.view.panels.panel import Panel, PanelContext
    from canopen_control.view.robot_connection import Command, RobotInfo, TeleopCommands


# Page of the robot in one browser: STOP, then the panels of `PANELS`, the Drive view, and the feed.
#
# STOP is plain HTML and needs none of the following code. A new panel is a class in `panels` and an entry in `PANELS`.


_ELEMENTS: Final = Path(__file__).parent / "elements"


@dataclass(frozen=True, slots=True)
class PanelSlot:
    """Panel with its column, "side", "middle" or "right"; an empty title means no heading."""

    key: str
    column: str
    title: str
    make: Callable[[PanelContext], Panel]


PANELS: Final = (
    PanelSlot("banner", "side", "", BannerPanel),
    PanelSlot("drive", "side", "Teleop: hold a button", TeleopPanel),
    PanelSlot("targets", "side", "Drive targets", TargetPanel),
    PanelSlot("trajectory", "side", "Trajectory", TrajectoryPanel),
    PanelSlot("power", "side", "Power", PowerPanel),
    PanelSlot("faults", "side", "", FaultPanel),
    PanelSlot("world", "side", "", WorldPanel),
    PanelSlot("scene", "middle", "", ScenePanel),
    PanelSlot("drives", "right", "Drives", DrivesPanel),
    PanelSlot("joints", "right", "Joints", JointsPanel),
    PanelSlot("plots", "right", "", PlotsPanel),
    PanelSlot("events", "right", "Events, newest first", EventsPanel),
)


@cache
def stop_html() -> str:
    """Return the HTML of the STOP button, with its style and script."""
    style, html, script = ((_ELEMENTS / name).read_text() for name in ("page.css", "stop.html", "stop.js"))
    return f"<style>{style}</style>\n{html}\n<script>{script}</script>"


def build_waiting(robot: str, why: str) -> None:
    """Build the page for a robot that is not connected, with STOP and the reason."""
    ui.add_body_html(stop_html())
    text = f"<div class='cc-head'><span class='cc-name'>{escape(robot)}</span></div>"
    note = f"<div class='cc-cause cc-bad'>not connected<span>{escape(why)}</span></div>"
    with ui.element("main").classes("cc-page"), ui.element("div").classes("cc-side"):
        ui.html(f"<div class='cc-panel cc-p-banner'>{text}{note}</div>", sanitize=False)


class Page:
    """Page in the current NiceGUI client, updated by `show` and `send`."""

    def __init__(self, context: PanelContext) -> None:
        self._context, self.client = context, ui.context.client
        self._commanded: Mapping[str, str] | None = None
        self._lost: bool | None = None
        self._latched: bool | None = None
        self._linear = context.robot.linear
        ui.add_body_html(stop_html())
        self._panels: list[Panel] = []
        columns = {}
        with ui.element("main").classes("cc-page") as main:
            for column in ("side", "middle", "right"):
                with ui.element("div").classes(f"cc-{column}") as columns[column]:
                    self._panels += [self._make(slot) for slot in PANELS if slot.column == column]
            self._drive = DriveView(context, main, columns["side"], _query())
        self._feed = Feed()

    def _make(self, slot: PanelSlot) -> Panel:
        if slot.column == "middle":
            return slot.make(self._context)
        with ui.element("section").classes(f"cc-panel cc-p-{slot.key}"):
            if slot.title:
                ui.html(escape(slot.title), sanitize=False, tag="h2")
            return slot.make(self._context)

    def show(self, content: PageContent) -> None:
        """Update the panels and the Drive view; called a few times a second."""
        with self.client:
            for panel in self._panels:
                panel.show(content)
            self._drive.show(content)

    def leave(self) -> None:
        """Stop reading objects for this page because it was closed."""
        self._drive.leave()

    def changes(self, content: PageContent) -> FeedMessage:
        """Return the feed message for this page with the changes since the last call."""
        message: FeedMessage = {}
        if content.commanded != self._commanded:
            self._commanded = content.commanded
            message["titles"] = titles(content.commanded, self._linear)
        if bool(content.lost) is not self._lost:
            self._lost = message["lost"] = bool(content.lost)
        if content.state.latched is not self._latched:
            self._latched = message["latched"] = content.state.latched
        return message

    def send(self, data: FeedMessage) -> None:
        """Send a feed message to the scene and the plots; an empty message only shows that the view is running."""
        self._feed.send(data)

    def reload(self) -> None:
        """Reload the page in the browser when the robot's structure has changed."""
        self.client.run_javascript("location.reload()")


def _query() -> dict[str, str]:
    """Return the query parameters of the page's address."""
    return dict(ui.context.client.request.query_params)


SEEN_HZ: Final = 25.0  # samples of the state while a page is open
STILL_HZ: Final = 10.0  # while the robot is at standstill
UNSEEN_HZ: Final = 5.0
_TICK_S: Final = 0.2  # between two updates of the texts
_RETRY_S: Final = 0.5
_FAULTS_S: Final = 3.0
_WORLD_S: Final = 0.25
_SILENT_S: Final = 1.5  # a running robot sends at least 5 messages a second


class ViewApp:
    """View of the robot `name` (None: the only running robot); serves until a signal or the end of its parent.

    `report` prints a text. Raise ConfigError if there is no such robot, or no free port.
    """

    def __init__(
        self, name: str | None, host: str, port: int | None, *, teleop: bool, report: Callable[[str], None]
    ) -> None:
        self.name, self.teleop, self._report = select_robot(name), teleop, report
        listener = listen(host, port, killed_port(self.name, host))
        port = listener.getsockname()[1]
        self._address = PageAddress(self.name, host, port)
        self.rules = AccessRules(host, port, self._address.token)
        self._lifeline = lifeline_fd()
        self.server = PageServer(listener, self.rules, self.name, self._build, self.stop)
        silence(report)
        self._connection: RobotConnection | None = None
        self._lost, self._last_message, self._silent = f"robot {self.name} is not connected", 0.0, False
        self._pages: dict[str, Page] = {}
        self._dead_man = DeadMan(self._send)
        self.player = TrajectoryPlayer(
            lambda page: self.teleop and page in self._pages, partial(RobotClient.connect, self.name)
        )
        self._hold_timer: asyncio.TimerHandle | None = None
        self._tasks: set[asyncio.Task[Any]] = set()
        self._robot: RobotView | None = None
        self._stillness, self._is_still = Stillness(), False
        self._controller_states: dict[str, str] | None = None
        self._meshes = 0

    @property
    def robot(self) -> RobotView:
        """Data of the robot; raise RemoteError if the robot has not been found yet."""
        if self._robot is None:
            raise RemoteError("BusClosed", self._lost)
        return self._robot

    # ------------------------------------------------------------------------------------ begin and end

    async def run(self) -> None:
        """Serve the page until a signal or the end of the parent; a view started by `run` also ends with the robot."""
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(self._on_error)
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.server.stop)
        if self._lifeline is not None:
            loop.add_reader(self._lifeline, self.server.stop)
        self._address.keep(self.rules)
        try:
            await self.server.serve(self._begin)
        finally:
            self._address.end()
            self._dead_man.release()
            self.player.end()
            self._leave()
            for task in self._tasks:
                task.cancel()

    def _begin(self) -> None:
        for endless in (self._connect(), self._tick_for_ever(), self._watch_faults(), self._watch_world()):
            self._start(endless)

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._done)

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._complain(error)

    def _on_error(self, _loop: object, context: dict[str, object]) -> None:
        error = context.get("exception")
        if isinstance(error, BaseException) and not isinstance(error, (ConnectionError, asyncio.CancelledError)):
            self._complain(error)

    def _complain(self, error: BaseException) -> None:
        """Report an exception and continue, so that the STOP button keeps working."""
        self._report("".join(traceback.format_exception(error)).rstrip())

    # ------------------------------------------------------------------------------------ what a page may do

    def stop(self) -> str | None:
        """Send a latched STOP; return the reason if the robot is not connected or does not respond, else None."""
        if self._connection is None:
            return (
                f"Robot {self.name} is not connected: {self._lost}. "
                "Use another way to stop it (emergency stop, terminal)."
            )
        self._dead_man.forget()  # nothing may be sent after STOP
        try:
            self._connection.stop()
        except CanopenError as error:
            return str(error)
        return (
            f"Robot {self.name} does not answer; use another way to stop it (emergency stop, terminal)."
            if self._silent
            else None
        )

    async def ask(self, request: Request[Any]) -> str | None:
        """Send a request to the robot and wait; return the reason for a failure, or None on success."""
        connection = self._connection
        return (
            f"robot {self.name} is not connected"
            if connection is None
            else await in_thread(partial(connection.ask, request))
        )

    def hold(self, page: str, motion: TeleopCommands, on_refusal: Callable[[str], None]) -> None:
        """Start or renew the motion of a held button; `on_refusal` receives a sentence if another page drives."""
        if page not in self._pages or not self.teleop:
            return  # the page was closed in the meantime
        if not self._dead_man.hold(page, motion, time.monotonic_ns()):
            on_refusal("another page is driving; release the button there first")
        elif self._hold_timer is None:
            self._watch_hold()

    def release(self, page: str) -> None:
        self._dead_man.leave(page)

    def _watch_hold(self) -> None:
        """End the motion after the timeout; schedule the next check while a button is held."""
        now = time.monotonic_ns()
        self._dead_man.tick(now)
        deadline = self._dead_man.deadline
        loop = asyncio.get_running_loop()
        self._hold_timer = None if deadline is None else loop.call_later((deadline - now) / 1e9, self._watch_hold)

    def _send(self, command: Command) -> None:
        if self._connection is not None:
            self._connection.send(command)

    # ------------------------------------------------------------------------------------ open pages

    def _build(self) -> None:
        """Build the page for a new client."""
        if self._robot is None:
            build_waiting(self.name, self._lost)
            ui.timer(1.0, lambda: ui.navigate.reload() if self._robot is not None else None)
            return
        page, client = Page(self), ui.context.client
        page.show(self._robot.content(self._lost))
        client.on_connect(lambda: self._page_opened(page))
        client.on_disconnect(lambda: self._page_closed(client.id))

    def _page_opened(self, page: Page) -> None:
        self._pages[page.client.id] = page
        robot = self.robot
        trail, truth = list(robot.trail.points), list(robot.true_trail.points)
        page.send({"plots": {"replace": True, "rows": robot.history.rows()}, "trail": trail, "truth": truth})
        if robot.world.document is not None:
            page.send({"world": robot.world.document})
        page.send({"scene": robot.scene_now(), **page.changes(robot.content(self._lost))})
        self._set_rate()
        self.refresh_faults()

    def _page_closed(self, page: str) -> None:
        closed = self._pages.pop(page, None)
        self._dead_man.leave(page)
        self.player.leave(page)
        self._set_rate()
        if closed is not None:
            closed.leave()

    def _set_rate(self) -> None:
        if self._connection is not None:
            try:
                self._connection.subscribe((STILL_HZ if self._is_still else SEEN_HZ) if self._pages else UNSEEN_HZ)
            except RemoteError as error:
                self._drop(str(error))

    # ------------------------------------------------------------------------------------ what is shown

    async def _tick_for_ever(self) -> None:
        while True:
            try:
                self._tick()
            except Exception as error:  # noqa: BLE001 - see `_complain`
                self._complain(error)
            await asyncio.sleep(_TICK_S)

    def _tick(self) -> None:
        self.player.tick()
        if self._robot is None:
            return
        self._check_silence()
        content, rows = self._robot.content(self._lost), self._robot.history.take_new_rows()
        for page in list(self._pages.values()):
            try:
                page.show(content)
            except Exception as error:  # noqa: BLE001 - the feed and all other pages are still updated
                self._complain(error)
            changes = page.changes(content)
            if rows:
                changes["plots"] = {"rows": rows}
            page.send(changes)

    def _check_silence(self) -> None:
        """Mark a connected robot as lost while it has been silent for at least `_SILENT_S`."""
        silent_s = time.monotonic() - self._last_message
        self._silent = self._connection is not None and silent_s > _SILENT_S
        if self._silent:
            self._lost = f"Robot {self.name} has sent nothing for {silent_s:.0f} s"

    def _take(self, robot: RobotView, state: StateSample) -> None:
        self._last_message = time.monotonic()
        self._silent, self._lost = False, ""
        if state.controllers != self._controller_states:
            self._controller_states = state.controllers
            self._start(self._follow_controllers(robot))
        if self._stillness.take(state) is not self._is_still:
            self._is_still = not self._is_still
            self._set_rate()
        changed = robot.take(state)
        for page in list(self._pages.values()) if changed else ():
            page.send({"scene": changed})

    async def _follow_controllers(self, robot: RobotView) -> None:
        """Request the controllers until the robot replies or ends, or the controllers change again."""
        connection, requested = self._connection, self._controller_states
        while connection is not None and connection is self._connection and requested is self._controller_states:
            with contextlib.suppress(CanopenError):
                robot.controllers = await in_thread(connection.controllers)
                return
            await asyncio.sleep(_RETRY_S)

    def refresh_faults(self) -> None:
        """Read the faults of the virtual drives on a separate thread, because a drive may not respond."""
        self._start(self._refresh_faults())

    async def _refresh_faults(self) -> None:
        if self._robot is not None:
            self._robot.faults = await in_thread(partial(read_faults, self._robot.drives))

    async def _watch_faults(self) -> None:
        while True:
            if self._pages:
                await self._refresh_faults()
            await asyncio.sleep(_FAULTS_S)

    async def _watch_world(self) -> None:
        """Update the objects of a simulated world while a page is open."""
        while True:
            robot, moves = self._robot, False
            if robot is not None and self._pages and robot.state.true_pose is not None:
                nodes = [(node.channel, node.node_id) for node in robot.info.nodes]
                shapes = await in_thread(partial(shapes_of_world, nodes)) or robot.info.world
                news, moves = robot.world.take(shapes, robot.state), any(shape.moves for shape in shapes)
                if news is not None:
                    for page in list(self._pages.values()):
                        page.send({"world": news})
            await asyncio.sleep(_WORLD_S if moves else _FAULTS_S)

    # ------------------------------------------------------------------------------------ the connection

    async def _connect(self) -> None:
        """Connect to the robot, retrying until connected; a view started by `run` tries only once."""
        while (opened := await self._open_connection()) is None:
            if self._lifeline is not None:
                self._report(self._lost)
                self.server.stop()
                return
            await asyncio.sleep(_RETRY_S)
        connection, info = opened
        self._connection, self._lost, self._last_message = connection, "", time.monotonic()
        self._controller_states = None
        self._read_info(info)
        self._announce(connection)
        self._set_rate()
        if self._connection is connection:
            asyncio.get_running_loop().add_reader(connection.fileno(), self._on_readable)
            self._on_readable()  # messages that arrived with an answer do not make the descriptor readable

    async def _open_connection(self) -> tuple[RobotConnection, RobotInfo] | None:
        try:
            return await in_thread(partial(_open_connection, self.name), discard=lambda opened: opened[0].close())
        except CanopenError as error:
            self._lost = str(error)
            return None

    def _read_info(self, info: RobotInfo) -> None:
        """Store the constant data of a robot; reload the pages if its structure has changed."""
        if self._robot is not None and self._robot.resume(info):
            return
        self._robot = RobotView(info, self._publish)
        for note in self._robot.scene.notes:
            self._report(note)
        for page in self._pages.values():
            page.reload()

    def _publish(self, content: bytes, kind: str) -> str:
        self._meshes += 1
        path = f"/mesh/{self._meshes}.{kind}"
        self.server.add_file(path, content, "model/stl" if kind == "stl" else "model/gltf-binary")
        return path.removeprefix("/")  # an address of the page is relative: it begins with the token

    def _announce(self, connection: RobotConnection) -> None:
        """Print the page's address; a view started by `run` prints and publishes the address without the token.

        Events are recorded and published as ROS topics; `run` gets the token from `page_addresses`.
        """
        if self._lifeline is not None:
            connection.send(PublishEvent(kind="view", text=f"view: {self.rules.place}"))
            self._report(f"view: {self.rules.place}")
        else:
            self._report(f"view: {self.rules.url}")

    def _on_readable(self) -> None:
        connection, robot = self._connection, self._robot
        if connection is None or robot is None:
            return
        try:
            for message in connection.messages():
                if isinstance(message, RobotEvent):
                    robot.events.add(message)
                else:
                    self._take(robot, message)
        except RemoteError as error:
            self._drop(str(error))

    def _drop(self, why: str) -> None:
        """Mark the robot as lost; then try to reconnect, or end the view if `run` has started it."""
        if self._connection is None:
            return
        self._leave()
        self._lost = why
        self._report(why)
        if self._lifeline is not None:
            self.server.stop()
        else:
            self._start(self._connect())

    def _leave(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            asyncio.get_running_loop().remove_reader(connection.fileno())
            connection.close()


def _open_connection(name: str) -> tuple[RobotConnection, RobotInfo]:
    """Connect to the robot and request its constant data; blocks."""
    connection = RobotConnection(name)
    try:
        return connection, connection.robot_info()
    except BaseException:
        connection.close()
        raise


def main(name: str | None, host: str, port: int | None, *, teleop: bool) -> None:
    """Serve the page until a signal ends it; raise ConfigError if the page cannot start."""

    def print_line(text: str) -> None:
        sys.stdout.write(f"{text}\n")
        sys.stdout.flush()

    asyncio.run(ViewApp(name, host, port, teleop=teleop, report=print_line).run())
