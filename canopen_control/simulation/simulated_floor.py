"""The floor under a robot in virtual time: the world in which virtual drives move it, as those of `run --physics` do.

The drives of one world have one clock, as drives of one process have. A drive without supply lets its joints go.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Final

from canopen_control.runtime.physics_plant import write_plant
from canopen_control.virtual.worldfile import read_world

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from canopen_control.hardware.joint import JointDrive
    from canopen_control.rpc.messages.drive import WorldState
    from canopen_control.runtime.setup import RobotSetup
    from canopen_control.simulation.virtual_time import VirtualTime
    from canopen_control.virtual.plant import Plant
    from canopen_control.virtual.virtual_node import VirtualNode

__all__ = ["SimulatedFloor"]

_AWAKE_NS: Final = 20_000_000


class SimulatedFloor:
    """The world of a robot's drives, brought to the present now and then; RobotConfigError where it has no joints.

    `awake` returns the devices that have supply and whose process is not held up.
    """

    def __init__(
        self,
        setup: RobotSetup,
        joints: Mapping[str, JointDrive],
        time: VirtualTime,
        awake: Callable[[], Iterable[VirtualNode]],
    ) -> None:
        with tempfile.TemporaryDirectory(prefix="canopen_control-") as folder:
            self._world = read_world(write_plant(setup, joints, folder=Path(folder)))
        self._time, self._devices = time, awake
        time.later(_AWAKE_NS, self._keep_up)

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

    def _keep_up(self) -> None:
        now = self._time.now_ns
        for device in self._devices():
            device.advance_drives(now)
        self._time.later(self._world.period_ns or _AWAKE_NS, self._keep_up)
