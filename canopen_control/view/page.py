"""The page of one robot: scene, controls, table, plots and log, put together and kept up to date.

The law of this file: the scene moves with every sample, all else a few times a second, and nothing at all is made while
nobody looks, the last 30 seconds apart. What has not changed is not sent again.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any, Final, Protocol

from canopen_control.view.controls import DriveControls, StopControls
from canopen_control.view.fault_panel import FaultPanel
from canopen_control.view.faults import FaultDesk
from canopen_control.view.model import read_model
from canopen_control.view.plots import Plots, Sampler, commanded_interfaces
from canopen_control.view.scene import RobotScene
from canopen_control.view.style import ICONS, STYLE
from canopen_control.view.teleop_panel import Driver, TeleopPanel
from canopen_control.view.words import alarm, axis_rows, drive_table, event_log, head

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import viser

    from canopen_control.view.controls import Robot
    from canopen_control.view.link import Welcome
    from canopen_control.view.server import PageServer

__all__ = ["Page", "RobotAndDriver"]

_SLOW_S: Final = 0.2  # between two updates of what is read, not watched
_EVENTS: Final = 100
_REPEATED: Final = ("sync_overrun", "command_timeout")
_LEFT_PX: Final = 340
_RIGHT_PX: Final = 470


class RobotAndDriver(Driver, Protocol):
    """Everything a page may ask for."""

    def stop(self) -> None:
        """STOP, latched, at once."""
        ...


class Page:
    """Made of what the robot said when the connection was made; `state` and `event` keep it up to date."""

    def __init__(self, server: PageServer, welcome: Welcome, robot: RobotAndDriver, *, teleop: bool) -> None:
        self._server, self._robot = server, welcome.robot
        self._events: deque[Mapping[str, Any]] = deque(maxlen=_EVENTS)
        for event in welcome.status["events"]:
            self.event(event)
        self._sampler = Sampler()
        self._interfaces: dict[str, str] = {}
        self._slow_at = 0.0
        model = read_model(welcome.urdf)
        self._scene = RobotScene(server, model, welcome.path)
        self._left(welcome, robot)
        self._teleop = TeleopPanel(server.gui, robot, model) if teleop else None
        self.faults = FaultPanel(server.gui, FaultDesk(welcome.nodes))
        linear = frozenset(joint.name for joint in model.joints if joint.kind == "prismatic")
        self._right(welcome, linear)

    @property
    def notes(self) -> list[str]:
        """What could not be drawn."""
        return self._scene.notes

    def _left(self, welcome: Welcome, robot: Robot) -> None:
        gui = self._server.gui
        gui.main_panel.dock_left()
        gui.main_panel.set_width(_LEFT_PX)
        gui.add_html(STYLE)
        self._head = _Html(gui, head(self._robot, welcome.status))
        self._stop = StopControls(gui, robot)
        load = {name: bus["load"] for name, bus in welcome.status["buses"].items()}
        self._alarm = _Html(gui, alarm(welcome.status | {"load": load}))  # as the stream has it: nothing jumps later
        follow = gui.add_checkbox("Camera follows", initial_value=True, hint="keep the robot in the middle")
        follow.on_update(lambda _event: self._scene.follow_robot(follow.value))
        DriveControls(gui, robot, list(welcome.status["nodes"]))

    def _right(self, welcome: Welcome, linear: frozenset[str]) -> None:
        gui = self._server.gui
        top, plots = gui.add_panel(), gui.add_panel()
        with top.add_tab("Drives and events", ICONS["drives"]):
            self._table = _Html(gui, drive_table(axis_rows(welcome.status)))
            self._log = _Html(gui, event_log(self._events))
        self._plots = Plots(self._server, plots, list(welcome.status["joints"]), list(welcome.status["buses"]), linear)
        top.dock_right()
        top.set_width(_RIGHT_PX)
        plots.dock_below(top)

    # ------------------------------------------------------------------------------------------------ keeping up

    def controllers(self, controllers: Sequence[Mapping[str, Any]]) -> None:
        """Follow the controllers: what they command, and what can be driven."""
        self._interfaces = commanded_interfaces(controllers)
        self._plots.name(self._interfaces)
        if self._teleop is not None:
            self._teleop.show(controllers)

    def event(self, event: Mapping[str, Any]) -> None:
        """Add to the log; what repeats itself stands there once, with how often it came."""
        before = self._events[-1] if self._events else {}
        times = 1
        if event["kind"] in _REPEATED and event["kind"] == before.get("kind"):
            times += self._events.pop().get("times", 1)
        self._events.append({**event, "times": times})

    def state(self, state: Mapping[str, Any], *, seen: bool) -> None:
        """Take a sample of the stream; draw it if somebody looks."""
        self._plots.history.add(state["time"], self._sampler.take(state, self._interfaces))
        positions = {name: joint["position"] for name, joint in state["joints"].items()}
        if self._teleop is not None:
            self._teleop.follow(positions)
        if not seen:
            return
        with self._server.atomic():
            self._scene.move(positions, _pose_of(state))
            if abs(state["time"] - self._slow_at) >= _SLOW_S:
                self._slow_at = state["time"]
                self._slowly(state)

    def lost(self, why: str) -> None:
        """Say that there is no connection."""
        self._head.show(head(self._robot, None))
        self._alarm.show(alarm(None, why))
        self._table.show("<p class='cc-note'>No connection: nobody knows what the drives do.</p>")

    def _slowly(self, state: Mapping[str, Any]) -> None:
        rows = axis_rows(state)
        self._head.show(head(self._robot, state))
        self._alarm.show(alarm(state))
        self._stop.show(latched=bool(state.get("latched")))
        self._table.show(drive_table(rows))
        self._log.show(event_log(self._events))
        self._scene.tint({row.joint for row in rows if row.tone == "bad" and row.joint})
        self._scene.draw_trail()
        self._plots.update()


class _Html:
    """A piece of the page that is sent when it changes."""

    def __init__(self, gui: viser.GuiApi, html: str) -> None:
        self._html = html
        self._handle = gui.add_html(_box(html))

    def show(self, html: str) -> None:
        if html != self._html:
            self._html = html
            self._handle.content = _box(html)


def _box(html: str) -> str:
    return f"<div class='cc-box'>{html}</div>"


def _pose_of(state: Mapping[str, Any]) -> tuple[float, float, float] | None:
    """Return where the first base controller believes to be, None if there is none."""
    for each in (state.get("odometry") or {}).values():
        return each["x"], each["y"], each["heading"]
    return None
