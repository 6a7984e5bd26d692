"""Several robots in one physics world: one process for all virtual drives, and one process per robot.

Each robot runs as with `run ROBOT --as NAME --no-drives`, on its own buses, with all functions of a single robot. If
the process of a robot ends, only the drives of that robot stop, as after the loss of an NMT master. At the end the
robots are stopped first, then the process of the drives.
"""

from __future__ import annotations

import dataclasses
import signal
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final

from canopen_control.errors import CanopenError, ConfigError, RobotConfigError
from canopen_control.host.environment import MODULE
from canopen_control.host.files import state_dir
from canopen_control.host.reactor import Reactor
from canopen_control.host.signals import INTERRUPTED
from canopen_control.host.spawn import end_children, spawn
from canopen_control.physics import SDF_SUFFIXES, require_physics
from canopen_control.physics.scene_file import read_world_description
from canopen_control.runtime.core import RobotCore
from canopen_control.runtime.physics_plant import check_physics, write_buses, write_plant
from canopen_control.runtime.robot_files import MAIN_BUS, find_robot
from canopen_control.runtime.setup import read_robot
from canopen_control.virtual.plant import WORLD_NOTE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from canopen_control.host.spawn import Child
    from canopen_control.physics.scene_file import RobotStart
    from canopen_control.runtime.setup import RobotSetup


_READY_NS: Final = 30_000_000_000
_GRACE_S: Final = 8.0  # for a robot to stop and leave, then for the drives
_NOTES: Final = 200  # lines of the drives before they are ready
_USAGE: Final = 2
_COMPLAINT: Final = "canopen-control: "
_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass(frozen=True)
class SharedRobot:
    """Robot in a shared world; `arguments` are the command line of the robot's process."""

    setup: RobotSetup
    arguments: tuple[str, ...]

    @property
    def name(self) -> str:
        return self.setup.name


def read_shared(world: Path) -> list[SharedRobot]:
    """Return the robots of a world file; ConfigError lists the errors of all robots by line."""
    require_physics()
    description = read_world_description(world)
    if not description.robots and world.suffix.lower() in SDF_SUFFIXES:
        raise RobotConfigError(
            f"{world}: an SDF world names no robots; run one robot in it: run ROBOT --physics --world {world}, or name "
            "the SDF file by `sdf:` in a world file with `robots:`"
        )
    if not description.robots:
        raise RobotConfigError(
            f"{world}: it names no robots; write `robots:`, or run one robot in it: run ROBOT --physics --world FILE"
        )
    robots, problems = [], []
    for start in description.robots:
        try:
            robots.append(_read(start, world))
        except ConfigError as error:
            problems.append(f"{world}:{start.here.line}:{start.here.column}: {start.name}: {error}")
    if problems:
        raise RobotConfigError("\n".join(problems))
    return robots


def _read(start: RobotStart, world: Path) -> SharedRobot:
    """Read one robot of a world file, from a folder next to it or as found by `find_robot`."""
    folder = world.parent / start.robot
    config = str(folder) if folder.is_dir() else start.robot
    words = [f"{name}:={value}" for name, value in start.arguments.items()]
    files = find_robot(config, arguments=words)
    files.refuse_hardware("robots in a world file need virtual drives")
    buses = {
        name: f"local:{start.name}" if name == MAIN_BUS else f"local:{start.name}_{name}"[:38] for name in files.buses
    }
    can = [f"{name}={channel}" for name, channel in buses.items()]
    setup = read_robot(files, name=start.name, can=can, controllers=start.controllers, physics=True, drives=True)
    check_physics(setup)
    options = [f"--can={channel}" for channel in can] + [
        f"--controller={controller}" for controller in start.controllers
    ]
    return SharedRobot(setup, ("run", config, *words, "--as", start.name, "--no-drives", *options))


class SharedRun:
    """Run of several robots in one physics world; `options` are passed to every robot process.

    `of_each` returns further options for a robot by name, such as the ROS namespace. `report` receives messages.
    """

    def __init__(
        self,
        robots: Sequence[SharedRobot],
        world: Path,
        report: Callable[[str], object],
        *,
        options: Sequence[str] = (),
        of_each: Callable[[str], Sequence[str]] = lambda _name: (),
    ) -> None:
        self._robots, self._world, self._report = robots, world, report
        self._options, self._of_each = tuple(options), of_each
        self._reactor = Reactor()
        self._drives: Child | None = None
        self._running: dict[str, Child] = {}
        self._failed: str | None = None
        self._refused = self._ending = False

    def run(self) -> None:
        """Run until all robots have ended.

        Raise ConfigError if the drives refuse their files, CanopenError if the run fails for another reason.
        """
        try:
            self._reactor.handle_signals(dict.fromkeys(_SIGNALS, self._end))
            self._start_drives()
            self._reactor.run()
        finally:
            self._close()
        if self._failed is not None:
            raise (ConfigError if self._refused else CanopenError)(self._failed)

    def _start_drives(self) -> None:
        plants = [(robot.setup, _write_plant_file(robot.setup)) for robot in self._robots]
        file = write_buses(state_dir(f"world-{self._robots[0].name}"), plants, self._world.resolve())
        argv = [*MODULE, "canopen_control", "drive", "--buses", str(file)]
        self._drives = spawn(argv, name="drives", log_dir=file.parent, reports=True)
        self._drives.watch(self._reactor, self._on_drives_ended)
        self._ready_timer = self._reactor.call_later(_READY_NS, self._on_timeout)
        self._drives.watch_ready(self._reactor, self._on_ready)

    def _on_ready(self) -> None:
        if self._drives is None or self._drives.heard_at is None:
            return  # the process was killed, which is reported at its end
        self._ready_timer.cancel()
        for line in self._drives.last_lines(_NOTES):
            if line.startswith(WORLD_NOTE):
                self._report(line.removeprefix(WORLD_NOTE))
        for robot in () if self._ending else self._robots:
            options = [*robot.arguments, "--say-name", *self._options, *self._of_each(robot.name)]
            child = spawn([*MODULE, "canopen_control", *options], name=robot.name, inherit_stdout=True)
            child.watch(self._reactor, partial(self._on_robot_ended, robot))
            self._running[robot.name] = child

    def _on_timeout(self) -> None:
        self._fail(f"the drives were not ready within {_READY_NS // 1_000_000_000} s; is the machine too busy?")

    def _fail(self, text: str) -> None:
        self._failed = self._failed or text
        self._end()

    def _on_drives_ended(self, returncode: int, lines: list[str]) -> None:
        reasons = [line.removeprefix(_COMPLAINT) for line in lines if not line.startswith(WORLD_NOTE)]
        self._drives, self._refused = None, returncode == _USAGE
        self._fail(
            "\n".join(reasons) if self._refused else f"the process of the drives has ended: {' | '.join(reasons[-3:])}"
        )

    def _on_robot_ended(self, robot: SharedRobot, returncode: int, _lines: list[str]) -> None:
        del self._running[robot.name]
        if returncode and not self._ending:
            command = " ".join(("canopen-control", *robot.arguments))
            self._failed = f"{robot.name} ended with exit code {returncode}"
            running = ", ".join(self._running)
            if running:
                self._report(f"{self._failed}; its drives stop, {running} continues; start it again with: {command}")
        if not self._running:
            self._end()

    def _end(self) -> None:
        self._ending = True
        self._reactor.stop()

    def _close(self) -> None:
        end_children(list(self._running.values()), self._reactor, _GRACE_S)
        for name, child in self._running.items():
            if child.returncode not in (0, INTERRUPTED):  # such as a stop that the drives did not confirm
                self._failed = self._failed or f"{name} ended with exit code {child.returncode}"
        end_children([] if self._drives is None else [self._drives], self._reactor, _GRACE_S)
        self._reactor.close()


def _write_plant_file(setup: RobotSetup) -> Path:
    """Write the plant file of a robot and return the path."""
    with Reactor() as reactor:
        core = RobotCore(dataclasses.replace(setup), reactor)
        try:
            return write_plant(setup, core.joints)
        finally:
            core.close()
