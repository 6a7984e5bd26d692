"""Robot in a simulated world: axes with their joints, base pose, and sensor measurements.

The heading of the base counts full turns, so that it must be read frequently while the robot moves. An encoder reads
the angle of its joint directly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from canopen_control.physics.ground_contact import MecanumContact
from canopen_control.physics.world_sensors import SensorReader
from canopen_control.rpc.messages.drive import BasePose, WorldState

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from canopen_control.physics.body_model import Body
    from canopen_control.physics.physics_file import AxisAddress, AxisSettings, EncoderSettings
    from canopen_control.physics.world_sensors import WorldSensor


_BASE_DOFS: Final = 6  # degrees of freedom of a free root


class WorldRobot:
    """Robot in a world, named "" if it is the only one; `encoders` are by bus and node-ID.

    `begin` sets the state of the world, `touch_down` is called when the robot stands on the floor.
    """

    def __init__(
        self,
        name: str,
        body: Body,
        axes: Mapping[AxisAddress, AxisSettings],
        sensors: Sequence[WorldSensor] = (),
        encoders: Mapping[tuple[str, int], EncoderSettings] | None = None,
    ) -> None:
        self.name, self.body, self.axes = name, body, axes
        self.encoders = dict(encoders or {})
        self._shafts = {
            address: int(body.model.joint(f"{body.prefix}{encoder.joint}").qposadr[0])
            for address, encoder in self.encoders.items()
        }
        self._sensors_here = sensors
        self._data: Any = None
        self._qpos = self._dof = 0  # indices of the base
        self._heading, self._turns = 0.0, 0
        self._rollers: list[MecanumContact] = []

    def begin(self, data: Any) -> None:  # noqa: ANN401 - of MuJoCo
        """Use the MuJoCo state `data` from now on."""
        model = self.body.model
        self._data = data
        self._sensors = SensorReader(model, data, self._sensors_here, prefix=self.body.prefix)
        if self.body.base is not None:
            joint = int(model.body_jntadr[self.body.base])
            self._qpos, self._dof = int(model.jnt_qposadr[joint]), int(model.jnt_dofadr[joint])

    def touch_down(self) -> None:
        """Initialise wheel loads and heading once the robot rests on the floor."""
        load = self._weight() / max(1, len(self.body.rollers))
        self._rollers = [MecanumContact(self.body.model, self._data, wheel, load) for wheel in self.body.rollers]
        self.count_turns()

    def _weight(self) -> float:
        """Return the robot's weight in N, or 0 for a fixed root."""
        if self.body.base is None:
            return 0.0
        model = self.body.model
        return float(model.body_subtreemass[self.body.base] * np.linalg.norm(model.opt.gravity))

    @property
    def rolls_sideways(self) -> bool:
        """Whether the robot has mecanum wheels."""
        return bool(self._rollers)

    def push_rollers(self, grip_at: Callable[[float, float], float]) -> None:
        """Add the mecanum rollers' contact forces, limited by the floor's friction, for the next step."""
        x, y = self._place()[:2]
        # the forces of the joints are set again in each step
        self._data.qfrc_applied[self._dof : self._dof + _BASE_DOFS] = 0.0
        for roller in self._rollers:
            roller.add_force(grip_at(x, y))

    def shaft_position(self, bus: str, node_id: int) -> float:
        """Return the position of an encoder in rad (m on a prismatic joint)."""
        return float(self._data.qpos[self._shafts[bus, node_id]]) * self.encoders[bus, node_id].factor

    # -- its base

    def _place(self) -> tuple[float, float, float]:
        x, y, z = (float(coordinate) for coordinate in self._data.qpos[self._qpos : self._qpos + 3])
        return x, y, z

    def _rotation(self) -> tuple[float, float, float, float]:
        w, x, y, z = (float(component) for component in self._data.qpos[self._qpos + 3 : self._qpos + 7])
        return w, x, y, z

    def count_turns(self) -> None:
        """Update the base's heading, counted over full turns."""
        if self.body.base is None:
            return
        heading = _heading(self._rotation())
        self._turns += round((self._heading - heading) / math.tau)
        self._heading = heading

    def describe(self, time_ns: int) -> WorldState:
        """Return the true base pose and the sensor measurements, with the time stamp `time_ns`."""
        sensors = self._sensors.read()
        if self.body.base is None:
            return WorldState(sensors=sensors)
        x, y, z = self._place()
        self.count_turns()
        heading = self._heading + self._turns * math.tau
        roll, pitch = _roll_and_pitch(self._rotation())
        return WorldState(BasePose(x, y, heading, time_ns, z=z, roll=roll, pitch=pitch), sensors=sensors)


def _heading(rotation: tuple[float, float, float, float]) -> float:
    w, x, y, z = rotation
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _roll_and_pitch(rotation: tuple[float, float, float, float]) -> tuple[float, float]:
    w, x, y, z = rotation
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
