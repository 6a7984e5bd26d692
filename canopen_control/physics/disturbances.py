"""Timed disturbances of robots in a world: payloads, pushes, blocked joints and changes of friction.

A payload changes the mass, centre of mass and inertia of a link during the simulation. Every wheel and caster gets the
friction at its position: that of the floor, or of the patch below it. Times are in ns from the start of the world, and
the same requests in the same order give identical results.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import mujoco
import numpy as np

from canopen_control.errors import ConfigError, nearest
from canopen_control.physics.scenery import BOX
from canopen_control.rpc.messages.drive import AddPayload, BlockJoint, PushRobot, SetGrip

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from canopen_control.physics.body_model import Body
    from canopen_control.physics.physics_file import FloorContact
    from canopen_control.physics.scene_file import WorldDescription
    from canopen_control.rpc.messages.drive import WorldAct


_LIGHTEST: Final = 1e-4  # minimum mass of a link in kg
# arrays of the model that payloads change
_CHANGED: Final = ("body_mass", "body_ipos", "body_iquat", "body_inertia", "geom_friction")


class JointBlocker(Protocol):
    """Interface of a simulation with joints that can be blocked."""

    def block(self, robot: str, joint: str, on: bool) -> None: ...


class _EndOfPush(NamedTuple):
    link: int
    force: NDArray[np.float64]


class Disturbances:
    """Disturbances of the robots in a simulation, from the world file or requested while it runs.

    `begin` sets the state of the simulation, `blocker` blocks joints. Robots are named as in the world file, "" for a
    single robot.
    """

    def __init__(self, bodies: Mapping[str, Body], floor: FloorContact, world: WorldDescription) -> None:
        self._bodies = dict(bodies)
        self._model = next(iter(bodies.values())).model
        self._data: Any = None
        self._wheels = tuple(wheel for body in bodies.values() for wheel in body.wheels)
        self._casters = tuple(caster for body in bodies.values() for caster in body.casters)
        self._floor, self._slide, self.patches = floor.friction, floor.caster_friction, world.patches
        self._grip = self._floor
        self._before = {name: getattr(self._model, name).copy() for name in _CHANGED}
        self.blocker: JointBlocker | None = None
        self._pending: list[tuple[int, int, WorldAct | _EndOfPush, str]] = []
        self._count = 0
        self._timeline, self._steps = world.timeline(), world.steps
        names = {str(self._model.body(number).name): number for number in range(1, self._model.nbody)}
        boxes = {name: number for name, number in names.items() if name.startswith(BOX)}
        links_of_robots = {robot: {name: link for name, link in body.links.items() if name not in boxes}
               for robot, body in bodies.items()}  # fmt: skip
        self._links = {robot: {**links, **boxes} for robot, links in links_of_robots.items()}
        masses = self._model.body_mass
        self._heaviest = {robot: max(links.values(), key=lambda link: float(masses[link]), default=0)
                          for robot, links in links_of_robots.items()}  # fmt: skip

    def problems(self) -> Iterator[str]:
        """Yield an error with a line number for every step of the world file with an invalid disturbance."""
        for step in self._steps:
            try:
                for act in step.acts():
                    self._check(act, step.robot)
            except ConfigError as error:
                yield f"{step.here.line}:{step.here.column}: {error}"

    def begin(self, data: Any) -> None:  # noqa: ANN401 - of MuJoCo
        """Start at time 0 with the MuJoCo state `data`, and schedule the disturbances of the world file."""
        self._data = data
        for at_ns, robot, act in self._timeline:
            self._plan(at_ns, act, robot)

    def reset(self) -> None:
        """Undo all disturbances after the state was reset, and reschedule the disturbances of the world file."""
        for name, before in self._before.items():
            getattr(self._model, name)[:] = before
        mujoco.mj_setConst(self._model, mujoco.MjData(self._model))
        self._grip = self._floor
        self._pending.clear()
        self.begin(self._data)

    def grip_at(self, x: float, y: float) -> float:
        """Return the friction coefficient of a wheel at the position x, y (in m) on the floor."""
        grip = self._grip
        for patch in self.patches:
            if patch.covers(x, y):
                grip = patch.friction
        return grip

    def next_ns(self) -> int | None:
        """Return the time in ns of the next scheduled disturbance, or None."""
        return self._pending[0][0] if self._pending else None

    def advance(self, now: int) -> bool:
        """Apply the disturbances due at `now`; return whether there were any."""
        acted = False
        while self._pending and self._pending[0][0] <= now:
            at_ns, _, world_act, robot = heapq.heappop(self._pending)
            if isinstance(world_act, _EndOfPush):
                self._data.xfrc_applied[world_act.link, :3] -= world_act.force
            else:
                self.act(world_act, at_ns, robot)
            acted = True
        return acted

    def act(self, world_act: WorldAct, now: int, robot: str = "") -> None:
        """Apply a disturbance to a robot or the floor; raise ConfigError for an invalid disturbance."""
        self._check(world_act, robot)
        if isinstance(world_act, AddPayload):
            self._load(self._link(world_act.on, robot), world_act.mass, np.array(world_act.position))
        elif isinstance(world_act, PushRobot):
            self._push(self._link(world_act.on, robot), np.array(world_act.force), now, round(world_act.seconds * 1e9))
        elif isinstance(world_act, BlockJoint):
            if self.blocker is not None:
                self.blocker.block(robot, world_act.joint, world_act.on)
        else:
            self._grip = world_act.friction
            self.update_friction()

    def _check(self, world_act: WorldAct, robot: str) -> None:
        if isinstance(world_act, BlockJoint):
            joints = self._bodies[robot].joints
            if world_act.joint not in joints:
                raise ConfigError(f"no drive moves a joint {world_act.joint!r}{nearest(world_act.joint, joints)}")
        elif not isinstance(world_act, SetGrip):
            self._link(world_act.on, robot)
            numbers = [world_act.mass, *world_act.position] if isinstance(world_act, AddPayload) else [*world_act.force]
            if not np.isfinite(numbers).all():
                raise ConfigError(f"{numbers}: these numbers must be finite")

    def _link(self, name: str, robot: str) -> int:
        """Return the index of a robot's link, or of its heaviest link if `name` is empty."""
        links = self._links[robot]
        if name and name not in links:
            raise ConfigError(f"the robot has no link {name!r}{nearest(name, links)}")
        return links[name] if name else self._heaviest[robot]

    def _plan(self, at_ns: int, world_act: WorldAct | _EndOfPush, robot: str = "") -> None:
        self._count += 1
        heapq.heappush(self._pending, (at_ns, self._count, world_act, robot))

    # -- payload

    def _load(self, link: int, mass: float, position: NDArray[np.float64]) -> None:
        """Add a point mass in kg to a link, at a position in the link's frame."""
        model = self._model
        before = float(model.body_mass[link])
        mass = max(mass, _LIGHTEST - before)
        after, old = before + mass, model.body_ipos[link].copy()
        place = (before * old + mass * position) / after
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.body_iquat[link])
        rotation = turn.reshape(3, 3)
        inertia = rotation @ np.diag(model.body_inertia[link]) @ rotation.T
        inertia += before * _steiner(old - place) + mass * _steiner(position - place)
        values, axes = np.linalg.eigh(inertia)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, axes.flatten())
        model.body_mass[link], model.body_ipos[link], model.body_iquat[link] = after, place, quat
        model.body_inertia[link] = np.maximum(values, 1e-9)
        # recomputes the constants that depend on masses, in a separate state
        mujoco.mj_setConst(model, mujoco.MjData(model))

    # -- pushes

    def _push(self, link: int, force: NDArray[np.float64], now: int, length_ns: int) -> None:
        self._data.xfrc_applied[link, :3] += force
        self._plan(now + length_ns, _EndOfPush(link, force))

    # -- friction

    def update_friction(self) -> None:
        """Set the friction of every wheel and caster according to its current position on the floor."""
        for geom in (*self._wheels, *self._casters):
            grip = self.grip_at(float(self._data.geom_xpos[geom, 0]), float(self._data.geom_xpos[geom, 1]))
            self._model.geom_friction[geom, 0] = grip if geom in self._wheels else min(self._slide, grip)


def _steiner(way: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inertia about the origin of a mass of 1 kg at a position (parallel axis theorem)."""
    return float(way @ way) * np.eye(3) - np.outer(way, way)
