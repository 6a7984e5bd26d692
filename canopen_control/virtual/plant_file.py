"""Plant file (YAML) of a drive process: the plant of every axis, encoders, and a base with two wheels.

An engine is a `plant.World`; the default is `OwnWorld`, another engine is named in the file.

    seed: 1                        # of all random numbers
    default: {kind: ideal}         # the axes not named below; kinds: ideal, lag, loaded
    axes:
      "3": {kind: loaded, torque_limit: 800, inertia: 2.0, friction: 30, external: -50, backlash: 20}
      "3/1": {kind: lag, time_constant: 0.05}                     # axis 1 of node 3
    base:                          # a diff-drive base on a floor
      left: 3
      right: 2
      wheel_radius: 0.1            # m, the true radius, independent of ros2_controllers.yaml
      left_wheel_radius: 0.1005    # m, if this wheel has another radius; likewise right_wheel_radius
      wheel_separation: 0.4        # m
      counts_per_revolution: 51200
      reversed: [right]            # wheels whose positive direction is backwards
      slip: 0.01                   # relative standard deviation of the distance of each step
      share: robby-floor           # if the wheels' drives run in several processes: the same name for all
    encoders:                      # CiA 406 nodes on the shafts of drives
      "5":
        axis: "3"                  # the axis that turns the encoder
        counts_per_revolution: 51200   # of the motor
        gear: 10                   # motor turns for each turn of the encoder
        reversed: true             # the encoder turns in the other direction
        lead: 0.005                # m for each turn of the encoder, if it is linear
        share: robby-shafts        # if the drive runs in another process: the same name for both
    engine: mujoco                     # physics, see `canopen_control.physics`; it determines the other keys
    engine: package.module:function    # called with this file's Path, returns a World; it determines the other keys

The other keys of an axis are the parameters of its plant, see `plant`.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from canopen_control.errors import ConfigError
from canopen_control.frame import MAX_NODE_ID
from canopen_control.rpc.messages.drive import WorldState
from canopen_control.virtual.plant import IdealPlant, LagPlant, LoadedPlant, Plant
from canopen_control.virtual.shaft import (
    LEFT,
    RIGHT,
    Coupling,
    DiffBase,
    ShaftFile,
    SharedBase,
    WheelPlant,
    load_counts,
    shared_path,
)
from canopen_control.yamlfile.convert import position, setting
from canopen_control.yamlfile.node import Node  # noqa: TC001 - the type of a field is looked up at run time
from canopen_control.yamlfile.reader import load, tree

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from canopen_control.virtual.plant import World
    from canopen_control.yamlfile.node import Problems


_SHAFT_NS = 5_000_000
_ENGINES = {"mujoco": "canopen_control.physics.engine:make"}  # imported only for a file that needs it
_KINDS: dict[str, Callable[..., Plant]] = {"ideal": IdealPlant, "lag": LagPlant, "loaded": LoadedPlant}
_STATE = frozenset(
    ("position", "velocity", "torque", "stiff", "load_position", "fed_velocity", "fed_torque")
)  # no parameters


class WorldError(ConfigError):
    """Error in a plant file."""


@dataclass(frozen=True)
class AxisFile:
    """Section of an axis in the plant file; None means the default of the plant."""

    kind: Literal["ideal", "lag", "loaded"] = "loaded"
    rated_velocity: float | None = setting(None, low=0.0)
    torque_time_constant: float | None = setting(None, low=1e-6)
    time_constant: float | None = setting(None, low=1e-6)
    coast_time_constant: float | None = setting(None, low=1e-6)
    acceleration: float | None = setting(None, low=1e-3)
    torque_limit: float | None = setting(None, low=0.0)
    inertia: float | None = setting(None, low=0.0)
    friction: float | None = setting(None, low=0.0)
    viscosity: float | None = setting(None, low=0.0)
    external: float | None = None
    backlash: float | None = setting(None, low=0.0)
    stalled: bool | None = None
    position_gain: float | None = setting(None, low=0.0)
    velocity_time_constant: float | None = setting(None, low=1e-4)
    velocity_feed_forward: float | None = setting(None, low=0.0)
    here: Node = position()  # noqa: RUF009 - makes a field

    def parameters(self) -> dict[str, float]:
        """Return the plant parameters set by the file."""
        names = [field.name for field in dataclasses.fields(self) if field.name not in ("kind", "here")]
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def check(self) -> None:
        """Report an error in the file for each parameter that this kind of plant does not have."""
        fields = {field.name for field in dataclasses.fields(_KINDS[self.kind])} - _STATE  # type: ignore[arg-type] # all are dataclasses
        for name in self.parameters().keys() - fields:
            self.here.error(f"a plant of kind {self.kind} has no {name}; possible: {', '.join(sorted(fields))}")

    def make(self) -> Plant:
        return _KINDS[self.kind](**self.parameters())


@dataclass(frozen=True)
class BaseFile:
    """Section of the differential-drive base in the plant file, with lengths in metres."""

    left: int = setting(low=1, high=MAX_NODE_ID)
    right: int = setting(low=1, high=MAX_NODE_ID)
    wheel_radius: float = setting(low=1e-6)
    wheel_separation: float = setting(low=1e-6)
    counts_per_revolution: float = setting(low=1e-6)
    left_wheel_radius: float | None = setting(None, low=1e-6)
    right_wheel_radius: float | None = setting(None, low=1e-6)
    reversed: list[Literal["left", "right"]] = setting(factory=list)
    slip: float = setting(0.0, low=0.0, high=0.5)
    share: str = ""
    here: Node = position()  # noqa: RUF009 - makes a field

    def radius(self, side: int) -> float:
        """Return the true radius of a wheel in m; `side` is LEFT or RIGHT."""
        wheel = (self.left_wheel_radius, self.right_wheel_radius)[side]
        return self.wheel_radius if wheel is None else wheel


@dataclass(frozen=True)
class EncoderFile:
    """Section of an encoder in the plant file, with the axis that turns it."""

    axis: str = setting()
    counts_per_revolution: float = setting(low=1e-6)
    gear: float = setting(1.0, low=1e-6)
    reversed: bool = False
    lead: float | None = setting(None, low=1e-9)
    share: str = ""
    here: Node = position()  # noqa: RUF009 - makes a field

    @property
    def coupling(self) -> Coupling:
        return Coupling(self.counts_per_revolution, self.gear, self.reversed, self.lead)


@dataclass(frozen=True)
class WorldFile:
    """Contents of a plant file."""

    seed: int = 0
    default: AxisFile = dataclasses.field(default_factory=lambda: AxisFile(kind="ideal"))
    axes: dict[str, AxisFile] = setting(factory=dict)
    base: BaseFile | None = None
    encoders: dict[str, EncoderFile] = setting(factory=dict)


class OwnWorld:
    """Default engine: independent plants, an optional differential-drive base, and encoders on shafts."""

    def __init__(self, file: WorldFile) -> None:
        self._file = file
        self._axes = {_address(name): axis for name, axis in file.axes.items()}
        self._base: DiffBase | SharedBase | None = None
        self._wheels: list[WheelPlant] = []
        self._encoders = {_address(name)[0]: encoder for name, encoder in file.encoders.items()}
        self._shafts: dict[tuple[int, int], Plant] = {}  # plants turned in this process
        self._files = {
            encoder.share: ShaftFile(shared_path(encoder.share)) for encoder in self._encoders.values() if encoder.share
        }
        self.period_ns = _SHAFT_NS if self._encoders else None if file.base is None else 20_000_000
        if file.base is not None:
            separation, share = file.base.wheel_separation, file.base.share
            self._base = SharedBase(separation, shared_path(share)) if share else DiffBase(separation)

    def plant(self, node_id: int, axis: int) -> Plant:
        """Return a new plant for an axis; the plant of a wheel also moves the base."""
        new_plant = self._shafts[node_id, axis] = self._make(node_id, axis)
        return new_plant

    def has_shaft(self, node_id: int) -> bool:
        return node_id in self._encoders

    def shaft_position(self, node_id: int) -> float | None:
        encoder = self._encoders[node_id]
        axis, file = _address(encoder.axis), self._files.get(encoder.share)
        plant = self._shafts.get(axis)
        counts = load_counts(plant) if plant is not None else None if file is None else file.get(*axis)
        return None if counts is None else encoder.coupling.place(counts)

    def publish(self) -> None:
        for encoder in self._encoders.values():
            axis = _address(encoder.axis)
            if encoder.share and axis in self._shafts:
                self._files[encoder.share].put(*axis, load_counts(self._shafts[axis]))

    def _make(self, node_id: int, axis: int) -> Plant:
        inner = self._axes.get((node_id, axis), self._file.default).make()
        base = self._file.base
        if base is None or self._base is None or axis or node_id not in (base.left, base.right):
            return inner
        side = LEFT if node_id == base.left else RIGHT
        sign = -1.0 if ("left", "right")[side] in base.reversed else 1.0
        metres = sign * base.radius(side) * math.tau / base.counts_per_revolution
        wheel = WheelPlant(inner, self._base, side, metres, slip=base.slip, seed=self._file.seed)
        self._wheels.append(wheel)
        return wheel

    def describe(self) -> WorldState:
        if self._base is None:
            return WorldState()
        for wheel in self._wheels:
            wheel.publish()
        return WorldState(self._base.pose())

    def close(self) -> None:
        for file in self._files.values():
            file.close()
        if isinstance(self._base, SharedBase):
            self._base.close()


def _address(name: str) -> tuple[int, int]:
    """Return the node-ID and the axis of an address such as ``3`` or ``3/1``; raise ValueError if invalid."""
    node, _, axis = name.partition("/")
    address = int(node), int(axis or "0")
    if not (1 <= address[0] <= MAX_NODE_ID and 0 <= address[1] <= 7):
        raise ValueError(name)
    return address


def read_world(path: Path) -> World:
    """Return the world defined by a plant file; WorldError lists every error by line."""
    engine = _engine(path)
    if engine is not None:
        return engine
    file = load(path, WorldFile, error=WorldError, check=_check)
    return OwnWorld(file)


def _check(file: WorldFile, _problems: Problems) -> None:
    for axis in (file.default, *file.axes.values()):
        axis.check()
    for name, axis in file.axes.items():
        try:
            _address(name)
        except ValueError:
            axis.here.error(f'{name!r} is not an axis: write "3" for node 3, or "3/1" for its axis 1')
    for name, encoder in file.encoders.items():
        for text in (name, encoder.axis):
            try:
                _address(text)
            except ValueError:
                encoder.here.error(
                    f'{text!r} is not a node or axis: write "5" for node 5, or "3/1" for axis 1 of node 3'
                )
    if file.base is not None and file.base.left == file.base.right:
        file.base.here.error("left and right must be different nodes")


def _engine(path: Path) -> World | None:
    """Return the world of the engine named in the file, or None if it names none; raise WorldError if unusable."""
    root = tree(path, error=WorldError)
    entry = root.get("engine") if root.kind == "mapping" else None
    if entry is None:
        return None
    module, _, name = _ENGINES.get(str(entry.value), str(entry.value)).partition(":")
    try:
        world: World = getattr(importlib.import_module(module), name)(path)
    except (ImportError, AttributeError, ValueError) as error:
        raise WorldError(f"{path}: engine: {entry.value} cannot be used: {error}") from error
    return world
