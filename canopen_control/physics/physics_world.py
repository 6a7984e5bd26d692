"""The world behind the virtual drives of a process: all their joints in one simulation, moved when somebody looks.

The world lives on a grid of its own steps. Who brings one axis to a time brings all of them there, each timer of the
others at its own time, in order; what a drive wants is read at each point of the grid. So what happens depends on what
the drives are told and when, to the bit, and not on who looked how often. Where nothing moves and nothing wants to,
time passes without a step.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import mujoco
import numpy as np

from canopen_control.physics.joint_servo import JointPlant
from canopen_control.physics.mecanum_contact import MecanumContact
from canopen_control.physics.world_sensors import SensorReader
from canopen_control.physics.world_shapes import shapes_of
from canopen_control.rpc.messages.drive import BasePose, WorldState

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from canopen_control.physics.body_model import Body, JointPlace
    from canopen_control.physics.disturbances import Disturbances
    from canopen_control.physics.physics_file import AxisSettings
    from canopen_control.physics.world_sensors import WorldSensor
    from canopen_control.rpc.messages.drive import WorldAct, WorldShape

__all__ = ["PhysicsWorld"]

_NS: Final = 1e-9
_AWAKE_NS, _ASLEEP_NS = 20_000_000, 200_000_000  # how often the axes are to be brought to the present
_LOOK: Final = 16  # steps between two looks whether all is at rest, and at the heading
_REST_S: Final = 0.5
_AT_REST: Final = 1e-3  # rad/s, m/s
_SETTLE_STEPS: Final = 300
_BASE_DOFS: Final = 6  # of a free root, which come first


class PhysicsWorld:
    """The `World` of one body; `axes` are the settings of the axes by node id and number, `notes` what was guessed."""

    def __init__(
        self,
        body: Body,
        axes: Mapping[tuple[int, int], AxisSettings],
        disturbances: Disturbances,
        notes: tuple[str, ...] = (),
        sensors: Sequence[WorldSensor] = (),
    ) -> None:
        self._body, self._axes, self.model, self.notes = body, axes, body.model, notes
        self.data = mujoco.MjData(body.model)
        self.angles, self.speeds, self.efforts = self.data.qpos, self.data.qvel, self.data.qfrc_applied
        self.period = float(body.model.opt.timestep)
        self.step_ns = round(self.period / _NS)
        self.steps = 0  # that were simulated
        self._plants: dict[tuple[int, int], JointPlant] = {}
        self._point: int | None = None  # of the grid, the last one that was reached
        self._shown = -1
        self._quiet = 0  # looks at rest, one after the other
        self._asleep = False
        self._orders: list[tuple[object, ...]] = []
        self._heading, self._turns = 0.0, 0
        self._began: int | None = None  # point of the grid from which the world's own times count
        self._sensors = SensorReader(self.model, self.data, sensors)
        self._settle()
        self._disturbances = disturbances
        load = self._weight() / max(1, len(body.rollers))
        self._rollers = [MecanumContact(self.model, self.data, each, load) for each in body.rollers]
        disturbances.block = self._block
        disturbances.begin(self.data)
        disturbances.look_at_grip()

    def _weight(self) -> float:
        """Return the weight of the robot in N."""
        if self._body.base is None:
            return 0.0
        return float(self.model.body_subtreemass[self._body.base] * np.linalg.norm(self.model.opt.gravity))

    def _settle(self) -> None:
        """Let it sink onto the floor before anybody looks, its driven joints held."""
        for place in self._body.joints.values():
            self.set_lock(place, True)
        mujoco.mj_step(self.model, self.data, _SETTLE_STEPS)
        for place in self._body.joints.values():
            self.set_lock(place, False)
        self.data.time = 0.0
        self.speeds[:] = 0.0
        mujoco.mj_forward(self.model, self.data)
        self._look_at_heading()

    # -- the axes

    @property
    def period_ns(self) -> int | None:
        """How often the axes want to be brought to the present, although nobody asks."""
        return _ASLEEP_NS if self._asleep else _AWAKE_NS

    @property
    def asleep(self) -> bool:
        """Whether nothing moves, and nothing wants to."""
        return self._asleep

    def plant(self, node_id: int, axis: int) -> JointPlant:
        """Return the plant of an axis; KeyError where it has none."""
        settings = self._axes[node_id, axis]
        plant = JointPlant(self, self._body.joints[settings.joint], settings, self.period)
        self._plants[node_id, axis] = plant
        return plant

    def set_lock(self, place: JointPlace, locked: bool) -> None:
        """Hold a joint where it is, or let it go."""
        if locked:
            self.model.eq_data[place.lock, 0] = self.angles[place.qpos] - self.model.qpos0[place.qpos]
        self.data.eq_active[place.lock] = locked

    def set_friction(self, place: JointPlace, torque: float) -> None:
        """Change the friction of a joint, in N m."""
        self.model.dof_frictionloss[place.dof] = torque

    def wake(self) -> None:
        """Go on from rest: something acts from outside."""
        self._asleep, self._quiet = False, 0

    # -- time

    def reach(self, now: int, by: JointPlant) -> None:
        """Bring everything to `now`; `by` is the axis that is about to serve its own timers."""
        if now <= self._shown:
            return
        was, by.busy = by.busy, True
        try:
            self._serve_others(now)
            self._advance(now)
        finally:
            by.busy = was

    def _serve_others(self, now: int) -> None:
        """Serve the timers of the axes that nobody looks at, in order, up to `now`."""
        while (found := self._next(now)) is not None:
            due, plant = found
            plant.busy = True
            try:
                if plant.leader is not None:
                    plant.leader.advance(max(due, self._shown))
            finally:
                plant.busy = False

    def _next(self, now: int) -> tuple[int, JointPlant] | None:
        found: tuple[int, JointPlant] | None = None
        for plant in self._plants.values():
            if plant.leader is None or plant.busy:
                continue
            due = plant.leader.next_event()
            if due is not None and due <= now and (found is None or due < found[0]):
                found = due, plant
        return found

    def _advance(self, now: int) -> None:
        """Step to the last point of the grid that is not after `now`."""
        if now <= self._shown:
            return
        last, plants = now // self.step_ns, list(self._plants.values())
        if self._point is None:
            self._point = self._began = last
        if self._asleep and self._orders != [plant.order() for plant in plants]:
            self.wake()
        while self._point < last:
            if self._disturbances.advance(self._age_ns()):
                self.wake()
            if self._asleep:
                self._point = self._sleep_until(last)
                continue
            self._step(self._point * self.step_ns, plants)
            self._point += 1
            if not self._point % _LOOK:
                self._look_for_rest(plants)
        self._shown = now
        beyond = (now - self._point * self.step_ns) * _NS
        for plant in plants:
            plant.show(beyond)

    def _age_ns(self) -> int:
        """How old the world is."""
        return ((self._point or 0) - (self._began or 0)) * self.step_ns

    def _sleep_until(self, last: int) -> int:
        """Return the point of the grid to which nothing happens."""
        due = self._disturbances.next_ns()
        return last if due is None else min(last, (self._began or 0) - (-due // self.step_ns))

    def act(self, what: WorldAct) -> None:
        """Let something happen now, at the time to which the world was brought."""
        self._disturbances.act(what, self._age_ns())
        self.wake()

    def _block(self, joint: str, on: bool) -> None:
        for plant in self._plants.values():
            if plant.joint == joint:
                plant.stalled = on

    def _step(self, clock: int, plants: Iterable[JointPlant]) -> None:
        for plant in plants:
            plant.control(clock)
        if self._rollers:
            self.efforts[:_BASE_DOFS] = 0.0  # the joints' own are there anew
            for roller in self._rollers:
                roller.add_force(self._disturbances.grip_at(float(self.angles[0]), float(self.angles[1])))
        if self._disturbances.patched:
            self._disturbances.look_at_grip()
        mujoco.mj_step(self.model, self.data)
        self.steps += 1

    def _look_for_rest(self, plants: list[JointPlant]) -> None:
        """Fall asleep after a time in which nothing moved and nobody wanted it."""
        self._look_at_heading()
        clock = (self._point or 0) * self.step_ns
        # a trajectory equals itself alone: a new order wakes, the one that cuts the power too
        orders = [plant.order() for plant in plants]
        moving = float(np.abs(self.speeds).max()) > _AT_REST
        if moving or orders != self._orders or any(plant.wants(clock) for plant in plants):
            self._orders, self._quiet = orders, 0
            return
        self._quiet += 1
        if self._quiet * _LOOK * self.period >= _REST_S:
            self._asleep = True
            self.speeds[:] = 0.0

    # -- what there is to see

    def _look_at_heading(self) -> None:
        """Count the turns of the base, so that its heading goes on over a half turn."""
        if self._body.base is None:
            return
        heading = _heading(self._rotation())
        self._turns += round((self._heading - heading) / math.tau)
        self._heading = heading

    def _rotation(self) -> tuple[float, float, float, float]:
        w, x, y, z = (float(each) for each in self.angles[3:7])
        return w, x, y, z

    def describe(self) -> WorldState:
        """Return the true pose of the base, and what the sensors measure."""
        sensors = self._sensors.read()
        if self._body.base is None:
            return WorldState(sensors=sensors)
        x, y, z = (float(each) for each in self.angles[:3])
        self._look_at_heading()
        heading = self._heading + self._turns * math.tau
        roll, pitch = _roll_and_pitch(self._rotation())
        return WorldState(BasePose(x, y, heading, max(0, self._shown), z=z, roll=roll, pitch=pitch), sensors=sensors)

    def shapes(self) -> tuple[WorldShape, ...]:
        """Return what stands on the floor beside the robot."""
        return shapes_of(self.model, self.data)

    def close(self) -> None:
        """Do nothing: there is nothing to let go of."""


def _heading(rotation: tuple[float, float, float, float]) -> float:
    w, x, y, z = rotation
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def _roll_and_pitch(rotation: tuple[float, float, float, float]) -> tuple[float, float]:
    w, x, y, z = rotation
    roll = math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return roll, math.asin(max(-1.0, min(1.0, 2.0 * (w * y - z * x))))
