"""Physics world in virtual time, in which virtual drives move the joints of robots.

The drives of one world share a clock, like drives of one process. A drive without supply releases its joints.
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
    """Return one robot's physics world with the objects of a world file; raise RobotConfigError if it has no joints."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as folder:
        return read_world(write_plant(setup, joints, world, Path(folder)))


def open_shared_floor(robots: Iterable[tuple[RobotSetup, Mapping[str, JointDrive]]], world: Path) -> SharedWorld:
    """Return the physics world of several robots, each at its start pose in the file."""
    with tempfile.TemporaryDirectory(prefix=_PREFIX) as name:
        folder = Path(name)
        plants = [(setup, write_plant(setup, joints, folder=folder / setup.name)) for setup, joints in robots]
        file = write_buses(folder, plants, world.resolve())
        return open_world(read_group(file), file)


class SimulatedFloor:
    """Physics world of a robot's drives, advanced periodically to the current virtual time.

    `awake` returns the devices that have a supply and whose process is not stalled.
    """

    def __init__(self, world: World, time: VirtualTime, awake: Callable[[], Iterable[VirtualNode]]) -> None:
        self._world = world
        self._time, self._devices = time, awake
        time.later(_AWAKE_NS, self._keep_up)

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions about the robot's description, as sentences."""
        return self._world.notes if isinstance(self._world, ReportsAssumptions) else ()

    def plants_of(self, node_id: int) -> Callable[[int], Plant]:
        """Return the factory of plants for the axes of a node."""
        return lambda axis: self._world.plant(node_id, axis)

    def release_joints(self, node_id: int, device: VirtualNode) -> None:
        """Detach the joints from a drive that has lost its supply."""
        for axis in device.drives:
            self._world.plant(node_id, axis)  # a plant without an owner

    def describe(self) -> WorldState:
        """Return the true state of the world, such as the pose of the robot's base."""
        return self._world.describe()

    def act(self, world_act: WorldAct) -> None:
        """Apply a disturbance; raise ConfigError for a missing link or joint."""
        self._keep_up_with(self._time.now_ns)
        if isinstance(self._world, AcceptsEvents):
            self._world.act(world_act)

    def _keep_up(self) -> None:
        self._keep_up_with(self._time.now_ns)
        self._time.later(self._world.period_ns or _AWAKE_NS, self._keep_up)

    def _keep_up_with(self, now: int) -> None:
        for device in self._devices():
            device.advance_drives(now)
