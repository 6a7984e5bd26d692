"""World of the virtual drives of a process: all robots and their joints in one simulation, advanced on demand.

The world has a fixed time step. A call for one axis advances all axes: the timers of the other axes are processed at
their own times, in order, and the demand of every drive is read at each step. The result therefore depends only on the
demands and their times, not on the number of calls. While nothing moves and no drive requests motion, time passes
without steps. The world may contain several robots: `side` is the view of one robot.

The heading of a base counts full turns, so it must be read frequently while the robot moves. An encoder reads the
angle of its joint directly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from canopen_control.physics.body_model import settle
from canopen_control.physics.ground_contact import MecanumContact
from canopen_control.physics.joint_servo import JointPlant
from canopen_control.physics.scenery import SOLID
from canopen_control.physics.world_sensors import SensorReader
from canopen_control.rpc.messages.drive import BasePose, WorldShape, WorldState
from canopen_control.urdf.geometry import from_yaw

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from canopen_control.physics.body_model import Body, JointPlace
    from canopen_control.physics.disturbances import Disturbances
    from canopen_control.physics.physics_file import AxisAddress, AxisSettings, EncoderSettings
    from canopen_control.physics.scene_file import Patch
    from canopen_control.physics.world_sensors import WorldSensor
    from canopen_control.rpc.messages.drive import WorldAct


_BASE_DOFS: Final = 6  # degrees of freedom of a free root


class WorldRobot:
    """Robot in a world, named "" if it is the only one; `encoders` is keyed by bus and node-ID.

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
        """Initialise the wheel loads and the heading once the robot rests on the floor."""
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
        """Add the contact forces of the mecanum rollers, limited by the floor's friction, for the next step."""
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
        """Update the heading of the base, which counts full turns."""
        if self.body.base is None:
            return
        heading = _heading(self._rotation())
        self._turns += round((self._heading - heading) / math.tau)
        self._heading = heading

    def describe(self, time_ns: int) -> WorldState:
        """Return the true pose of the base and the sensor measurements, with the time stamp `time_ns`."""
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


# Shapes for display: boxes, walls, ramps, patches and other robots. They are read from the model, so that they are
# complete. A robot's own shapes are excluded. The floor is drawn by the viewer, except for its patches, which are not
# shapes of the model.


_WORLD: Final = 1  # contact bit of the world, which robots lack; see `body_model`
_DIGITS: Final = 4
_PATCH_M: Final = 0.002  # thickness of a drawn patch
_GEOMS = mujoco.mjtGeom
_KINDS: Final = {_GEOMS.mjGEOM_BOX: "box", _GEOMS.mjGEOM_CYLINDER: "cylinder", _GEOMS.mjGEOM_ELLIPSOID: "ellipsoid",
                 _GEOMS.mjGEOM_SPHERE: "ellipsoid", _GEOMS.mjGEOM_CAPSULE: "cylinder"}  # fmt: skip


def patches_of(patches: Iterable[Patch]) -> tuple[WorldShape, ...]:
    """Convert floor patches to flat shapes with friction, for display."""
    return tuple(
        WorldShape(
            name=f"patch {number}",
            kind="patch",
            size=(*patch.size, _PATCH_M),
            position=(*patch.at, 0.0),
            rotation=from_yaw(math.radians(patch.heading)),
            grip=patch.friction,
        )
        for number, patch in enumerate(patches)
    )


def shapes_of(model: Any, data: Any, prefix: str = "") -> tuple[WorldShape, ...]:  # noqa: ANN401 - MuJoCo has no types
    """Return boxes, SDF shapes and other robots for display; `prefix` is the name prefix of the robot that is left out.

    Poses are taken from `data`, in m and as quaternions w, x, y, z.
    """
    return tuple(_shapes(model, data, prefix))


def _shapes(model: Any, data: Any, prefix: str) -> Iterator[WorldShape]:  # noqa: ANN401 - as above
    for number in range(model.ngeom):
        kind, name = int(model.geom_type[number]), str(model.geom(number).name)
        is_world = bool(model.geom_contype[number] & _WORLD)
        is_other = bool(prefix) and not is_world and not name.startswith(prefix)
        is_scenery = is_world and (kind == _GEOMS.mjGEOM_BOX or name.startswith(SOLID))
        if kind == _GEOMS.mjGEOM_MESH and (is_other or is_scenery):
            kind = int(_GEOMS.mjGEOM_BOX)  # the bounding box is enough for another robot, and for a convex part
        if kind not in _KINDS or not (is_other or is_scenery):
            continue
        turn = np.zeros(4)
        mujoco.mju_mat2Quat(turn, data.geom_xmat[number])
        x, y, z = _rounded(data.geom_xpos[number] + _middle(model, data, number))
        length, width, height = _rounded(_lengths(model, number))
        qw, qx, qy, qz = _rounded(turn)
        yield WorldShape(
            name=name or f"box {number}",
            kind=_KINDS[mujoco.mjtGeom(kind)],
            size=(length, width, height),
            position=(x, y, z),
            rotation=(qw, qx, qy, qz),
            moves=bool(model.geom_bodyid[number]),
            robot=name.partition("/")[0] if is_other else "",
        )


def _lengths(model: Any, number: int) -> Any:  # noqa: ANN401 - numpy's
    """Return the dimensions of a shape in m, along its own axes."""
    kind, size = int(model.geom_type[number]), model.geom_size[number]
    if kind == _GEOMS.mjGEOM_SPHERE:
        return np.full(3, 2.0 * size[0])
    if kind in (_GEOMS.mjGEOM_CYLINDER, _GEOMS.mjGEOM_CAPSULE):
        ends = size[0] if kind == _GEOMS.mjGEOM_CAPSULE else 0.0
        return np.array([2.0 * size[0], 2.0 * size[0], 2.0 * (size[1] + ends)])
    if kind == _GEOMS.mjGEOM_MESH:
        return 2.0 * model.geom_aabb[number, 3:]
    return 2.0 * size


def _middle(model: Any, data: Any, number: int) -> Any:  # noqa: ANN401 - as above
    """Return the vector in world axes from the position of a shape to its centre; zero except for a mesh."""
    return data.geom_xmat[number].reshape(3, 3) @ model.geom_aabb[number, :3]


def _rounded(values: Any) -> list[float]:  # noqa: ANN401 - numpy's
    return [round(float(value), _DIGITS) + 0.0 for value in values]


_NS: Final = 1e-9
_AWAKE_NS, _ASLEEP_NS = 20_000_000, 200_000_000  # interval of advancing the axes to the present
_SHAFT_NS: Final = 5_000_000  # interval of publishing encoder positions
_CHECK_STEPS: Final = 16  # steps between two checks for rest, and of the heading
_REST_S: Final = 0.5
_AT_REST: Final = 1e-3  # rad/s, m/s


class PhysicsWorld:
    """Simulation of all robots of a process by name; other modules use it as the `World` of the first robot.

    `notes` are sentences about assumptions made while the world was built.
    """

    def __init__(
        self, robots: Mapping[str, WorldRobot], disturbances: Disturbances, notes: tuple[str, ...] = ()
    ) -> None:
        self._robots, self.notes = dict(robots), notes
        self._first = next(iter(self._robots))
        self.model = self._robots[self._first].body.model
        self.data = mujoco.MjData(self.model)
        self.angles, self.speeds, self.efforts = self.data.qpos, self.data.qvel, self.data.qfrc_applied
        self.period = float(self.model.opt.timestep)
        self.step_ns = round(self.period / _NS)
        self.steps = 0  # number of simulated steps
        self._plants: dict[tuple[str, AxisAddress], JointPlant] = {}
        self._point: int | None = None  # last grid point reached
        self._shown = -1
        self._quiet = 0  # number of consecutive checks at rest
        self._asleep = False
        self._orders: list[tuple[object, ...]] = []
        self._began: int | None = None  # grid point from which the world's own times count
        self._awake_ns = _SHAFT_NS if any(robot.encoders for robot in self._robots.values()) else _AWAKE_NS
        for robot in self._robots.values():
            robot.begin(self.data)
        self._settle()
        self._disturbances = disturbances
        for robot in self._robots.values():
            robot.touch_down()
        self._rolling = [robot for robot in self._robots.values() if robot.rolls_sideways]
        disturbances.blocker = self
        disturbances.begin(self.data)
        disturbances.update_friction()

    def _settle(self) -> None:
        """Simulate with locked joints until the robots rest on the floor."""
        places = [place for robot in self._robots.values() for place in robot.body.joints.values()]
        for place in places:
            self.set_lock(place, True)
        settle(self.model, self.data)
        for place in places:
            self.set_lock(place, False)
        self.data.time = 0.0
        self.speeds[:] = 0.0
        mujoco.mj_forward(self.model, self.data)

    # -- the axes

    @property
    def period_ns(self) -> int | None:
        """Interval in ns at which the axes are advanced without a request; longer while suspended."""
        return _ASLEEP_NS if self._asleep else self._awake_ns

    @property
    def asleep(self) -> bool:
        """Whether the simulation is suspended because nothing moves and no drive requests motion."""
        return self._asleep

    def side(self, robot: str, bus: str = "") -> WorldSide:
        """Return the `World` of a robot's drives on one bus; raise KeyError for an unknown robot."""
        return WorldSide(self, self._robots[robot], bus)

    def plant(self, node_id: int, axis: int) -> JointPlant:
        """Create the plant of an axis on the first robot's main bus; raise KeyError for an unknown axis."""
        return self.joint_plant(self._first, ("", node_id, axis))

    def joint_plant(self, robot: str, address: AxisAddress) -> JointPlant:
        """Create the plant of an axis of a robot; raise KeyError for an unknown robot or axis."""
        owner = self._robots[robot]
        settings = owner.axes[address]
        plant = JointPlant(self, owner.body.joints[settings.joint], settings, self.period)
        self._plants[robot, address] = plant
        return plant

    def set_lock(self, place: JointPlace, locked: bool) -> None:
        place.hold(self.model, self.data, locked)

    def set_friction(self, place: JointPlace, torque: float) -> None:
        """Set the friction of a joint in Nm."""
        self.model.dof_frictionloss[place.dof] = torque

    def wake(self) -> None:
        """Resume a suspended simulation because something outside it has changed."""
        self._asleep, self._quiet = False, 0

    # -- time

    def reach(self, now: int, by: JointPlant) -> None:
        """Advance the simulation to `now`; `by` is the calling plant, which serves its own timers."""
        if now <= self._shown:
            return
        was, by.busy = by.busy, True
        try:
            self._serve_others(now)
            self._advance(now)
        finally:
            by.busy = was

    def _serve_others(self, now: int) -> None:
        """Run the timers of all other axes that are due by `now`, in order of time."""
        while (event := self._next(now)) is not None:
            event_ns, plant = event
            plant.busy = True
            try:
                if plant.owner is not None:
                    plant.owner.advance(max(event_ns, self._shown))
            finally:
                plant.busy = False

    def _next(self, now: int) -> tuple[int, JointPlant] | None:
        nearest: tuple[int, JointPlant] | None = None
        for plant in self._plants.values():
            if plant.owner is None or plant.busy:
                continue
            event_ns = plant.owner.next_event()
            if event_ns is not None and event_ns <= now and (nearest is None or event_ns < nearest[0]):
                nearest = event_ns, plant
        return nearest

    def _advance(self, now: int) -> None:
        """Simulate the steps up to the last grid point at or before `now`, and extrapolate the joints to `now`."""
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
            if not self._point % _CHECK_STEPS:
                self._check_sleep(plants)
        self._shown = now
        beyond = (now - self._point * self.step_ns) * _NS
        for plant in plants:
            plant.show(beyond)

    def _age_ns(self) -> int:
        """Return the time in ns since the start of the world."""
        return ((self._point or 0) - (self._began or 0)) * self.step_ns

    def _sleep_until(self, last: int) -> int:
        """Return the grid point up to which to skip while suspended: that of the next disturbance, at most `last`."""
        event_ns = self._disturbances.next_ns()
        return last if event_ns is None else min(last, (self._began or 0) - (-event_ns // self.step_ns))

    def act(self, world_act: WorldAct, robot: str | None = None) -> None:
        """Apply a disturbance to a robot (None: the first robot) at the current simulation time."""
        self._disturbances.act(world_act, self._age_ns(), self._first if robot is None else robot)
        self.wake()

    def block(self, robot: str, joint: str, on: bool) -> None:
        for (owner, _), plant in self._plants.items():
            if owner == robot and plant.joint == joint:
                plant.stalled = on

    def _step(self, clock: int, plants: Iterable[JointPlant]) -> None:
        for plant in plants:
            plant.control(clock)
        for robot in self._rolling:
            robot.push_rollers(self._disturbances.grip_at)
        if self._disturbances.patches:
            self._disturbances.update_friction()
        mujoco.mj_step(self.model, self.data)
        self.steps += 1

    def _check_sleep(self, plants: list[JointPlant]) -> None:
        """Suspend the simulation after `_REST_S` without motion and without changed demands."""
        for robot in self._robots.values():
            robot.count_turns()
        clock = (self._point or 0) * self.step_ns
        # a trajectory is equal only to itself: a new demand ends the sleep, and so does the loss of power
        orders = [plant.order() for plant in plants]
        moving = float(np.abs(self.speeds).max()) > _AT_REST
        if moving or orders != self._orders or any(plant.wants(clock) for plant in plants):
            self._orders, self._quiet = orders, 0
            return
        self._quiet += 1
        if self._quiet * _CHECK_STEPS * self.period >= _REST_S:
            self._asleep = True
            self.speeds[:] = 0.0

    # -- state

    def describe(self) -> WorldState:
        """Return the true pose of the first robot's base and the measurements of its sensors."""
        return self._robots[self._first].describe(max(0, self._shown))

    @property
    def shown_ns(self) -> int:
        """Time in ns up to which the world has been advanced, or 0 before the first call."""
        return max(0, self._shown)

    def shapes(self, robot: str | None = None) -> tuple[WorldShape, ...]:
        """Return the shapes around a robot (None: the first robot), including other robots."""
        prefix = self._robots[self._first if robot is None else robot].body.prefix
        return (*patches_of(self._disturbances.patches), *shapes_of(self.model, self.data, prefix))

    def has_shaft(self, node_id: int) -> bool:
        """Whether a node on the first robot's main bus is an encoder on a joint."""
        return ("", node_id) in self._robots[self._first].encoders

    def shaft_position(self, node_id: int) -> float | None:
        """Return the position of an encoder on the first robot's main bus, in rad (m on a prismatic joint)."""
        return self._robots[self._first].shaft_position("", node_id)

    def publish(self) -> None:
        pass  # no other process reads the encoders of this world

    def close(self) -> None:
        pass


class WorldSide:
    """`World` for one robot's drives on one bus."""

    def __init__(self, world: PhysicsWorld, robot: WorldRobot, bus: str) -> None:
        self._world, self._robot, self._bus = world, robot, bus

    @property
    def period_ns(self) -> int | None:
        return self._world.period_ns

    def plant(self, node_id: int, axis: int) -> JointPlant:
        return self._world.joint_plant(self._robot.name, (self._bus, node_id, axis))

    def describe(self) -> WorldState:
        return self._robot.describe(self._world.shown_ns)

    def act(self, world_act: WorldAct) -> None:
        self._world.act(world_act, self._robot.name)

    def shapes(self) -> tuple[WorldShape, ...]:
        return self._world.shapes(self._robot.name)

    def has_shaft(self, node_id: int) -> bool:
        return (self._bus, node_id) in self._robot.encoders

    def shaft_position(self, node_id: int) -> float | None:
        return self._robot.shaft_position(self._bus, node_id)

    def publish(self) -> None:
        pass  # no other process reads the encoders of this world

    def close(self) -> None:
        """Leave the world open, because other robots still use it."""
