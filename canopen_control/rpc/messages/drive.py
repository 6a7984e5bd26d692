"""Control socket of a virtual node: state, inputs and fault injection.

Real drives have no such socket. Positions and velocities of a plant are counts and counts/s of the motor; torques and
forces are in per mille of the rated torque. Positions and velocities of an axis are the values of its objects.
"""

from __future__ import annotations

from typing import Annotated, Final

import msgspec

from canopen_control.rpc.messages.declare import Api, Done, Effect, Request

# Objects around simulated robots, which virtual drives and recordings report.


class WorldShape(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Object around a simulated robot: `kind` is "box", "cylinder" (along z), "ellipsoid" or "patch" of the floor.

    `size` are the lengths in m along the axes of the object. `position` (the centre, in m) and `rotation` (a quaternion
    w, x, y, z) are in the world frame; `moves` is True if the object can be pushed. `robot` is another robot to which
    the object belongs, or ""; `grip` is the friction of a patch.
    """

    name: str
    kind: str
    size: tuple[float, float, float]
    position: tuple[float, float, float]
    rotation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    moves: bool = False
    robot: str = ""
    grip: float = 0.0


Inputs = Annotated[int, msgspec.Meta(ge=0, le=0xFFFFFFFF)]


class DriveHello(msgspec.Struct, frozen=True, kw_only=True):
    """Greeting of a virtual node; `channel` is the bus, such as "local:robby", and `pid` the process id."""

    node_id: int
    name: str = ""
    channel: str = ""
    version: str = ""
    protocol: int = 0
    pid: int = 0


class DriveEvent(msgspec.Struct, frozen=True):
    """Event of a virtual node, as a sentence."""

    text: str


DRIVE: Final[Api[DriveHello, DriveEvent]] = Api("drive", DriveHello, {"event": DriveEvent})


# -- faults


class FaultListing(msgspec.Struct, frozen=True, kw_only=True):
    """Fault that can be injected into a virtual node; `on` is True while the fault is active.

    `row` is the number in the catalogue of the behaviour of real drives (0: not in the catalogue), `acts` the affected
    part: "wire", "node", "axis", "input" or "output"; `does` is the behaviour of the drive, `reaction` the reaction of
    a correct master; `once` is True if the fault ends by itself.
    """

    name: str
    row: int = 0
    acts: str = ""
    does: str = ""
    reaction: str = ""
    once: bool = False
    on: bool = False


@DRIVE.method("faults", Effect.READS)
class ListFaults(Request[tuple[FaultListing, ...]], frozen=True):
    """List the faults that can be injected into the node; faults of inputs and axes depend on the node."""


class ActiveFaults(msgspec.Struct, frozen=True):
    """Names of the active faults of a node."""

    active: list[str]


@DRIVE.method("fault", Effect.CHANGES)
class SwitchFault(Request[ActiveFaults], frozen=True, kw_only=True):
    """Inject a fault into the node; with `on` false, clear it."""

    name: str
    on: bool = True


# -- quirks


class QuirkListing(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Quirk of a drive: a deviation from the standards that a manufacturer's healthy drives show.

    `does` is the behaviour of the drive, `clause` the clause from which it deviates, `source` where the behaviour is
    documented, `acts` the affected part, "axis" or "node". A quirk with a strength has a `unit`, a `default` and the
    bounds `low` and `high`. `on` are the active instances, such as "brake_delay=0.5@1".
    """

    name: str
    does: str
    clause: str
    source: str
    acts: str
    unit: str = ""
    default: float | None = None
    low: float | None = None
    high: float | None = None
    on: list[str] = []


@DRIVE.method("quirks", Effect.READS)
class ListQuirks(Request[tuple[QuirkListing, ...]], frozen=True):
    """List the quirks that can be enabled in the node."""


class ActiveQuirks(msgspec.Struct, frozen=True):
    """Active quirks of a node, such as "brake_delay=0.5@1"."""

    active: list[str]


@DRIVE.method("quirk", Effect.CHANGES)
class SwitchQuirk(Request[ActiveQuirks], frozen=True, kw_only=True):
    """Enable or disable a quirk; `quirk` is NAME, NAME=VALUE, NAME@AXIS or NAME=VALUE@AXIS."""

    quirk: str
    on: bool = True


# -- state of the node


class PlantState(msgspec.Struct, frozen=True):
    """State of a motor: `position` in counts, `velocity` in counts/s, `torque` in per mille of the rated torque."""

    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0


class Spread(msgspec.Struct, frozen=True):
    """Minimum, mean and maximum of a series of values."""

    min: float
    mean: float
    max: float


class SetPointQuality(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Timing and smoothness of set-points in a cyclic mode since the drive was enabled, or since `restart_quality`.

    `taken` counts the set-points that the drive used, `missed` the periods without a new set-point, `doubled` the
    set-points that repeated the previous one during a motion, `overwritten` the set-points that were replaced before
    the drive used them. `velocity` is the demanded velocity while the axis moved, and `acceleration` the standard
    deviation of the demanded acceleration, by second differences of the demanded position every 0.5 ms, in units of the
    drive and seconds. `velocity_ripple` and `acceleration_ripple` are the standard deviations of the first and the
    second differences relative to the mean magnitude of the first: 0 for smooth motion at constant velocity. `phase_us`
    is the time from a SYNC to the arrival of the RPDO with the set-point. Values that were never measured are omitted.
    """

    taken: int = 0
    missed: int = 0
    doubled: int = 0
    overwritten: int = 0
    velocity: Spread | None = None
    velocity_ripple: float | None = None
    acceleration: float | None = None
    acceleration_ripple: float | None = None
    phase_us: Spread | None = None


class AxisState(msgspec.Struct, frozen=True, kw_only=True):
    """State of a virtual axis; `state` is a CiA 402 state such as "SWITCHED_ON", `mode` a mode such as "PV".

    `statusword` is 0x6041, `controlword` 0x6040, `position` 0x6064 and `velocity` 0x606C in the units of the drive;
    `set_points` exists after the axis was enabled in a cyclic mode (CSP, CSV, CST, interpolated position).
    """

    axis: int
    state: str
    statusword: int
    controlword: int
    mode: str
    position: int
    velocity: int
    plant: PlantState
    set_points: SetPointQuality | None = None


class BasePose(msgspec.Struct, frozen=True, omit_defaults=True):
    """True pose of a simulated base in the world frame, in m and rad; `time_ns` is monotonic time.

    `heading` is not wrapped, `z` is the height above the floor at the start, `roll` and `pitch` are as in REP 103:
    `roll` is positive to the right side, `pitch` to the front down.
    """

    x: float
    y: float
    heading: float
    time_ns: int
    z: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0


class WorldState(msgspec.Struct, frozen=True, omit_defaults=True):
    """State of the physics simulation of several axes: pose of the `base`, and `sensors` by name.

    An IMU has ten numbers: quaternion (w, x, y, z), angular velocities in rad/s and accelerations in m/s2; a range
    finder has a distance in m, negative if nothing is in range; a force-torque sensor has three forces in N and three
    torques in Nm. `others` are further values of an external engine, by name. If `changeable`, payloads, pushes,
    blocked joints and another friction can be requested.
    """

    base: BasePose | None = None
    others: dict[str, float] = {}
    sensors: dict[str, tuple[float, ...]] = {}
    changeable: bool = False


class SignalState(msgspec.Struct, frozen=True, omit_defaults=True):
    """Signal such as "di3" of a device other than a drive; `output` is True for an output."""

    name: str
    value: float
    output: bool = False
    unit: str = ""


class DriveState(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """State of a virtual node: NMT state such as "OPERATIONAL", errors, axes and signals.

    `error_register` is 0x1001, `errors` are the active EMCY codes, `faults` the names of active faults, `quirks` the
    active quirks with their strengths. `world` exists if the axes belong to a physics simulation; only devices other
    than drives have `signals`.
    """

    node_id: int
    name: str
    nmt_state: str
    error_register: int
    errors: list[int]
    faults: list[str]
    axes: tuple[AxisState, ...]
    world: WorldState | None = None
    signals: tuple[SignalState, ...] = ()
    quirks: list[str] = []


@DRIVE.method("state", Effect.READS)
class GetDriveState(Request[DriveState], frozen=True):
    """Return the state of the node, its axes and their mechanics."""


# -- inputs and mechanics


@DRIVE.method("inputs", Effect.CHANGES)
class SetInputs(Request[Done], frozen=True, kw_only=True):
    """Set the digital inputs (0x60FD) of an axis; they keep this value until they are set again."""

    value: Inputs
    axis: int = 0


@DRIVE.method("signals", Effect.CHANGES)
class SetSignals(Request[Done], frozen=True, kw_only=True):
    """Set inputs of a device other than a drive by name, in their units; either all values are set or none.

    `values` is for example {"di0": 1, "position": 3.14}.
    """

    values: dict[str, float]


@DRIVE.method("plant", Effect.CHANGES)
class SetPlant(Request[Done], frozen=True, kw_only=True):
    """Set parameters of an axis' mechanics by their names in a plant file; either all are set or none.

    For a motor with a load these are mainly `external` and `friction`, torques in per mille of the rated torque,
    `inertia` as a multiple of the motor's own inertia, `backlash` in counts, and whether the motor is `stalled`.
    """

    numbers: dict[str, float | bool]
    axis: int = 0


@DRIVE.method("restart_quality", Effect.CHANGES)
class RestartQuality(Request[Done], frozen=True, kw_only=True):
    """Restart the statistics of an axis' set-points."""

    axis: int = 0


# -- disturbances of a physics simulation


@DRIVE.method("payload", Effect.CHANGES)
class AddPayload(Request[Done], frozen=True, kw_only=True):
    """Add `mass` kg to a link at once; a negative mass removes a payload.

    `on` is the link, "" for the heaviest link; `position` is in m in the frame of the link.
    """

    mass: float
    on: str = ""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)


@DRIVE.method("push", Effect.CHANGES)
class PushRobot(Request[Done], frozen=True, kw_only=True):
    """Push the link `on` ("": the heaviest link) at its centre of mass with `force` in N in the world frame."""

    force: tuple[float, float, float]
    on: str = ""
    seconds: Annotated[float, msgspec.Meta(gt=0)] = 0.2


@DRIVE.method("block", Effect.CHANGES)
class BlockJoint(Request[Done], frozen=True, kw_only=True):
    """Block a joint that a drive moves; with `on` false, release it."""

    joint: str
    on: bool = True


@DRIVE.method("grip", Effect.CHANGES)
class SetGrip(Request[Done], frozen=True, kw_only=True):
    """Change the sliding friction of the wheels on the floor, except on patches."""

    friction: Annotated[float, msgspec.Meta(ge=0)]


WorldAct = AddPayload | PushRobot | BlockJoint | SetGrip
"""Disturbances of a physics simulation, at a planned time or on request."""


# -- common state of the axes


@DRIVE.method("world", Effect.READS)
class GetWorld(Request[WorldState], frozen=True):
    """Return the true pose of the base and the sensors; all nodes of a simulation return the same result."""


@DRIVE.method("shapes", Effect.READS)
class GetWorldShapes(Request[tuple[WorldShape, ...]], frozen=True):
    """Return the objects currently around the robot: patches, boxes, ramps, walls and other robots."""
