"""The floor under robots in virtual time: the world in which virtual drives move them, as those of `run --physics` do.

The drives of one world have one clock, as drives of one process have. A drive without supply lets its joints go.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.runtime.physics_plant import write_buses, write_plant
from canopen_control.virtual.bus_group import open_world, read_group
from canopen_control.virtual.plant import AcceptsEvents, ReportsAssumptions
from canopen_control.virtual.plant_file import read_world

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.hardware.joint import JointDrive
    from canopen_control.rpc.messages.drive import WorldAct, WorldState
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.virtual_time import VirtualTime
    from canopen_control.virtual.plant import Plant, SharedWorld, World
    from canopen_control.virtual.virtual_node import VirtualNode


_AWAKE_NS: Final = 20_000_000
_PREFIX: Final = "canopen_control-"


def open_floor(setup: RobotSetup, joints: Mapping[str, JointDrive], world: Path | None = None) -> World:
    """Return the world of a robot alone, with what a world file puts into it; RobotConfigError without joints."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as folder:
        return read_world(write_plant(setup, joints, world, Path(folder)))


def open_shared_floor(robots: Iterable[tuple[RobotSetup, Mapping[str, JointDrive]]], world: Path) -> SharedWorld:
    """Return the world of several robots, in which each begins where the file says."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as name:
        folder = Path(name)
        plants = [(setup, write_plant(setup, joints, folder=folder / setup.name)) for setup, joints in robots]
        file = write_buses(folder, plants, world.resolve())
        return open_world(read_group(file), file)


class SimulatedFloor:
    """The world of a robot's drives, or its part of one, brought to the present now and then.

    `awake` returns the devices that have supply and whose process is not held up.
    """

    def __init__(self, world: World, time: VirtualTime, awake: Callable[[], Iterable[VirtualNode]]) -> None:
        self._world = world
        self._time, self._devices = time, awake
        time.later(_AWAKE_NS, self._keep_up)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was assumed of the robot's description, as sentences."""
        return self._world.notes if isinstance(self._world, ReportsAssumptions) else ()

    def plants_of(self, node_id: int) -> Callable[[int], Plant]:
        """Return what makes the plants of a node's axes."""
        return lambda axis: self._world.plant(node_id, axis)

    def let_go(self, node_id: int, device: VirtualNode) -> None:
        """Leave the joints of a drive to themselves that has lost its supply."""
        for axis in device.drives:
            self._world.plant(node_id, axis)  # nobody leads a new one

    def describe(self) -> WorldState:
        """Return the true pose of the base."""
        return self._world.describe()

    def act(self, what: WorldAct) -> None:
        """Let something happen now; ConfigError for a link or joint that is not there."""
        self._keep_up_with(self._time.now_ns)
        if isinstance(self._world, AcceptsEvents):
            self._world.act(what)

    def _keep_up(self) -> None:
        self._keep_up_with(self._time.now_ns)
        self._time.later(self._world.period_ns or _AWAKE_NS, self._keep_up)

    def _keep_up_with(self, now: int) -> None:
        for device in self._devices():
            device.advance_drives(now)
